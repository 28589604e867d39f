"""Every reader with its seeds: small files of our own writers, and their mutations."""

import io
import json
import random
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .captures import capture_readers
from .mutate import (
    mutated,
    mutated_glb,
    mutated_json,
    mutated_npz,
    mutated_safetensors,
)
from .readers_types import Reader, Seed

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"


def input_of(seeds: Sequence[Seed], key: str) -> tuple[str, bytes]:
    """The fuzzed input of a key: the same on every machine."""
    rng = random.Random(key)
    seed = rng.choice(seeds)
    corpus = [other.data for other in seeds]
    return seed.name, seed.mutate(rng, seed.data, corpus)


def _curves(n_frames: int = 4) -> Any:
    from rig import RigCurves, default_controls

    board = default_controls()
    rng = np.random.default_rng(1)
    share = rng.uniform(0, 1, (n_frames, len(board)))
    values = board.minimum + share * (board.maximum - board.minimum)
    return RigCurves(
        values, board.names, 30, emotion=np.full((n_frames, 5), 0.2), intensity=np.ones(n_frames)
    )


def _curve_seeds(suffix: str, folder: Path) -> list[Seed]:
    from rig import write_curves

    kind = mutated_npz if suffix == ".npz" else mutated_json if "json" in suffix else mutated
    seeds = []
    for n_frames in (2, 3):
        path = folder / f"c{suffix}"
        write_curves(path, _curves(n_frames))
        seeds.append(Seed(path.name, path.read_bytes(), kind))
    if suffix == ".tsv":
        seeds.append(Seed(path.name, b"0\tX\n10\tA\n", kind))
    return seeds


def _read_curves(path: Path) -> object:
    from rig import read_curves

    return read_curves(path, fps=30 if path.suffix == ".txt" else None)


def _formats() -> list[str]:
    from rig.formats.table import FORMATS

    return [
        f.suffixes[0] for f in FORMATS if f.read and f.write and f.name not in ("usd", "glb", "fbx")
    ]


def _checked_seeds(folder: Path) -> list[Seed]:
    from rig.mesh.glb import write_container

    write_container(folder / "c.glb", {"asset": {}, "meshes": [], "animations": []}, bytes(8))
    seeds = [Seed("c.glb", (folder / "c.glb").read_bytes(), mutated_glb)]
    for suffix in (".unreal.json", ".visemes.json", ".livelink.csv", ".maya.py", ".csv"):
        seeds += _curve_seeds(suffix, folder)[:1]
    return seeds


def _check(path: Path) -> object:
    """Check any file of curves: findings of one line each, also of a file that no reader reads."""
    from rig.validation.files import validate

    texts = [finding.text for finding in validate(path).findings]
    assert texts and not [text for text in texts if "\n" in text]
    return texts


def _track_seeds(folder: Path) -> list[Seed]:
    keys = [
        {"time": 0, "emotion": "happy", "strength": 0.7},
        {"time": 1.5, "emotion": "sad", "strength": 1},
    ]
    text = "time,emotion,strength\n0,happy,0.7\n0,sad,0.3\n1.5,sad,1\n"
    wide = "time;neutral;happy\n0;0,5;0,5\n1;0;1\n"
    yaml = "keys:\n- {time: 0, emotion: happy, strength: 0.7}\n- &a {time: 2, emotion: sad, strength: 1}\n"
    return [
        Seed("t.csv", text.encode(), mutated),
        Seed("t.csv", wide.encode("utf-16"), mutated),
        Seed("t.tsv", text.replace(",", "\t").encode(), mutated),
        Seed("t.json", json.dumps(keys).encode(), mutated_json),
        Seed("t.yaml", yaml.encode(), mutated),
    ]  # fmt: skip


def _intensity_seeds(folder: Path) -> list[Seed]:
    from deitalk.emotions import write_intensity_csv

    times = np.arange(5) / 30
    write_intensity_csv(
        folder / "i.csv", times=times, weights=np.full((5, 9), 0.2), saliency=times,
        predicted=times, intensity=times,
    )  # fmt: skip
    keys = [{"time": float(t), "intensity": 1.0} for t in times]
    return [
        Seed("i.csv", (folder / "i.csv").read_bytes(), mutated),
        Seed("i.csv", b"sep=;\r\ntime;intensity\r\n0;0,5\r\n1;1,5\r\n;;\r\n", mutated),
        Seed("i.json", json.dumps({"keys": keys}).encode(), mutated_json),
        Seed("i.yaml", b"- {time: 0, intensity: 1}\n- {time: 1.0, intensity: 0.5}\n", mutated),
    ]


