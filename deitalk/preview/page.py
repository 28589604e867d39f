"""The preview page: one HTML file with the player, the head, the curves and the recording.

The player is built from ``deitalk/preview/web/`` by ``npm run build`` into ``app/index.html``
beside this file; this module inserts the data.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.voice_activity import speech_activity
from deitalk.config.rules import KeepContacts
from deitalk.errors import MissingError
from deitalk.pipeline.performance import Performance
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.preview.curves_page import write_curves_page
from deitalk.preview.packing import pack, pack_bytes
from deitalk.preview.source import (
    PreviewError,
    PreviewSource,
    check_board,
    sound_as_wav,
)
from deitalk.preview.speech_warnings import find_warnings
from rig.controls import default_controls
from rig.emotions import LABELS
from rig.face import build_head
from rig.face.head_pose import JOINT, neck_share
from rig.face.identity import Identity
from rig.face.mesh import FINE, HAIR
from rig.face.render import VIEWS
from rig.face.render.shading import glsl, glsl_background
from rig.face.web_export import head_arrays
from rig.files import atomic_write, check_file

BUNDLE = Path(__file__).parent / "app" / "index.html"
_SLOT = "<!--deitalk-data-->"
_QUICK = 1
MAX_TAKES = 6


def render_page(
    sources: PreviewSource | Sequence[PreviewSource],
    out: Path | str,
    *,
    identity: int | str | Identity = 0,
    force: bool = False,
) -> Path:
    """Write a page that opens offline and plays a take, or several side by side.

    Curves of a rig other than the board are shown as lines, without a head.

    Parameters
    ----------
    sources : PreviewSource or sequence of them
        One to six takes, from `load_source`.
    out : Path or str
        The ``.html`` to write.
    identity : int, str or Identity, optional
        Head of the preview.
    force : bool, optional
        Replace an existing file.

    Raises
    ------
    PreviewError
        If the source cannot be shown or the target is no page.
    rig.errors.TargetError
        If the target exists and `force` is not set, or it cannot be written.
    MissingError
        If this installation has no player.
    """
    out = Path(out)
    if out.suffix.lower() not in (".html", ".htm"):
        raise PreviewError(f"{out} has suffix {out.suffix or 'none'!r}; a page is a .html file")
    check_file(out, force=force)
    if isinstance(sources, PreviewSource):
        sources = [sources]
    if not 1 <= len(sources) <= MAX_TAKES:
        raise PreviewError(f"{len(sources)} takes; a page shows 1 to {MAX_TAKES}")
    if not all(source.is_board for source in sources):
        write_curves_page(sources, out)
        return out
    player = _player()
    blocks = [_block("head", _packed_head(identity))]
    blocks += [_block(f"take-{k}", pack(*_take_arrays(take))) for k, take in enumerate(sources)]
    blocks += [_block(f"audio-{k}", sound_as_wav(take)) for k, take in enumerate(sources)]
    page = player.replace(_SLOT, "\n".join(blocks))
    with atomic_write(out) as beside:
        beside.write_text(page, encoding="utf-8")
    return out


def add_preview(
    folder: Path, performance: Performance, identity: int | str | Identity = 0
) -> dict[str, str]:
    """Write ``preview.html`` into a take folder.

    Parameters
    ----------
    folder : Path
        Must exist.
    performance : Performance
        Its curves, neutral reading and recording are shown.
    identity : int, str or Identity
        Head that is shown.

    Returns
    -------
    dict
        File name and its description, for ``take.json``.

    Raises
    ------
    MissingError
        Without the built page.
    """
    source = PreviewSource(
        title=Path(performance.recording.source).stem,
        curves=performance.curves,
        samples=performance.recording.waveform,
        sample_rate=SAMPLE_RATE,
        neutral=performance.neutral.values,
    )
    render_page(source, folder / "preview.html", identity=identity)
    about = "face, sound and every curve in one page; the intensity can be dragged"
    return {"preview.html": about if source.is_board else "sound and every curve in one page"}


def render_studio(identity: int | str | Identity = 0) -> str:
    """Return the page that a service shows: the player and a head, without a take.

    Raises
    ------
    MissingError
        If this installation has no player.
    """
    blocks = [_block("head", _packed_head(identity)), _block("service", "v1")]
    return _player().replace(_SLOT, "\n".join(blocks))


def render_site(facts: Mapping[str, Any], identity: int | str | Identity = 0) -> str:
    """Return the page that animates recordings by itself, with the `facts` of its model.

    Raises
    ------
    MissingError
        If this installation has no player.
    """
    text = json.dumps(facts).replace("<", "\\u003c")
    blocks = [_block("head", _packed_head(identity)), _block("site", text)]
    return _player().replace(_SLOT, "\n".join(blocks))


def pack_source(source: PreviewSource) -> bytes:
    """Return the arrays of a take and its recording, for a page that is open already."""
    check_board(source)
    arrays, facts = _take_arrays(source)
    arrays["audio"] = np.round(np.clip(source.samples, -1, 1) * 32767).astype(np.int16)
    return pack_bytes(arrays, facts | {"sampleRate": source.sample_rate}, level=_QUICK)


def check_player() -> None:
    """Check that this installation has the page's player.

    Raises
    ------
    MissingError
        If the package was built without it.
    """
    if not BUNDLE.is_file():
        raise MissingError(
            "this installation has no preview page; `make page` in the source builds it; "
            "a video (.mp4) does not need it"
        )


def _player() -> str:
    check_player()
    return BUNDLE.read_text(encoding="utf-8")


def _block(name: str, text: str) -> str:
    return f'<script type="text/plain" id="{name}">{text}</script>'


@lru_cache(maxsize=4)
def _packed_head(identity: int | str | Identity) -> str:
    head = build_head(identity)
    arrays, facts = head_arrays(head)
    arrays["neck.share"] = neck_share(head.mesh.vertices).astype(np.float32)
    facts["joint"] = JOINT.tolist()
    controls = default_controls()
    facts["sets"] = {name: controls.subset(name).tolist() for name in controls.subset_names}
    facts["closures"] = asdict(ControlGroups(controls).closures(KeepContacts()))
    light, sky = glsl(), glsl_background()
    facts["shaders"] = {
        "vertex": light[0], "fragment": light[1], "skyVertex": sky[0], "skyFragment": sky[1],
    }  # fmt: skip
    facts["softKinds"] = [HAIR, FINE]
    facts["views"] = {
        name: {"target": view.target, "position": view.position, "degrees": view.degrees}
        for name, view in VIEWS.items()
    }
    return pack(arrays, facts)


def _take_arrays(source: PreviewSource) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    curves = source.curves
    arrays: dict[str, NDArray[Any]] = {"values": np.ascontiguousarray(curves.values, np.float32)}
    if source.neutral is not None:
        arrays["neutral"] = np.ascontiguousarray(source.neutral, np.float32)
    if source.sample_rate == SAMPLE_RATE:
        speaking = speech_activity(source.samples)[: len(curves)]
        arrays["speaking"] = np.asarray(speaking > 0, np.uint8)
    for name, track in curves.tracks.items():
        arrays[name] = np.ascontiguousarray(track, np.float32)
    facts = {
        "title": source.title, "fps": curves.fps, "frames": len(curves), "emotions": list(LABELS),
        "audioSeconds": source.audio_seconds,
        "warnings": [{"time": time, "text": text} for time, text in find_warnings(source)],
    }  # fmt: skip
    return arrays, facts
