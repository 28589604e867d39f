"""Write the tables of documents from the results of commands: ``make docs``.

``docs/results/*.json`` are reports as `deitalk evaluate -o` writes them, of the weights whose hash
they hold, of `deitalk ablate` and of `deitalk finetune --folds`. A table stands between
``<!-- table NAME -->`` and ``<!-- end -->``.
"""

import json
import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
RESULTS = DOCS / "results"
DOCUMENTS = (
    DOCS.parent / "MODEL_CARD.md",
    DOCS / "ablations.md",
    DOCS / "comparison.md",
    DOCS / "finetuning.md",
    DOCS / "sdfa.md",
    RESULTS / "README.md",
)
_TABLE = re.compile(r"(<!-- table (\S+) -->\n).*?(?=<!-- end -->)", re.DOTALL)

_EVALUATE = "deitalk evaluate default"
_ABLATE = "deitalk ablate --data corpus/ --steps 300"
_TUNE = "deitalk finetune"
_SHORT = "-o OUT --set train.steps=100 --set train.batch_size=4 --set train.evaluate_every=50"
LIP_SPEAKERS = ("s03", "s32")
"""Measured speakers from whom no embedded model learnt."""
COMMANDS = {
    "default-test": f"{_EVALUATE} --data corpus/ --split test --most 90 --probes 12",
    "default-fresh": f"{_EVALUATE} --data fresh/ --split test --probes 12",
    "default-lips": f"{_EVALUATE} --lips LIPS --speaker s03 --speaker s32",
    "default-acted": f"{_EVALUATE} --acted CREMA.csv --split test",
    "default-noise": f"{_EVALUATE} --data corpus/ --split test --most 12 --probes 12 --noise NOISE",
    "default-validation": f"{_EVALUATE} --data corpus/ --split validation --most 12 --probes 12",
    "wav2vec": "deitalk evaluate runs/wav2vec/best --data corpus/ --split test --most 12 "
    "--probes 0",
    "default-speed": "deitalk benchmark --json",
    "live-test": "deitalk evaluate live --data corpus/ --split test --most 90 --probes 0",
    "live-lips": "deitalk evaluate live --lips LIPS --speaker s03 --speaker s32",
    "ablations": f"{_ABLATE} -o runs/ablations --seeds 2 --most 24 --only full --only no_dei "
    "--only no_dpe --only no_velocity --only no_classification --set train.frozen_frontend=default "
    "--set data.augment=false --set train.batch_size=8 --set train.precision=bfloat16 "
    "--set train.workers=0 --set train.evaluate_every=300 --set model.decoder_channels=128 "
    "--set model.motion_channels=[64,64,96,96] --set data.cache_gigabytes=4",
    "comparison": f"{_ABLATE} -o runs/comparison --configs configs/comparison --seeds 3 --most 6 "
    "--probes 0 --set data.clips=300 --set train.evaluate_every=300",
    **{
        f"words-{taught}-on-{half}": f"deitalk evaluate {model} --lips words_{half} --speaker s30 "
        "--speaker s03 --speaker s32"
        for taught, model in {
            "before": "BEFORE",
            **{name: f"runs/words_{name}/last" for name in ("all", "0", "1")},
        }.items()
        for half in "01"
    },
    "sdfa-test": "deitalk evaluate sdfa --data corpus/ --split test --transitions --most 16",
    "mesh-ablations": "deitalk ablate --configs configs/mesh_ablations --data corpus/ "
    "-o runs/mesh_ablations --seeds 2 --most 40 --set data.clips=480",
    "facegood": f"{_TUNE} facegood_data/ --rig facegood.yaml --folds takes {_SHORT}",
    "facegood-nothing": f"{_TUNE} facegood_data/ --rig facegood.yaml --leave-out 2_01 {_SHORT} "
    "--from none --set train.learning_rate=1e-3",
    **{
        f"captured-lips-{speaker}": f"{_TUNE} lips_rig/ --rig lips_rig/rig.yaml "
        f"--leave-out {speaker} -o OUT --set train.steps=60 --set train.batch_size=4 "
        "--set train.evaluate_every=30"
        for speaker in LIP_SPEAKERS
    },
}
"""What writes each report of ``docs/results``, `deitalk ablate` as its ``ablations.json`` and
`deitalk finetune` as its ``report.json``, with ``--folds`` as its ``folds.json``."""

COLUMNS = (
    ("LibriSpeech", "default-test", "librispeech"),
    ("speechocean762 adults", "default-test", "speechocean-adults"),
    ("its children", "default-test", "speechocean-children"),
    ("espeak-ng English", "default-test", "espeak"),
    ("two fresh readers", "default-fresh", "fresh"),
)
"""Heading, report and group of each column."""