def _read_emotion(path: Path) -> object:
    from deitalk.emotions import parse_emotion

    return parse_emotion(path).at(np.arange(10) / 30)


def _read_intensity(path: Path) -> object:
    from deitalk.emotions import read_intensity_curve

    return read_intensity_curve(path).at(np.arange(10) / 30)


def _mesh() -> Any:
    from rig.mesh import TriMesh

    return TriMesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 1]], [[0, 1, 2], [0, 2, 3]])


def _shapes() -> Any:
    from rig.mesh import ShapeSet

    deltas = np.zeros((3, 4, 3))
    deltas[:, 1] = 0.5
    return ShapeSet(_mesh(), ("jawOpen", "eyeBlink_L", "jawOpen_half"), deltas, {"chin": 1})


def _mesh_seeds(suffix: str, folder: Path) -> list[Seed]:
    from rig.mesh import write_ply
    from rig.mesh.glb import WeightAnimation, write_glb
    from tests.meshes import write_obj, write_shapes_npz

    path = folder / f"m{suffix}"
    if suffix == ".obj":
        write_obj(path, _mesh())
        quads = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1/1 2//2 \\\n3 -1\n"
        return [Seed(path.name, path.read_bytes(), mutated), Seed(path.name, quads, mutated)]
    if suffix == ".ply":
        seeds = []
        for ascii in (True, False):
            write_ply(path, _mesh(), ascii=ascii)
            seeds.append(Seed(path.name, path.read_bytes(), mutated))
        return seeds
    if suffix == ".glb":
        write_glb(path, _shapes(), animation=WeightAnimation(np.zeros((3, 3))))
        return [Seed(path.name, path.read_bytes(), mutated_glb)]
    write_shapes_npz(path, _shapes())
    return [Seed(path.name, path.read_bytes(), mutated_npz)]


def _read_mesh(path: Path) -> object:
    from rig.mesh.glb_reader import morph_names
    from rig.retarget.retarget_files import read_shapes

    if path.suffix == ".glb":
        morph_names(path)
    return read_shapes(path)


def _landmark_seeds(folder: Path) -> list[Seed]:
    from rig.retarget.landmarks import NEEDED

    marks = {name: [0.1 * i, 0, 0] if i % 2 else i % 4 for i, name in enumerate(NEEDED)}
    table = "name,vertex\n" + "".join(f"{name},{i % 4}\n" for i, name in enumerate(NEEDED))
    places = "name,x,y,z\n" + "".join(f"{name},{i},0,1.5\n" for i, name in enumerate(NEEDED))
    return [
        Seed("l.json", json.dumps(marks).encode(), mutated_json),
        Seed("l.csv", table.encode(), mutated),
        Seed("l.csv", places.encode(), mutated),
    ]


def _read_landmarks(path: Path) -> object:
    from rig.retarget.landmarks import read_landmarks

    return read_landmarks(path, _mesh())


def _mapping_seeds(folder: Path) -> list[Seed]:
    tree = {"smile": {"mouthCornerPullL": 1.0, "CTRL_C_jaw.ty": 0.5}, "b": {"jawOpen": -1}}
    return [
        Seed("m.json", json.dumps(tree).encode(), mutated_json),
        Seed("m.csv", b"shape,control,value\nsmile,jawOpen,1\nsmile,mouthCornerPullL,0.5\n", mutated),
    ]  # fmt: skip


def _read_mapping(path: Path) -> object:
    from rig.retarget.blendshapes import match_shapes
    from rig.retarget.mapping_files import read_mapping

    return match_shapes(("smile", "b", "jawOpen"), mapping=read_mapping(path))


def _tiny(folder: Path) -> Path:
    from deitalk.config.curves import Config
    from deitalk.models.checkpoint import save_model
    from deitalk.models.curve_model import DEITalk
    from deitalk.research.config import read_training

    config = read_training(CONFIGS / "tiny.yaml")
    assert isinstance(config, Config)
    save_model(folder / "tiny", DEITalk(config.model), config, {"steps": 1})
    return folder / "tiny"


def _model_seeds(folder: Path) -> list[Seed]:
    model = _tiny(folder)
    vertices = np.zeros((2, 4, 3), np.float32)
    vertices[:] = _mesh().vertices
    stream = io.BytesIO()
    np.savez_compressed(stream, vertices=vertices, faces=_mesh().faces.astype(np.int32))
    sdfa = (ROOT / "deitalk/models/weights/sdfa/config.yaml").read_bytes()
    return [
        Seed("config.yaml", (model / "config.yaml").read_bytes(), mutated),
        Seed("config.yaml", sdfa, mutated),
        Seed("model.json", (model / "model.json").read_bytes(), mutated_json),
        Seed("model.safetensors", (model / "model.safetensors").read_bytes(), mutated_safetensors),
        Seed("templates.npz", stream.getvalue(), mutated_npz),
    ]


