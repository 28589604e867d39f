"""A static folder that animates recordings in a browser: ``deitalk export web``.

Page, head, a model for whole recordings and one for live voices, with their rules, and ONNX
Runtime; any static host serves it, and nothing that a user drops or says leaves the machine. Models
and runtime are packed, and unpacked in the browser: of a model first all even bytes, then all odd
ones, so that the upper halves of its weights, which alone can be made smaller, are together. The
live model's file has only the weights that the other one lacks, and is of one voice, three frames a
run, which take less than half the time of three runs: it is
spent on reading the weights and on a thousand small operators. The operators of the other one are
fused for ONNX Runtime, which opens it in two thirds of the time; of the live model this would be no
faster, and larger.
"""

import json
import shutil
import tempfile
import zlib
from pathlib import Path
from typing import Any

from deitalk.acting import Acting
from deitalk.emotions import LABELS
from deitalk.errors import CheckpointError, MissingError
from deitalk.export.onnx_file import export_onnx
from deitalk.models.causal_model import causal_frontend
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.onnx.fusing import fused
from deitalk.postprocess.tracks import N_MOTION, N_VARIANTS
from deitalk.preview.packing import planes
from deitalk.preview.page import BUNDLE, check_player, render_site
from rig.controls import DEFAULT_ID
from rig.conversion.raw import raw_controls, raw_knots
from rig.face.identity import Identity
from rig.files import output_folder
from rig.formats.livelink_csv import SUBJECT_REST

WASM, MODEL, LIVE_MODEL = "ort-wasm-simd-threaded.wasm", "model.onnx", "live.onnx"
PACKED = ".planes.gz"
"""Suffix of a packed model in the folder."""
SHARED_BYTES = 4096
"""Bytes of a weight from which the file of the other model is looked through for it."""
LIVE = ("frames", "window", "before", "delay", "behind", "state")
"""Metadata of a live model that the page must know."""
COPIED = ("engine.js", "ort.wasm.bundle.min.mjs")
POLICY = "script-src 'self' 'unsafe-inline'"
"""Content security policy of the page, to which WebAssembly and a worker are added."""


def export_site(
    out: Path,
    model: str | Path = "default",
    identity: int | str | Identity = 0,
    *,
    live: bool = True,
    force: bool = False,
) -> int:
    """Write the folder; return its bytes.

    Parameters
    ----------
    out : Path
        Folder to write.
    model : str or Path
        For whole recordings, of the board's controls.
    identity : int, str or Identity
        Head that is shown.
    live : bool
        Animate the microphone too, by the model ``live``.
    force : bool
        Replace a folder of this kind.

    Raises
    ------
    CheckpointError
        If there is no such model, or it is causal or of another rig.
    MissingError
        If this installation has no page, or a package of the export is not installed.
    rig.errors.TargetError
        If the folder holds other files, or is there and `force` is not set.
    """
    check_player()
    app = BUNDLE.parent
    if missing := [name for name in (*COPIED, WASM) if not (app / name).is_file()]:
        raise MissingError(f"this installation has no {missing[0]}; `make page` in the source")
    network = require_model(model, DEITalk)
    if network.is_causal or network.controls.id != DEFAULT_ID:
        raise CheckpointError(
            f"model {model}: a site has a model for whole recordings of the board, such as default"
        )
    with output_folder(out, kind="site", force=force) as beside:
        facts = _facts(network)
        with tempfile.TemporaryDirectory() as folder:
            file, live_file = Path(folder) / MODEL, Path(folder) / LIVE_MODEL
            export_onnx(network, file, name=Path(model).name, precision="float16")
            _fuse(file)
            _pack_model(file, beside)
            if live:
                voice = require_model("live", DEITalk)
                n_frames = causal_frontend(voice).delay
                export_onnx(voice, live_file, precision="float16", n_frames=n_frames)
                facts["live"] = _reduce_live(live_file, file)
                _pack_model(live_file, beside)
        page = render_site(facts, identity)
        page = page.replace(POLICY, f"{POLICY} 'wasm-unsafe-eval'; worker-src 'self'")
        (beside / "index.html").write_text(page, encoding="utf-8")
        for name in COPIED:
            shutil.copyfile(app / name, beside / name)
        (beside / f"{WASM}.gz").write_bytes(_gzip((app / WASM).read_bytes()))
        return sum(path.stat().st_size for path in beside.iterdir())


def _pack_model(source: Path, folder: Path) -> None:
    """Write a model of float16 as planes of bytes."""
    packed = _gzip(planes(source.read_bytes(), 2), zlib.Z_FILTERED)
    (folder / f"{source.name}{PACKED}").write_bytes(packed)


def _gzip(content: bytes, strategy: int = zlib.Z_DEFAULT_STRATEGY) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, 16 + zlib.MAX_WBITS, strategy=strategy)
    return packer.compress(content) + packer.flush()


def _fuse(file: Path) -> None:
    """Give a model the operators that ONNX Runtime fuses; its weights of float16 stay as such."""
    import onnx

    content = onnx.load(str(file))
    half = onnx.TensorProto.FLOAT16
    found = fused(content, {w.name for w in content.graph.initializer if w.data_type == half})
    found.metadata_props.extend(content.metadata_props)
    file.write_bytes(found.SerializeToString())


def _reduce_live(file: Path, other: Path) -> dict[str, int]:
    """Have a live model take one voice, and read the weights that another file has too there.

    Returns its numbers that the page must know.
    """
    import onnx

    content, known = onnx.load(str(file)), other.read_bytes()
    for weight in content.graph.initializer:
        place = known.find(weight.raw_data) if len(weight.raw_data) >= SHARED_BYTES else -1
        if place < 0:
            continue
        at = {"location": MODEL, "offset": place, "length": len(weight.raw_data)}
        weight.ClearField("raw_data")
        weight.data_location = onnx.TensorProto.EXTERNAL
        for key, value in at.items():
            weight.external_data.add(key=key, value=str(value))
    for value in (*content.graph.input, *content.graph.output):
        value.type.tensor_type.shape.dim[0].dim_value = 1
    file.write_bytes(content.SerializeToString())
    texts = {entry.key: entry.value for entry in content.metadata_props}
    found = {key: json.loads(texts[key]) for key in LIVE}
    return found | {"actors": len(json.loads(texts["actors"]))}


def _facts(network: DEITalk) -> dict[str, Any]:
    """Facts on the model and on the formats that the page writes."""
    knots = raw_knots()
    raw = [
        {
            "name": control.name,
            "control": knots[control.name][0],
            "rest": control.rest,
            "places": knots[control.name][1][0],
            "values": knots[control.name][1][1],
        }
        for control in raw_controls().controls
    ]
    return {
        "emotions": list(LABELS),
        "actors": list(network.actors),
        "variants": N_VARIANTS + 1,
        "motion": N_MOTION,
        "rest": Acting().rest,
        "raw": raw,
        "subject": list(SUBJECT_REST),
    }