Group = dict[str, Any]
Cell = Callable[[Group, Group], str]
"""Scores of a group, as animated and of the network alone, to the text of a cell."""


def short(value: float, digits: int = 3) -> str:
    """A number without the zero before its point: ``.959``."""
    return re.sub(r"^(-?)0\.", r"\1.", f"{value:.{digits}f}")


def _both(name: str, digits: int = 3) -> Cell:
    return lambda a, b: f"{short(a[name], digits)} ({short(b[name], digits)})"


def _percent(name: str) -> Cell:
    return lambda a, b: f"{short(100 * a[name], 1)} % ({short(100 * b[name], 1)})"


def _one(name: str) -> Cell:
    return lambda a, b: short(a[name])


SCORES: dict[str, Cell] = {
    "bilabials found": _both("bilabial_hits_at_5_percent"),
    "bilabial AUC, windows": _both("bilabial_window_auc"),
    "bilabial AUC, frames": _both("bilabial_frame_auc"),
    "AUC of loudness alone, windows": _one("loudness_bilabial_window_auc"),
    "found closures held at .9 for two frames": _both("found_bilabials_held_at_0.9", 2),
    "frames with shut lips on sounds other than p b m f v": _percent("shut_on_other_sounds"),
    "jaw r against the tables (loudness alone)": lambda a, b: (
        f"{short(a['jaw_r'])} ({short(a['loudness_jaw_r'])})"
    ),
    "mean r of twelve articulation channels": _both("articulation_r"),
    "jaw lag": lambda a, b: f"{a['jaw_lag_ms']:.0f} ms",
    "mouth opening in silence (times of the phones) against speech": _percent("opening_in_silence"),
    "LPE over `lip`": _both("lpe"),
    "EPE over `upper_face`, of acted takes": _both("epe", 4),
}
CONTOURS: dict[str, str] = {
    "contour along which level, treble, pitch and speed were modified: predicted": "intensity_rho",
    "... the network alone": "network_rho",
    "... prosody index alone": "index_rho",
    "... level alone": "level_rho",
}


@cache
def report(name: str) -> dict[str, Any]:
    """A report of ``docs/results``."""
    loaded: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return loaded


def scores() -> str:
    """Scores of the default model on its test speakers, the network alone in brackets."""
    heads, groups = [], []
    for title, name, group in COLUMNS:
        both = report(name)["groups"][group], report(name)["network"][group]
        heads.append(f"{title} ({both[0]['clips']})")
        groups.append(both)
    rows = [[name, *(cell(*both) for both in groups)] for name, cell in SCORES.items()]
    return _table([["test speakers (recordings)", *heads], *rows])


def intensity() -> str:
    """How the predicted intensity follows a voice, beside what is simpler."""
    heads = [title for title, _, _ in COLUMNS]
    contours = [report(name)["contours"][group] for _, name, group in COLUMNS]
    labels = [report(name)["groups"][group] for _, name, group in COLUMNS]
    rows = [[t, *(short(c[key], 2) for c in contours)] for t, key in CONTOURS.items()]
    above = [f"{short(c['above_level'], 2)} ± {short(c['above_level_error'], 2)}" for c in contours]
    rows.append(["... predicted less level, with its standard error", *above])
    for title, key in (
        ("label of the corpus: predicted (all recordings)", "intensity_rho"),
        ("... the network alone", "network_rho"),
        ("... prosody index alone", "index_rho"),
    ):
        rows.append([title, *(short(group[key], 2) for group in labels)])
    return _table([["", *heads], *rows])


MEASURES = {
    "opening": "opening",
    "jaw": "jaw",
    "width": "width",
    "upper_lip": "upper lip",
    "lower_lip": "lower lip",
    "corner": "corners",
}
"""Lip measures of people, and their headings."""


def lips() -> str:
    """The default model beside lips measured on people, mean over speakers."""
    found = report("default-lips")
    rows = [
        ("network alone, r", "network", "r"),
        ("as `deitalk animate` returns them, r", "animated", "r"),
        ("loudness, r", "loudness", "r"),
        ("range over the measured one, network alone", "network", "range"),
        ("speed over the measured one, network alone", "network", "speed"),
    ]
    cells = [
        [text, *(short(found[name]["mean"][f"{measure} {score}"], 2) for measure in MEASURES)]
        for text, name, score in rows
    ]
    return _table([["", *MEASURES.values()], *cells])