def _read_model_file(path: Path) -> object:
    from deitalk.config.load import load_config
    from deitalk.models.folder import read_about
    from deitalk.models.mesh_folder import read_templates, whole_shapes
    from deitalk.models.weight_file import read_weights

    if path.name == "config.yaml":
        return load_config(path)
    if path.name == "model.json":
        return read_about(path.parent)
    if path.name == "model.safetensors":
        whole_shapes(path)
        return read_weights(path)
    try:
        return read_templates(path.parent, ["a", "b"])
    except (ValueError, LookupError, TypeError) as error:  # as in `load_model`
        from deitalk.errors import CheckpointError

        raise CheckpointError(error) from None


def _read_whole_model(path: Path) -> object:
    """Load a model folder with this file and otherwise valid files."""
    import shutil
    import tempfile

    from deitalk.models.checkpoint import load_model

    good = path.parent / "tiny"
    with tempfile.TemporaryDirectory() as made:
        shutil.copytree(good, Path(made) / "m")
        shutil.copy(path, Path(made) / "m" / path.name)
        return load_model(Path(made) / "m")


def _override_seeds(folder: Path) -> list[Seed]:
    texts = (
        b"train.batch_size=8", b"model.decoder_dilations=[1, 2, 4]", b"loss.control_weights={jaw: 2}",
        b"model.frontend={kind: mel, tapers: 2}", b"train.steps=&a 5", b"name=x",
    )  # fmt: skip
    return [Seed("o.txt", text, mutated) for text in texts]


def _read_override(path: Path) -> object:
    from deitalk.research.config import read_training

    text = path.read_bytes().decode("utf-8", "surrogateescape")
    return read_training(CONFIGS / "tiny.yaml", [text])


def _datagram_seeds(folder: Path) -> list[Seed]:
    from rig.livelink.protocols import LiveLinkFace

    values = np.linspace(0, 1, 61, dtype=np.float32)
    packets = LiveLinkFace().datagrams(5, 0.1, 29.97, values)
    return [Seed("d.bin", data, mutated) for data in packets]


def _read_datagram(path: Path) -> object:
    from rig.livelink.packet import decode
    from rig.livelink.receiver import Recording

    packet = decode(path.read_bytes())
    return Recording(packet.subject, (packet,)).to_take().to_curves()


def _audio_seeds(folder: Path) -> list[Seed]:
    import soundfile

    tone = 0.1 * np.sin(np.arange(4000) / 10)
    seeds = []
    for suffix, options in ((".wav", {"subtype": "PCM_16"}), (".wav", {"subtype": "FLOAT"}),
                            (".flac", {}), (".ogg", {}), (".mp3", {}), (".aiff", {})):  # fmt: skip
        path = folder / f"a{suffix}"
        soundfile.write(path, tone, 16_000, **options)
        seeds.append(Seed(path.name, path.read_bytes(), mutated))
    return seeds


def _read_audio(path: Path) -> object:
    from deitalk.audio.load import load_audio

    return load_audio(path)


def readers() -> dict[str, Reader]:
    """All readers by name."""
    found = {
        f"curves{suffix}": Reader(partial(_curve_seeds, suffix), _read_curves)
        for suffix in _formats()
    }
    found |= {
        f"mesh{suffix}": Reader(partial(_mesh_seeds, suffix), _read_mesh)
        for suffix in (".obj", ".ply", ".glb", ".npz")
    }
    return found | {
        **capture_readers(),
        "emotion": Reader(_track_seeds, _read_emotion),
        "intensity": Reader(_intensity_seeds, _read_intensity),
        "landmarks": Reader(_landmark_seeds, _read_landmarks),
        "mapping": Reader(_mapping_seeds, _read_mapping),
        "model": Reader(_model_seeds, _read_model_file),
        "model-load": Reader(_model_seeds, _read_whole_model),
        "override": Reader(_override_seeds, _read_override),
        "datagram": Reader(_datagram_seeds, _read_datagram),
        "validation": Reader(_checked_seeds, _check),
        "audio": Reader(_audio_seeds, _read_audio),
    }


SLOW = ("model-load", "audio")
"""Readers that are too slow for the tests of every change."""
