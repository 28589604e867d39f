"""What somebody changed in a take by hand, in any program, as a layer of edits.

The take is carried the same way as the edited file, to its rate, its frames of delay and handles,
its set of controls and back, and the two are compared there: what a format loses of both is no
change. ARKit shapes are compared as shapes.
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
from deitalk.pipeline.performance import DELAY
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.edges import HANDLES, TAKE_ABOUT, TAKE_CURVES, TAKE_SOUND, opened_take
from rig import Control, ControlSet, RigCurves, default_controls, read_curves, write_curves
from rig.controls import DEFAULT_ID
from rig.conversion.arkit import ARKIT_ID, N_SHAPES, arkit_controls
from rig.conversion.board_of_shapes import board_of_shapes
from rig.conversion.convert import KNOWN, convert, reached_controls
from rig.conversion.raw import RAW_ID
from rig.curves.apply_layers import Closures, apply_layers
from rig.curves.layer_diff import NOISE_SHARE, TOLERANCE, layer_of_changes
from rig.curves.layers import Layer
from rig.curves.shift import checked_shift, shift, unshifted
from rig.errors import listed
from rig.formats import livelink_csv, unreal_json
from rig.formats.table import find_format
from rig.formats.wide_csv import read_header

TABLES = (".csv", ".tsv", ".txt")
LEAST_LOST = 0.02
"""Least difference, of a control that another set does not give back, that is reported."""
FINER = (1.0, 0.5, 0.25)
"""Shares of the tolerance at which controls are fitted until the shapes of a file are within it."""
LEAST_FRAMES = 2
"""Most frames by which lengths differ without a note: a program's last frame."""


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
    delay: int = 0,
    handles: int = 0,
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
        See `rig.curves.layer_diff.layer_of_changes`; of ARKit shapes where the file has those.
    delay, handles : int
        Frames of the edited file, of its rate, that it was written with beside those of the take,
        which the take knows.
    name : str
        Of the layer.

    Raises
    ------
    DataError, rig.errors.RigError
        One line: what is wrong with a file, or that nothing is changed.
    """
    checked_shift(delay, handles)
    edited, take = Path(edited), Path(take)
    with opened_take(take, (TAKE_CURVES, TAKE_ABOUT, TAKE_SOUND)) as opened:
        return _changes(edited, opened, take, fps, tolerance, (delay, handles), name)


def _changes(
    edited: Path,
    take: Path,
    shown: Path,
    fps: float | None,
    tolerance: float,
    shifted: tuple[int, int],
    name: str,
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
    written = shift(base.resample(found.curves.fps), *shifted)
    found, notes = _in_time(found, len(written))
    twin = _twin(edited, written, found)
    found = _only_seen(found, twin)
    about = _about(take)
    settings = dict(about.get("settings", {}))
    rule = KeepContacts() if settings.get("rules", True) else None
    closures = None if rule is None else ControlGroups(controls).closures(rule)
    count = min(len(twin.curves), len(found.curves))
    start = written[:count]
    target = _moved(start, twin, found, controls, tolerance)
    notes += found.notes
    if abs(len(twin.curves) - len(found.curves)) > LEAST_FRAMES:
        notes.append(
            f"the edited file has {len(found.curves)} frames, {shown} {len(twin.curves)} at that "
            "rate: what is beyond the shorter one is not compared"
        )
    notes += _lost_notes(edited, target, twin, found, count)
    start, target, lost = _on_the_recording(start, target, base.fps, shifted, about, tolerance)
    notes += lost
    layer = _layer(start, target, controls, closures, tolerance, found)
    if not layer.edits:
        raise DataError(
            f"{edited} differs from {shown} by no more than noise ({tolerance / 2:g}); there is "
            "nothing to write"
        )
    lead = about.get(HANDLES, 0) / base.fps
    layer = _with_sound(replace(layer, name=name), take, settings, lead)
    if absent := [name for name in controls.names if name not in set(found.known)]:
        notes.append(
            f"{len(absent)} controls are not in the file and stay as they are: {listed(absent)}"
        )
    if "edit" in settings:
        way = f": --edit {shown} --edit …" if shown.is_dir() else ""
        notes.append(f"the take has layers of its own, which come first{way}")
    return Changes(layer, tuple(notes), layer.n_keys / max(base.values.size, 1))


def _layer(
    start: RigCurves,
    target: RigCurves,
    controls: ControlSet,
    closures: Closures | None,
    tolerance: float,
    found: CapturedCurves,
) -> Layer:
    """The layer within the tolerance: of controls, or of the shapes that the file has."""
    for share in FINER:
        layer = layer_of_changes(start, target, controls, closures, share * tolerance)
        if found.shapes is None:
            break
        applied, _ = apply_layers(start, [layer], controls, closures)
        there, wanted = (convert(c, ARKIT_ID).select(found.shapes.names) for c in (applied, target))
        if np.abs(there.values - wanted.values).max(initial=0) <= tolerance / 2:
            break
    return layer


def _on_the_recording(
    start: RigCurves,
    target: RigCurves,
    fps: float,
    shifted: tuple[int, int],
    about: dict[str, Any],
    tolerance: float,
) -> tuple[RigCurves, RigCurves, list[str]]:
    """Curves without the delay and the handles of the file, and then of the take; a note if so."""
    of_take = (about.get(DELAY, 0), about.get(HANDLES, 0))
    notes = []
    for rate, given in ((start.fps, shifted), (fps, of_take)):
        if not any(given):
            continue
        start, target = start.resample(rate), target.resample(rate)
        if len(start) <= 2 * given[1]:
            raise DataError(f"{len(start)} frames are no more than handles of {given[1]}")
        first, held = (unshifted(curves, *given) for curves in (start, target))
        left = np.abs(shift(held, *given).values - target.values).max() > tolerance
        if left:
            notes.append("changes in the handles, or in frames that a delay holds, are left out")
        start, target = first, held
    return start, target, notes


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
    names = tuple(n for n in known if n in shown)
    shapes = curves if curves.control_set == ARKIT_ID else None
    return CapturedCurves(board, names, "file", notes=curves.notes, shapes=shapes)


def _in_time(found: CapturedCurves, most: int) -> tuple[CapturedCurves, list[str]]:
    """Curves from the first frame of the take on, whose beginning a file may lack; a note if so.

    `most` is the number of frames of the take. Times of a file that would end after it are those
    of a program, whose first frame is any number.
    """
    late, curves = round(found.first * found.curves.fps), found.curves
    if not late:
        return found, []
    begins = f"its times begin at {found.first:.2f} s: "
    if not 0 < late <= most + LEAST_FRAMES - len(curves):
        return found, [f"{begins}its first row is compared with the first frame of the take"]
    seen = np.ones(len(curves), bool) if found.seen is None else found.seen
    seen = np.concatenate([np.zeros(late, bool), seen])
    rows = np.maximum(np.arange(-late, len(curves)), 0)

    def later(own: RigCurves) -> RigCurves:
        tracks: dict[str, Any] = {name: track[rows] for name, track in own.tracks.items()}
        return replace(own, values=own.values[rows], **tracks)

    shapes = None if found.shapes is None else later(found.shapes)
    found = replace(found, curves=later(curves), shapes=shapes, seen=seen)
    return found, [f"{begins}it is compared from there on"]


def _only_seen(found: CapturedCurves, twin: CapturedCurves) -> CapturedCurves:
    """Curves that are those of the take in frames that the file does not have."""
    if found.seen is None:
        return found
    lost = np.flatnonzero(~found.seen[: len(twin.curves)])

    def filled(own: RigCurves, other: RigCurves | None) -> RigCurves:
        if other is None:
            return own
        values, head = own.values.copy(), own.head
        values[lost] = other.select(own.names).values[lost]
        if head is not None and other.head is not None:
            head = head.copy()
            head[lost] = other.head[lost]
        return replace(own, values=values, head=head)

    shapes = None if found.shapes is None else filled(found.shapes, twin.shapes)
    return replace(found, curves=filled(found.curves, twin.curves), shapes=shapes)


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
    base: RigCurves,
    twin: CapturedCurves,
    found: CapturedCurves,
    controls: ControlSet,
    tolerance: float,
) -> RigCurves:
    """The take with what the file changes."""
    names = [name for name in controls.names if name in set(found.known)]
    places = controls.indices(names)
    edited, was = found.curves[: len(base)], twin.curves[: len(base)]
    values = base.values.copy()
    change = edited.reorder(controls).values - was.reorder(controls).values
    values[:, places] += change[:, places]
    values = np.clip(values, controls.minimum, controls.maximum)
    head = base.head
    if head is not None and was.head is not None and edited.head is not None:
        head = head + edited.head - was.head
    moved = replace(base, values=values, head=head)
    if found.shapes is None or twin.shapes is None:
        return moved
    now = _poses(found.shapes)[: len(base)]
    before = twin.shapes.select(now.names)[: len(base)]
    changed = np.abs(now.values - before.values) > NOISE_SHARE * tolerance
    wanted = np.where(changed, now.values, before.values)
    if {"MouthClose", "JawOpen"} <= set(now.names):  # lips meet and do not cross
        closed, jaw = now.index("MouthClose"), now.index("JawOpen")
        wanted[:, closed] = np.minimum(wanted[:, closed], wanted[:, jaw])
    rows = np.flatnonzero(changed.any(axis=1))
    values = base.values.copy()
    values[rows] = moved.values[rows]
    moved = replace(moved, values=values)
    return board_of_shapes(moved, replace(now, values=wanted))


def _poses(shapes: RigCurves) -> RigCurves:
    """Select the shapes that are no turns of the head or of an eye."""
    poses = set(arkit_controls().names[:N_SHAPES])
    return shapes.select([name for name in shapes.names if name in poses])


def _about(take: Path) -> dict[str, Any]:
    """The record of a take folder; nothing of a file of curves."""
    path = take / TAKE_ABOUT
    if not take.is_dir() or not path.is_file():
        return {}
    try:
        about = dict(json.loads(path.read_text(encoding="utf-8")))
        checked_shift(about.get(DELAY, 0), about.get(HANDLES, 0))
        return about | {"settings": dict(about["settings"])}
    except (ValueError, KeyError, TypeError):
        raise DataError(f"{path} is damaged; animate the recording again") from None


def _with_sound(layer: Layer, take: Path, settings: dict[str, Any], lead: float) -> Layer:
    """The layer with what it takes to follow another recording of the line.

    `lead` is the silence of the handles at both ends of the take's sound, seconds.
    """
    sound = take / TAKE_SOUND
    if not take.is_dir() or not sound.is_file():
        return layer
    from deitalk.audio.load import load_audio
    from deitalk.pipeline.layer_sounds import with_recording
    from deitalk.pipeline.speech import Speech

    recording = load_audio(sound)
    silent = round(lead * recording.sample_rate)
    waveform = recording.waveform[silent : len(recording.waveform) - silent]
    speech, words = Speech.of_recording(replace(recording, waveform=waveform)), None
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
    path: Path, target: RigCurves, twin: CapturedCurves, found: CapturedCurves, count: int
) -> list[str]:
    """Whether the layer, carried like the file, gives its curves."""
    if found.kind in ("board", "rig", "emoface"):
        return []
    again = _twin(path, target, found)
    there, wanted, what, notes = again.curves, found.curves, "controls", []
    if found.shapes is not None and twin.shapes is not None and again.shapes is not None:
        wanted, was = _poses(found.shapes), twin.shapes.select(found.shapes.names)
        there, what = again.shapes.select(wanted.names), "shapes"
        turned = np.abs(found.shapes.values[:count] - was.values[:count]).max(axis=0)
        eyes = [name for name, much in zip(found.shapes.names, turned, strict=True)
                if name.startswith(("LeftEye", "RightEye")) and much > LEAST_LOST]  # fmt: skip
        if eyes:
            notes = [f"{listed(eyes)} are not read: the shapes EyeLook… turn the eyes"]
    missed = np.abs(there.values[:count] - wanted.values[:count]).max(axis=0)
    names = [there.names[k] for k in np.argsort(-missed) if missed[k] > LEAST_LOST]
    if not names:
        return notes
    return [
        *notes,
        f"the board has no pose with all of the file's values: carried back, these {what} "
        f"differ by up to {missed.max():.2f} from the edited file: {listed(names)}",
    ]
