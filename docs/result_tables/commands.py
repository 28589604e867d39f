"""The command of each report of ``docs/results``, in three groups; words that stand for data."""

_RESEARCH = "python -m deitalk.research"
_EVALUATE = f"{_RESEARCH} evaluate default"
_ABLATE = f"{_RESEARCH} ablate --data corpus/ --steps 300"
_TUNE = "deitalk finetune"
_PEOPLE = "python -m deitalk.research.evaluation"
_TRAINING = "python -m deitalk.research.training"
LIP_SPEAKERS = ("s03", "s32")
"""Measured speakers from whom no embedded model learnt."""

WEIGHTS = {
    "default-test": f"{_EVALUATE} --data corpus/ --split test --most 90 --probes 12",
    "default-fresh": f"{_EVALUATE} --data fresh/ --split test --probes 12",
    "default-lips": f"{_EVALUATE} --lips LIPS --speaker s03 --speaker s32",
    "default-acted": f"{_EVALUATE} --acted CREMA.csv --split test",
    "default-noise": f"{_EVALUATE} --data corpus/ --split test --most 12 --probes 12 "
    "--noise UNHEARD",
    "default-validation": f"{_EVALUATE} --data corpus/ --split validation --most 12 --probes 12",
    "mel-attention": f"{_RESEARCH} attention corpus/ --clips 20 --model mel "
    "-o OUT/attention.png --json",
    "known-words": f"{_PEOPLE}.words --data corpus/ --split test --most 90",
    "motion-energy": f"{_PEOPLE}.motion_energy --animate docs/samples/amiable.flac --seconds 6",
    "phone-evidence": f"{_TRAINING}.phone_evidence --data corpus/ --embedded",
    "suggestion": f"{_TRAINING}.suggestion --actors CREMA.csv "
    "--readers LIBRISPEECH.tsv --readers SPEECHOCEAN.tsv --noise NOISE --rooms ROOMS "
    "--split test",
    "mesh-head-test": f"{_RESEARCH} evaluate mesh_head --data corpus/ --split test --most 24",
}
"""Of the weights of `default`: with new ones they have to run again (and its times, below)."""
TIMING = {
    "default-speed": f"{_RESEARCH} evaluate --speed --threads 1 --json",
    "mesh-speed-1": f"{_RESEARCH} evaluate --speed --mesh --threads 1 --json",
    "mesh-speed-2": f"{_RESEARCH} evaluate --speed --mesh --threads 2 --json",
    "live-speed": "python -m deitalk.research.speed.live_speed",
    "live-run": "python -m deitalk.research.speed.live_run --minutes 2 --period 0.5",
    "batch-rate": "python -m deitalk.research.speed.batch_rate LINES",
    "cold-start": "python -m deitalk.research.speed.cold_start",
    "onnx-sizes": "python -m deitalk.research.speed.onnx_sizes",
    "device": "python -m deitalk.research.speed.device --device cuda --json",
    "service-load": "python -m tests.api.load",
}
"""Times: for a machine with nothing beside."""
OTHER = {
    "live-test": f"{_RESEARCH} evaluate live --data corpus/ --split test --most 90 --probes 0",
    "live-lips": f"{_RESEARCH} evaluate live --lips LIPS --speaker s03 --speaker s32",
    "small-lips": f"{_RESEARCH} evaluate small --lips LIPS --speaker s03 --speaker s32",
    "ablations": f"{_ABLATE} -o runs/ablations --seeds 2 --most 24 --only full --only no_dei "
    "--only no_dpe --only no_velocity --only no_classification --set train.frozen_frontend=mel "
    "--set data.augment=false --set train.batch_size=8 --set train.precision=bfloat16 "
    "--set train.workers=0 --set train.evaluate_every=300 --set model.decoder_channels=128 "
    "--set model.motion_channels=[64,64,96,96] --set data.cache_gigabytes=4",
    "comparison": f"{_ABLATE} -o runs/comparison --configs configs/comparison --seeds 3 --most 6 "
    "--probes 0 --set data.clips=300 --set train.evaluate_every=300",
    "sdfa-test": f"{_RESEARCH} evaluate sdfa --data corpus/ --split test --transitions --most 16",
    "sdfa-lips": f"{_RESEARCH} evaluate sdfa --data lips_data/ --split test",
    "sdfa-attention": f"{_RESEARCH} attention corpus/ --clips 20 --model sdfa -o OUT/attention.png "
    "--json",
    **{
        f"attention-{name}": f"{_RESEARCH} attention corpus/ --clips 20 --model "
        f"runs/attention_{name}/best -o OUT/attention.png --json"
        for name in ("centre", "0", "1", "window")
    },
    "mesh-ablations": f"{_RESEARCH} ablate --configs configs/mesh_ablations --data corpus/ "
    "-o runs/mesh_ablations --seeds 2 --most 40 --set data.clips=480",
    "vocal-strength": f"{_TRAINING}.vocal_strength --readers LIBRISPEECH.tsv "
    "--actors CREMA.csv --split test --embedded",
    "head-motion": f"{_PEOPLE}.head LIPS",
    "blinks": f"{_PEOPLE}.blinks LIBRISPEECH",
    "retargeting": f"{_PEOPLE}.retargeting ICT.npz",
    **{
        f"captured-lips-{speaker}": f"{_TUNE} lips_rig/ --rig lips_rig/rig.yaml "
        f"--leave-out {speaker} -o OUT"
        for speaker in LIP_SPEAKERS
    },
    "facegood": f"{_RESEARCH} folds facegood_data/ -o OUT",
}
"""The rest. Reports of trainings state the weights that they began with."""
GROUPS = {"weights": WEIGHTS, "timing": TIMING, "other": OTHER}
COMMANDS = {**WEIGHTS, **TIMING, **OTHER}

PLACES = {
    "corpus/": f"`{_RESEARCH} corpus build --hours 1 --recordings SPEECH`, as in the model card",
    "fresh/": "the same of readers outside all trainings",
    "LIPS": "measured lips (dataset.md)",
    "lips_data/": "measured lips and a corpus that they correct (model card, step 7)",
    "CREMA.csv": "table of CREMA-D's clips: path, actor, emotion, level, voice_vote",
    "LIBRISPEECH.tsv": "table of LibriSpeech's recordings: path, speaker, transcript",
    "LIBRISPEECH": "folder of its recordings",
    "SPEECHOCEAN.tsv": "the same of speechocean762",
    "NOISE": "folder of recordings of noise",
    "UNHEARD": "two recordings of noise, a tap and a cat, that no training used",
    "LINES": "folder of some hundred recordings of 2 to 6 s",
    "ICT.npz": "ICT-FaceKit's neutral face and 57 shapes (mesh.md)",
    "lips_rig/": "measured lips as a rig (finetuning.md)",
    "facegood_data/": "FACEGOOD's clips 2_01 to 2_05 of one actor (`data import --rig facegood "
    "--fps 30 --emotion neutral --actor fg --keep-listening`)",
}
"""Words of the commands that stand for data."""