def noise() -> str:
    """Closures and jaw in two noises outside the training."""
    rows = [
        [
            level,
            short(score["bilabial_window_auc"]),
            short(score["bilabial_hits_at_5_percent"], 2),
            short(score["jaw_r"], 2),
        ]
        for level, score in report("default-noise")["noise"].items()
    ]
    return _table([["speech to noise", "bilabial AUC", "bilabials found", "jaw r"], *rows])


WIDENED = ("angry", "happy", "sad", "surprised")


def styles() -> str:
    """How much styles differ, and how far lips move in each."""
    groups = list(SOURCES)
    apart, wide = report("default-test")["styles"], report("default-validation")["styles"]
    rows = [
        [
            "distance of the two nearest styles / spread within a style",
            *(short(min(x["separation"] for x in apart[g]["styles"].values()), 1) for g in groups),
        ]
    ]
    rows += [
        [
            f"{emotion}: range of the lips / the neutral one, intensity 1 (predicted intensity)",
            *(
                f"{short(x['range_strong'], 2)} ({short(x['range'], 2)})"
                for x in (wide[g]["styles"][emotion] for g in groups)
            ),
        ]
        for emotion in WIDENED
    ]
    return _table([["", *(SOURCES[name] for name in groups)], *rows])


LIVE: dict[str, tuple[str, int]] = {
    "bilabials found": ("bilabial_hits_at_5_percent", 3),
    "bilabial AUC, windows": ("bilabial_window_auc", 3),
    "found closures held at .9 for two frames": ("found_bilabials_held_at_0.9", 2),
    "shut on other sounds": ("shut_on_other_sounds", 3),
    "jaw r against the tables": ("jaw_r", 3),
    "mean r of twelve articulation channels": ("articulation_r", 3),
}
"""Scores of `live` beside `default`, and their digits."""


def live() -> str:
    """The live model / the default model by the same command, and both beside measured lips."""
    groups = {
        name: (report("live-test")["groups"][name], report("default-test")["groups"][name])
        for name in SOURCES
    }
    rows = [
        [text, *(" / ".join(short(g[key], digits) for g in both) for both in groups.values())]
        for text, (key, digits) in LIVE.items()
    ]
    speech = _table([["`live` / `default`", *(SOURCES[name] for name in groups)], *rows])
    found = report("live-lips"), report("default-lips")
    people = [
        [
            text,
            *(
                " / ".join(short(r["animated"]["mean"][f"{m} {key}"], 2) for r in found)
                for m in MEASURES
            ),
        ]
        for text, key in (("r", "r"), ("range over the measured one", "range"))
    ]
    return speech + "\n" + _table([["lips of people", *MEASURES.values()], *people])


def words() -> str:
    """Lips of people on words whose lips were taught, and on words whose were not."""
    rows = []
    for text, names in {
        "before measured lips": ("before-on-0", "before-on-1"),
        "taught all words": ("all-on-0", "all-on-1"),
        "taught the half that is scored": ("0-on-0", "1-on-1"),
        "taught the other half": ("1-on-0", "0-on-1"),
    }.items():
        means = [report(f"words-{name}")["network"]["mean"] for name in names]
        rows.append([text, *(" / ".join(short(m[f"{x} r"], 2) for m in means) for x in MEASURES)])
    return _table([["r, words of the first half / of the second", *MEASURES.values()], *rows])


ACTED = {"high above low": 3, "rank correlation": 2}
"""Scores of acted strengths, and their digits."""


def acted() -> str:
    """Order of acted strengths in the output of the default model."""
    columns = [(group, s) for group in ("anger and joy", "sadness") for s in ACTED]
    rows = [
        [text, *(short(report("default-acted")[g][f"{name}: {s}"], ACTED[s]) for g, s in columns)]
        for name, text in (
            ("intensity", "predicted intensity over speech, `deitalk animate`"),
            ("whole face", "distance of all curves from rest"),
        )
    ]
    return _table([["26 test actors", *(f"{g}: {s}" for g, s in columns)], *rows])


SOURCES = {
    "librispeech": "LibriSpeech",
    "speechocean-adults": "speechocean762, adults",
    "speechocean-children": "speechocean762, children",
    "espeak": "espeak-ng, English",
}
VARIANTS = {
    "full": "full",
    "no_dei": "without dynamic intensity (DEI)",
    "no_dpe": "without positional encoding (DPE)",
    "no_velocity": "without velocity loss",
    "no_classification": "without classification loss",
}
METRICS = {
    "lpe": ("LPE / 1000", 1000, 1),
    "epe": ("EPE / 1000", 1000, 2),
    "bilabial_window_auc": ("bilabial AUC", 1, 3),
    "bilabial_hits_at_5_percent": ("bilabials found", 1, 2),
    "jaw_r": ("jaw r", 1, 3),
    "articulation_r": ("mean r", 1, 3),
    "intensity_rho": ("intensity, rank correlation", 1, 2),
    "jerk_per_speed": ("jerk / speed", 1, 0),
}
"""Title, factor and digits."""


