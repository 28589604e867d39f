"""What somebody changed in a take by hand, in any program, as a layer of edits.

The take is carried the same way as the edited file, to its rate and its set of controls and back,
and the two are compared there: what a format loses of both is no change.
"""

import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.acting import Acting
from deitalk.config.rules import KeepContacts
from deitalk.data.captures.take import CapturedCurves, kind_of, read_capture
from deitalk.errors import DataError
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.joins import TAKE_ABOUT, TAKE_CURVES, TAKE_SOUND, opened_take
from rig import Control, ControlSet, RigCurves, default_controls, read_curves, write_curves
from rig.controls import DEFAULT_ID
from rig.conversion.arkit import ARKIT_ID, RAW_ID
from rig.conversion.convert import KNOWN, convert, reached_controls
from rig.curves.apply_layers import apply_layers
from rig.curves.layer_diff import TOLERANCE, layer_of_changes
from rig.curves.layers import Layer
from rig.errors import listed
from rig.formats import livelink_csv, unreal_json
from rig.formats.table import find_format
from rig.formats.wide_csv import read_header

TABLES = (".csv", ".tsv", ".txt")
LEAST_LOST = 0.02
"""Of a control that another set of controls does not give back, to be reported."""
LEAST_FRAMES = 2
"""By which lengths may differ without a note: a program's last frame."""


@dataclass(frozen=True)
class Changes:
    """A layer and what there is to say about it.

    Attributes
    ----------
    layer : Layer
        Knows the recording of the take, if that is there.
    notes : tuple of str
        What was not compared, or cannot be carried back.
    share : float
        Keys of the layer over the values (frames times controls) of the take.
    """

    layer: Layer
    notes: tuple[str, ...]
    share: float


def changes_of_take(
    edited: Path | str,
    take: Path | str,
    *,
    fps: float | None = None,
    tolerance: float = TOLERANCE,
    name: str = "",
) -> Changes:
    """What an edited file changes of a take.

    Parameters
    ----------
    edited : Path or str
        Curves of the board, raw curves or ARKit shapes in any format that is read.
    take : Path or str
        Folder of `deitalk animate`, that folder zipped, or a file of its curves.
    fps : float, optional
        Of a file without a rate.
    tolerance : float
        See `rig.curves.layer_diff.layer_of_changes`.
    name : str
        Of the layer.

    Raises
    ------
    DataError, rig.errors.RigError
        One line: what is wrong with a file, or that nothing is changed.
    """
    edited, take = Path(edited), Path(take)
    with opened_take(take, (TAKE_CURVES, TAKE_ABOUT, TAKE_SOUND)) as opened:
        return _changes(edited, opened, take, fps, tolerance, name)


def _changes(
    edited: Path, take: Path, shown: Path, fps: float | None, tolerance: float, name: str
) -> Changes:
    """What an edited file changes of a take, which messages name by a path of its own."""
    path = take / TAKE_CURVES if take.is_dir() else take
    if not path.is_file():
        raise DataError(f"{shown} has no {TAKE_CURVES}; name a folder that deitalk animate wrote")
    base = read_curves(path, control_set=None)
    own = _own_controls(base)
    if own is None:
        found = _read(edited, fps)
    else:
        curves = read_curves(edited, control_set=None, fps=fps)
        if set(curves.names) != set(base.names):
            raise DataError(
                f"{edited} has other controls than the take, which is of {base.control_set}"
            )
        found = CapturedCurves(curves.select(base.names), base.names, "rig")
    controls = own or default_controls()
    twin = _twin(edited, base.resample(found.curves.fps), found)
    settings = _settings(take)
    rule = KeepContacts() if settings.get("rules", True) else None
    closures = None if rule is None else ControlGroups(controls).closures(rule)
    count = min(len(twin.curves), len(found.curves))
    start = base.resample(found.curves.fps)[:count]
    target = _moved(start, twin.curves[:count], found, controls)
    layer = layer_of_changes(start, target, controls, closures, tolerance)
    if not layer.edits:
        raise DataError(
            f"{edited} differs from {shown} by no more than noise ({tolerance / 2:g}); there is "
            "nothing to write"
        )
    layer = _with_sound(replace(layer, name=name), take, settings)
    notes = list(found.notes)
    if abs(len(twin.curves) - len(found.curves)) > LEAST_FRAMES:
        notes.append(
            f"the edited file has {len(found.curves)} frames, {shown} {len(twin.curves)} at that "
            "rate: what is beyond the shorter one is not compared"
        )
    if absent := [name for name in controls.names if name not in set(found.known)]:
        notes.append(
            f"{len(absent)} controls are not in the file and stay as they are: {listed(absent)}"
        )
    applied, _ = apply_layers(start, [layer], controls, closures)
    notes += _lost_notes(edited, applied, twin, found, count)
    if "edit" in settings:
        way = f": --edit {shown} --edit …" if shown.is_dir() else ""
        notes.append(f"the take has layers of its own, which come first{way}")
    return Changes(layer, tuple(notes), layer.n_keys / max(base.values.size, 1))