SYSTEMS = {
    "deitalk": "DEITalk",
    "faceformer": "FaceFormer-style",
    "emotalk": "EmoTalk-style, emotion of the voice",
    "emotalk_labelled": "EmoTalk-style, emotion given",
}


def ablations() -> str:
    """Networks without parts of DEITalk, alone and with the rules after them."""
    alone = _variants("ablations", VARIANTS, "network", "the network alone")
    ruled = _variants("ablations", VARIANTS, "groups", "with the rules")
    return "\n".join((*alone, *ruled))


WAV2VEC: dict[str, tuple[str, int]] = {
    "bilabial AUC": ("bilabial_window_auc", 3),
    "bilabials found": ("bilabial_hits_at_5_percent", 2),
    "AUC of loudness": ("loudness_bilabial_window_auc", 3),
    "jaw r": ("jaw_r", 3),
    "jaw r of loudness": ("loudness_jaw_r", 3),
    "mean r": ("articulation_r", 3),
}
"""Scores of a small wav2vec 2.0 and of loudness, and their digits."""


def wav2vec() -> str:
    """A small wav2vec 2.0 trained end to end, the network alone, beside loudness."""
    found = report("wav2vec")
    rows = [
        [
            title,
            *(
                short({**found["groups"][name], **found["network"][name]}[key], digits)
                for key, digits in WAV2VEC.values()
            ),
        ]
        for name, title in SOURCES.items()
    ]
    return _table([["test speakers", *WAV2VEC], *rows])


def comparison() -> str:
    """DEITalk beside other networks, alone (DEITalk Table 1)."""
    return "\n".join(_variants("comparison", SYSTEMS, "network", "the network alone"))


def sdfa() -> str:
    """The embedded SDFA on sentences with an /s/ before /p b m/, with and without its seal."""
    found = report("sdfa-test")["groups"]["all"]
    rows = [
        [f"{text} ({found[f'{kind}s']:.0f})", *(_closed(found, who + kind) for who in CLOSURES)]
        for kind, text in SOUNDS.items()
    ]
    title = f"{found['clips']:.0f} test recordings: closed to 1 mm, median gap"
    errors = (
        f"Mean error of the lips {short(found['lips_mm'], 2)} mm (at rest "
        f"{short(found['still_mm'], 2)} mm), of all vertices {short(found['mesh_mm'], 2)} mm.\n"
    )
    return _table([[title, *CLOSURES.values()], *rows]) + "\n" + errors


SOUNDS = {"bilabial": "p b m", "after_s": "p b m after s", "vowel": "vowels"}
CLOSURES = {"": "as given", "unsealed_": "before the seal", "truth_": "truth"}


def _closed(found: Group, name: str) -> str:
    return f"{100 * found[f'{name}_closed']:.1f} %, {short(found[f'{name}_gap_mm'], 2)} mm"


MESH_VARIANTS = {
    "full": "SDFA small",
    "no_spec_bilstm": "convolutions in place of the Spec-BiLSTM",
    "no_attention": "convolutions in place of the attention",
    "karras": "Karras-style, offsets",
    "voca": "VOCA-style, offsets",
}
MESH_METRICS = {
    "lips_mm": ("lips, mean error, mm", 1, 2),
    "unsealed_bilabial_gap_mm": ("p b m, median gap before the seal, mm", 1, 2),
    "unsealed_bilabial_closed": ("closed to 1 mm before the seal, %", 100, 0),
    "bilabial_closed": ("closed, sealed where the model has a seal, %", 100, 0),
    "vowel_closed": ("vowels closed, %", 100, 1),
}


def mesh_ablations() -> str:
    """SDFA without its parts, and two older networks (§5.2.2, Table 4's rows)."""
    table = report("mesh-ablations")
    rows = [
        [shown, *(_spread(table[name]["groups"]["all"], m, MESH_METRICS) for m in MESH_METRICS)]
        for name, shown in MESH_VARIANTS.items()
        if name in table
    ]
    still = table["full"]["groups"]["all"]["still_mm"]["mean"]
    title = f"test recordings; lips at rest: {short(still, 2)} mm"
    return _table([[title, *(head for head, _, _ in MESH_METRICS.values())], *rows])