def _own_controls(base: RigCurves) -> ControlSet | None:
    """Controls of a take of another rig, whose ranges are unknown here; None of the board."""
    if base.control_set in KNOWN:
        if base.control_set != DEFAULT_ID:
            raise DataError(
                f"the take's curves are {base.control_set}; name the take folder itself"
            )
        return None
    wide = (Control(name, minimum=-1e6, maximum=1e6) for name in base.names)
    return ControlSet(base.control_set, tuple(wide))


def _read(path: Path, fps: float | None) -> CapturedCurves:
    """Edited curves as channels of the board, and those that the file can know."""
    kind = kind_of(path)
    if kind == "video":
        raise DataError(f"{path} is a video or its landmarks; give curves that were edited")
    if kind is not None:
        found = read_capture(path, fps=fps)
        if found.kind == "foreign":
            raise DataError(f"{path} has shapes of an avatar, which no take is carried back from")
        if kind == "curves":  # with its head, which a capture of the board leaves out
            head = read_curves(path, control_set=None).head
            found = replace(found, curves=replace(found.curves, head=head))
        return found
    curves, shows = read_curves(path, fps=fps, control_set=None), find_format(path).shows
    known = reached_controls(curves.names, curves.control_set)
    shown = set(known if shows is None else shows())
    board = convert(curves, DEFAULT_ID).reorder(default_controls())
    return CapturedCurves(board, tuple(n for n in known if n in shown), "file", notes=curves.notes)


def _twin(path: Path, base: RigCurves, found: CapturedCurves) -> CapturedCurves:
    """The take as it would be read, had nobody edited the file."""
    if found.kind in ("board", "rig", "emoface"):
        return replace(found, curves=base)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "twin.csv"
        if found.kind == "file":
            copy = Path(folder) / f"twin{find_format(path).suffixes[0]}"
            write_curves(copy, base)
            return _read(copy, None)
        control_set, form = _set_of(path, found.kind), "csv"
        if found.kind == "livelink":
            form = "livelink" if control_set == ARKIT_ID else "livelink-raw"
        elif control_set == DEFAULT_ID:
            return replace(found, curves=base)
        carried = convert(base, control_set)
        if path.suffix.lower() in TABLES and form == "csv":  # which may have some columns alone
            present = [name for name in read_header(path) if name in KNOWN[control_set]()]
            carried = carried.select(KNOWN[control_set]().resolve(present))
        write_curves(copy, carried, format=form)
        return read_capture(copy)


def _set_of(path: Path, kind: str) -> str:
    """The set of controls of a file of some kind."""
    if kind == "livelink":
        return livelink_csv.read_take(path).to_curves().control_set
    if kind == "unreal":
        return unreal_json.read_present(path)[0].control_set
    return {"raw": RAW_ID, "arkit": ARKIT_ID}.get(kind, DEFAULT_ID)


def _moved(
    base: RigCurves, twin: RigCurves, found: CapturedCurves, controls: ControlSet
) -> RigCurves:
    """The take with what the file changes."""
    names = [name for name in controls.names if name in set(found.known)]
    places = controls.indices(names)
    edited = found.curves[: len(base)].reorder(controls)
    values = base.values.copy()
    values[:, places] += edited.values[:, places] - twin.reorder(controls).values[:, places]
    values = np.clip(values, controls.minimum, controls.maximum)
    head = base.head
    if head is not None and twin.head is not None and edited.head is not None:
        head = head + edited.head - twin.head
    return replace(base, values=values, head=head)


def _settings(take: Path) -> dict[str, Any]:
    path = take / TAKE_ABOUT
    if not take.is_dir() or not path.is_file():
        return {}
    try:
        return dict(json.loads(path.read_text(encoding="utf-8"))["settings"])
    except (ValueError, KeyError, TypeError):
        raise DataError(f"{path} is damaged; animate the recording again") from None


def _with_sound(layer: Layer, take: Path, settings: dict[str, Any]) -> Layer:
    """The layer with what it takes to follow another recording of the line."""
    sound = take / TAKE_SOUND
    if not take.is_dir() or not sound.is_file():
        return layer
    from deitalk.audio.load import load_audio
    from deitalk.pipeline.layers import with_recording
    from deitalk.pipeline.speech import Speech

    speech, words = Speech.of_recording(load_audio(sound)), None
    spoken = {n: settings[n] for n in ("words", "script", "language", "role") if n in settings}
    if spoken.keys() & {"words", "script"}:
        from deitalk.pipeline.curves import read_words
        from deitalk.pipeline.words.align import align_words

        transcript, script = read_words(Acting.of(files={}, **spoken))
        transcript = transcript or (None if script is None else script.transcript)
        words = None if transcript is None else align_words(speech, transcript)
    (layer,) = with_recording([layer], speech, words)
    return layer


def _lost_notes(
    path: Path, applied: RigCurves, twin: CapturedCurves, found: CapturedCurves, count: int
) -> list[str]:
    """Whether the layer, carried like the file, gives its curves."""
    if found.kind in ("board", "rig", "emoface"):
        return []
    again = _twin(path, applied, found).curves[:count]
    missed = np.abs(again.values - found.curves[: len(again)].values).max(axis=0)
    names = [again.names[k] for k in np.argsort(-missed) if missed[k] > LEAST_LOST]
    if not names:
        return []
    return [
        f"the file's controls say less than the board's: carried back, {len(names)} differ by up "
        f"to {missed.max():.2f} from the edited file: {listed(names)}"
    ]