def _variants(name: str, variants: dict[str, str], prediction: str, title: str) -> list[str]:
    """A table of each source of a report of `deitalk ablate`: variants down, scores across."""
    table, heads = report(name), [head for head, _, _ in METRICS.values()]
    parts = []
    for source, text in SOURCES.items():
        rows = [
            [shown, *(_spread(table[variant][prediction][source], m) for m in METRICS)]
            for variant, shown in variants.items()
            if variant in table
        ]
        parts.append(_table([[f"{text}, {title}", *heads], *rows]))
    return parts


FOLDS = ("error_of_mean_pose", "error_at_best_gain", "mean_r", "range")
"""Scores of a fine-tuning on what it never saw."""
FACEGOOD_JAW = "mouth_stretch_c"


def facegood() -> str:
    """A rig of its own, each take left out in turn; then the error of every fold."""
    found = report("facegood")
    mean, folds = found["mean"], found["folds"]
    jaw = short(found["controls"][FACEGOOD_JAW]["after_r"])
    systems = {"tuned": mean["after"]} | _baselines(mean)
    means = [*_systems("mean of the folds", systems), [f"r of `{FACEGOOD_JAW}`", jaw, "–", "–"]]
    title = f"`{FOLDS[0]}`, from weights {found['base_sha256'][:8]}…"
    errors = ["tuned", *(_known(scores[FOLDS[0]]) for scores in folds.values())]
    return f"{_table(means)}\n{_table([[title, *folds], errors])}"


def captured_lips() -> str:
    """Measured lips as a rig, speakers left out; with the r of every measure."""
    systems, rs = {}, []
    for speaker in LIP_SPEAKERS:
        found = report(f"captured-lips-{speaker}")
        systems[f"{speaker}, tuned"] = found["scores"]["after"]
        systems[f"{speaker}, loudness"] = found["scores"]["loudness"]
        rs.append([found["controls"][name]["after_r"] for name in MEASURES])
    title = f"left out, from weights {found['base_sha256'][:8]}…"
    rows = [
        [f"r of the {name}", *(cell for r in values for cell in (short(r), "–"))]
        for name, values in zip(MEASURES.values(), zip(*rs, strict=True), strict=True)
    ]
    return _table([*_systems(title, systems), *rows])


def from_nothing() -> str:
    """A left-out take: the tuned model, and its network from random weights on the same data."""
    take, found = "2_01", report("facegood-nothing")["scores"]
    systems = {"tuned": report("facegood")["folds"][take], "from nothing": found["after"]}
    return _table(_systems(f"{take} left out", systems | _baselines(found)))


def _baselines(scores: dict[str, Group]) -> dict[str, Group]:
    return {name: scores[name] for name in ("loudness", "mean pose")}


def _systems(title: str, systems: dict[str, Group]) -> list[list[str]]:
    """Scores down, systems across."""
    rows = [[f"`{s}`", *(_known(scores[s]) for scores in systems.values())] for s in FOLDS]
    return [[title, *systems], *rows]


def _known(value: float | None) -> str:
    return "–" if value is None else short(value)


def commands() -> str:
    """The command of each report."""
    rows = [[f"`{name}.json`", f"`{command}`"] for name, command in COMMANDS.items()]
    return _table([["report", "command"], *rows])


def _spread(
    scores: dict[str, Group], metric: str, metrics: dict[str, tuple[str, int, int]] = METRICS
) -> str:
    (_, factor, digits), score = metrics[metric], scores[metric]
    if not score["n"]:
        return "–"
    mean = short(factor * score["mean"], digits)
    return mean if score["n"] < 2 else f"{mean} ± {short(factor * score['sd'], digits)}"


TABLES: dict[str, Callable[[], str]] = {
    "scores": scores,
    "intensity": intensity,
    "lips": lips,
    "noise": noise,
    "styles": styles,
    "live": live,
    "words": words,
    "acted": acted,
    "ablations": ablations,
    "comparison": comparison,
    "wav2vec": wav2vec,
    "sdfa": sdfa,
    "mesh-ablations": mesh_ablations,
    "facegood": facegood,
    "from-nothing": from_nothing,
    "captured-lips": captured_lips,
    "commands": commands,
}


def _table(rows: Sequence[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(row)} |".replace("|  |", "| |", 1) for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]]) + "\n"


def written(text: str) -> str:
    """A document with its tables as the results have them."""
    return _TABLE.sub(lambda match: f"{match[1]}\n{TABLES[match[2]]()}\n", text)


if __name__ == "__main__":
    for path in DOCUMENTS:
        path.write_text(written(path.read_text(encoding="utf-8")), encoding="utf-8")
