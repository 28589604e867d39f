"""Another recording for a performance: the face stays, the mouth speaks the new voice.

Brows, eyes, nose, cheeks, neck and head are those of the performance on the time of the new sound;
lips, jaw and tongue are those that `deitalk.animate` gives of the new sound, opened as far as the
performance opened them. The corners of the mouth keep the slow part of the performance, its
emotion, and take the quick part, the speech, of the new sound.

Time goes phrase by phrase. A phrase that lasts about as long in both recordings is copied frame by
frame; others are stretched within a limit; beyond it frames are left out, or played to and fro,
and the ends are joined over a third of a second.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.acting import Acting
from deitalk.audio.arrays import Audio
from deitalk.audio.frames import FRAME_RATE, runs
from deitalk.audio.load import Recording, load_audio
from deitalk.config.rules import KeepContacts
from deitalk.data.captures.columns import RigMapping
from deitalk.data.captures.take import read_capture
from deitalk.errors import DataError
from deitalk.pipeline.curves import animate, join
from deitalk.pipeline.layers import edited
from deitalk.pipeline.performance import Performance
from deitalk.pipeline.speech import Speech
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.edges import TAKE_CURVES, TAKE_SOUND, opened_take
from rig import ControlSet, RigCurves, default_controls, read_curves
from rig.arrays import Bool, Float32, Float64
from rig.controls import DEFAULT_ID
from rig.curves.edit import clamp, gain
from rig.curves.filters import gaussian_smooth
from rig.errors import listed

STRETCH = 1.5
"""Largest factor by which a phrase or a pause is played slower or faster."""
SAME_SECONDS = 0.2
"""Difference of two phrases that are not stretched; the pause after them takes it."""
PAUSE_SECONDS = 0.3
"""Silence that ends a phrase."""
JOIN_FRAMES = 10
"""Over which two places of the performance that do not follow each other are joined."""
MOST_TOGETHER = 3
"""Phrases of one recording that one of the other can stand for."""
GROUP_COST = 0.3
"""Cost of a phrase that stands for a part of another, as the logarithm of a stretch."""
CORNER_SECONDS = 0.2
"""Deviation of the filter that divides the corners' emotion from their speech."""
AMPLITUDE = (0.5, 1.8)
"""Least and greatest factor on the opening of the mouth."""
MOUTH_REGIONS = ("mouth", "jaw", "tongue", "teeth")
CORNERS = ("cornerPull", "cornerDepress", "dimple", "mouth_stretch.", "sharpCornerPull", "corner.t")
SOUNDS = (".wav", ".flac", ".mp3", ".m4a", ".ogg", ".opus", ".mov", ".mp4")
REPORT = "dub.json"


@dataclass(frozen=True)
class Piece:
    """A stretch of the new recording and what of the performance is shown in it.

    Attributes
    ----------
    kind : str
        ``phrase`` or ``pause``.
    start, end : float
        Seconds of the new recording.
    source_start, source_end : float
        Seconds of the performance that are shown.
    rate : float
        Seconds of the performance for one of the recording: 1 is not stretched.
    joined : bool
        Whether the end is joined to another place of the performance.
    turned : bool
        Whether its end was played to and fro, as the performance has too little.
    """

    kind: str
    start: float
    end: float
    source_start: float
    source_end: float
    rate: float
    joined: bool = False
    turned: bool = False


@dataclass(frozen=True)
class Dubbed:
    """A performance with another voice.

    Attributes
    ----------
    performance : Performance
        Of the new recording.
    pieces : tuple of Piece
        What was shown when.
    exact : array [shape=(T,)]
        Whether a frame's face is one of the performance, unchanged.
    kept : tuple of str
        Controls that are those of the performance.
    amplitude : float
        Factor on the opening of the mouth.
    notes : tuple of str
        What was guessed, and what is not known.
    stretch : float
        The limit.
    """

    performance: Performance
    pieces: tuple[Piece, ...]
    exact: Bool
    kept: tuple[str, ...]
    amplitude: float
    notes: tuple[str, ...]
    stretch: float = STRETCH

    @cached_property
    def line(self) -> str:
        """One line: how much is unchanged, stretched and joined."""
        count = len(self.exact) / FRAME_RATE
        stretched = [piece for piece in self.pieces if piece.rate != 1]
        most = max((max(p.rate, 1 / p.rate) for p in stretched), default=1.0)
        joins = sum(piece.joined for piece in self.pieces)
        return (
            f"{self.exact.sum() / FRAME_RATE:.1f} of {count:.1f} s of the face are unchanged, "
            f"{sum(p.end - p.start for p in stretched):.1f} s are stretched (up to {most:.2f}), "
            f"{joins} joins; mouth opened {self.amplitude:.2f} times"
        )

    def write_report(self, folder: Path, performance: Performance) -> dict[str, str]:
        """Write the report into a take folder: an extra of `write_take`."""
        tree = {
            "schema": "deitalk.dub/1", "summary": self.line, "amplitude": round(self.amplitude, 4),
            "stretch_limit": self.stretch, "kept": list(self.kept), "notes": list(self.notes),
            "pieces": [
                {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(piece).items()}
                for piece in self.pieces
            ],
        }  # fmt: skip
        (folder / REPORT).write_text(json.dumps(tree, indent=1) + "\n", encoding="utf-8")
        return {REPORT: "what of the performance was kept, stretched and joined where"}


def dub(
    performance: Path | str,
    audio: Audio,
    *,
    sound: Path | str | Recording | None = None,
    acting: Acting | None = None,
    mapping: RigMapping | None = None,
    stretch: float = STRETCH,
    fps: float | None = None,
    perform: Callable[..., Performance] = animate,
    **options: Any,
) -> Dubbed:
    """Give a performance another voice.

    Parameters
    ----------
    performance : Path or str
        A take folder, a zipped take, or a file of captured or keyed curves: see
        `deitalk.data.captures.take.read_capture`.
    audio : path, bytes, file object, Recording, array or tensor
        The new recording, as for `deitalk.animate`.
    sound : Path, str or Recording, optional
        Recording of the performance; by default that of the take, or a file of the same name
        beside the curves. Without one its phrases are those of its mouth.
    acting : Acting, optional
        How the new recording is acted. Its gain scales the performance too, takes beside it
        (`after`, `into`) are joined as those of `deitalk.animate` are, edits come last.
    mapping : RigMapping, optional
        Of another rig's curves to the board.
    stretch : float
        Limit, 1 to 3.
    fps : float, optional
        Of a file without a rate.
    perform : callable
        Animates a recording: `animate`.
    **options
        Of `animate`.

    Raises
    ------
    DataError, rig.errors.RigError, AudioError
        One line: what is wrong with a file.
    """
    if not 1 <= stretch <= 3:
        raise DataError(f"stretch {stretch:g} must be 1 to 3")
    with opened_take(Path(performance), (TAKE_CURVES, TAKE_SOUND)) as path:
        if path.is_dir() and not (path / TAKE_CURVES).is_file():
            raise DataError(
                f"{performance} has no {TAKE_CURVES}; name a take folder or a file of curves"
            )
        face, known, notes = _read(path, mapping, fps)
        old, source = _phrases_of(path, face, sound)
    acting = Acting.of(acting)
    if acting.gain:
        face, _ = clamp(gain(face, acting.gain))
    made = perform(audio, acting=Acting.of(acting, edit=()), **options)  # edits come last
    controls = default_controls()
    if made.curves.control_set != DEFAULT_ID:
        raise DataError(f"the model's curves are of {made.curves.control_set}; dub with the board")
    new = phrases(made.recording.activity > 0, len(made.curves))
    clock = _Clock(len(face), len(made.curves), stretch)
    pieces = clock.run(paired_phrases(old, new, stretch))
    kept = [name for name in controls.names if name in known and not _is_mouth(controls, name)]
    places = controls.indices(kept)
    values = made.curves.values.copy()
    values[:, places] = clock.shown(face.values[:, places])
    corners = [k for k in _corners(controls) if controls.names[k] in known]
    values[:, corners] = _with_emotion(
        clock.shown(face.values[:, corners]), values[:, corners], controls, corners
    )
    amplitude = _opened(values, face, known, controls, old, new)
    head = made.curves.head
    if face.head is not None:
        head = clock.shown(face.head)
        notes.append("the head is that of the performance")
    joined = values.copy()  # the mouth of `made` is joined already
    join(controls, joined, None if face.head is None else head, acting)
    clock.exact &= (joined[:, places] == values[:, places]).all(axis=1)
    values[:, [*places, *corners]] = joined[:, [*places, *corners]]
    absent = [n for n in controls.names if n not in known and not _is_mouth(controls, n)]
    if absent:
        notes.append(
            f"{len(absent)} controls of the face are not in the performance; they are those of "
            f"the new voice: {listed(absent)}"
        )
    notes.append(f"phrases of the performance: {len(old)}, of the new sound: {len(new)}; {source}")
    change = values - made.curves.values
    below = np.clip(made.neutral.values + change, controls.minimum, controls.maximum)
    readings = (
        replace(made.curves, values=values, head=head),
        replace(made.neutral, values=below),
    )
    with_edits = None
    if acting.edit:
        speech, rule = Speech.of_recording(made.recording), KeepContacts() if acting.rules else None
        given = readings, controls, rule, speech, made.words
        with_edits = edited(acting.edit, *given)
        readings = with_edits.readings
        notes += with_edits.notes
    shown, neutral = readings
    acted = Acting.of(made.acting, edit=acting.edit)
    dubbed = replace(made, curves=shown, neutral=neutral, acting=acted, edited=with_edits)
    return Dubbed(dubbed, pieces, clock.exact, tuple(kept), amplitude, tuple(notes), stretch)


def _read(
    path: Path, mapping: RigMapping | None, fps: float | None
) -> tuple[RigCurves, frozenset[str], list[str]]:
    """The performance at 30 Hz, the controls whose values are known, notes."""
    controls = default_controls()
    if path.is_dir():
        curves = read_curves(path / TAKE_CURVES).reorder(controls)
        known, notes = controls.names, []
    else:
        found = read_capture(path, mapping=mapping, fps=fps)
        curves, known, notes = found.curves.reorder(controls), found.known, list(found.notes)
    if curves.fps != FRAME_RATE:
        notes.append(f"the performance has {curves.fps:g} frames a second; it is shown at 30")
    return curves.resample(FRAME_RATE), frozenset(known), notes


def _phrases_of(
    path: Path, face: RigCurves, sound: Path | str | Recording | None
) -> tuple[list[tuple[int, int]], str]:
    """Phrases of the performance, and a line on what they are taken from."""
    if sound is None:
        beside = [path / TAKE_SOUND] if path.is_dir() else [path.with_suffix(s) for s in SOUNDS]
        sound = next((found for found in beside if found.is_file()), None)
    if sound is not None:
        heard = sound if isinstance(sound, Recording) else load_audio(sound)
        source = f"those of the performance by {Path(heard.source).name}"
        return phrases(heard.activity > 0, len(face)), source
    places = ControlGroups(default_controls()).lively
    opened = face.values[:, places].sum(axis=1).astype(float)
    moving = gaussian_smooth(np.abs(np.gradient(opened)), 3.0, "mirror")
    speaking = moving > 0.15 * np.quantile(moving, 0.95) if moving.any() else moving > 0
    return phrases(speaking, len(face)), "those of the performance by its mouth: it has no sound"


def phrases(speaking: Bool, n_frames: int) -> list[tuple[int, int]]:
    """First frame and the one after the last of each phrase.

    Parameters
    ----------
    speaking : array [shape=(T,)]
        Frames of speech.
    n_frames : int
        Of the curves; what is beyond is cut.
    """
    found: list[tuple[int, int]] = []
    for start, stop in runs(np.asarray(speaking)[:n_frames]).tolist():
        if found and start - found[-1][1] <= PAUSE_SECONDS * FRAME_RATE:
            found[-1] = (found[-1][0], stop)
        else:
            found.append((start, stop))
    return found


Span = tuple[int, int]


def paired_phrases(
    old: Sequence[Span], new: Sequence[Span], limit: float = STRETCH
) -> list[tuple[Span, Span]]:
    """Phrases of two recordings that correspond, in their order.

    Where one has more, up to `MOST_TOGETHER` of them stand for one of the other. Of a recording
    that is longer than the limit allows the last phrases have no counterpart. Where that would
    stretch more than the limit on the average, as much of the first recording as the second has
    stands for all of it.

    Parameters
    ----------
    old, new : sequence of (int, int)
        First frame and the one after the last.
    limit : float
        Of stretching.
    """
    if not old or not new:
        return []
    all_old, all_new = _whole(old, 0, len(old)), _whole(new, 0, len(new))
    share = _length(all_old) / _length(all_new)
    best = _costs(old, new)
    ends = [(len(old), len(new))]
    if share > limit:
        ends = [(i, len(new)) for i in range(1, len(old) + 1)]
    elif share < 1 / limit:
        ends = [(len(old), j) for j in range(1, len(new) + 1)]
    at = min((end for end in ends if end in best), key=lambda end: best[end][0], default=None)
    pairs: list[tuple[Span, Span]] = []
    while at is not None and (before := best[at][1]) is not None:
        pairs.append((_whole(old, before[0], at[0]), _whole(new, before[1], at[1])))
        at = before
    lengths = np.array([_length(second) for _, second in pairs], float)
    off = np.array([abs(np.log(_length(b) / _length(a))) for a, b in pairs])
    if pairs and (off * lengths).sum() <= np.log(limit) * lengths.sum():
        return pairs[::-1]
    first, stop = all_old  # of what need not be stretched nothing is
    return [((first, min(stop, first + _length(all_new))), all_new)]


def _costs(
    old: Sequence[Span], new: Sequence[Span]
) -> dict[tuple[int, int], tuple[float, tuple[int, int] | None]]:
    """Least cost of pairing the first phrases of both, and the pair of numbers before the last."""
    best: dict[tuple[int, int], tuple[float, tuple[int, int] | None]] = {(0, 0): (0.0, None)}
    for i, j in product(range(1, len(old) + 1), range(1, len(new) + 1)):
        for a, b in _GROUPS:
            before = (i - a, j - b)
            if before not in best:
                continue
            longer = np.log(_length(_whole(new, j - b, j)) / _length(_whole(old, i - a, i)))
            cost = best[before][0] + abs(longer) + GROUP_COST * (a + b - 2)
            if (i, j) not in best or cost < best[i, j][0]:
                best[i, j] = float(cost), before
    return best


def _length(span: Span) -> int:
    return span[1] - span[0]


_GROUPS = [(1, 1), *((1, n) for n in range(2, MOST_TOGETHER + 1)),
           *((n, 1) for n in range(2, MOST_TOGETHER + 1))]  # fmt: skip


def _whole(spans: Sequence[Span], first: int, stop: int) -> Span:
    return spans[first][0], spans[stop - 1][1]


class _Clock:
    """Map of frames of the new recording to frames of the performance.

    Attributes
    ----------
    place : array [shape=(T,)]
        Frames of the performance, with a fraction where it is stretched.
    exact : array [shape=(T,)]
        Whether a frame is shown as it is.
    """

    def __init__(self, n_old: int, n_new: int, limit: float) -> None:
        self.n_old, self.n_new, self.limit = n_old, n_new, limit
        self.place: Float64 = np.zeros(n_new)
        self.exact: Bool = np.ones(n_new, bool)
        self._joins: list[tuple[int, Float64]] = []

    def run(self, pairs: Sequence[tuple[Span, Span]]) -> tuple[Piece, ...]:
        """Lay the performance under the new recording, phrase by phrase."""
        pieces, at, now = [], 0.0, 0
        ends = [(old, new, "phrase") for old, new in pairs]
        for old, new, _ in ends:
            if new[0] > now:
                piece, at = self._play("pause", now, new[0], at, old[0])
                pieces.append(piece)
            elif at != old[0]:
                self._join(now, at)
                at = float(old[0])
            piece, at = self._play("phrase", new[0], new[1], at, old[1])
            pieces.append(piece)
            now = new[1]
        if now < self.n_new:
            end = min(round(at) + self.n_new - now, self.n_old)  # the rest at its own speed
            piece, _ = self._play("pause", now, self.n_new, at, end, is_last=True)
            pieces.append(piece)
        self.place = np.clip(self.place, 0, self.n_old - 1)
        self.exact &= self.place == np.round(self.place)
        return tuple(pieces)

    def _play(
        self, kind: str, start: int, stop: int, at: float, end: int, *, is_last: bool = False
    ) -> tuple[Piece, float]:
        """Show the performance from `at` to `end` in the frames from start to stop."""
        count, left = stop - start, end - at
        is_same = kind == "phrase" and abs(left - count) <= SAME_SECONDS * FRAME_RATE
        rate = 1.0 if is_same or count == left else left / count
        rate = float(np.clip(rate, 1 / self.limit, self.limit))
        steps = rate * np.arange(count)
        turned = left < count / self.limit - 1e-9 and not is_same
        if turned:  # too little: to and fro
            rate = 1.0 if is_last else rate
            reach = max(left, 1.0)
            steps = rate * np.arange(count)
            steps = reach - np.abs(steps % (2 * reach) - reach)
        self.place[start:stop] = at + steps
        last = at + rate * count
        joined = not is_last and not is_same and (turned or abs(last - end) > 1e-6)
        if rate != 1 or turned:
            self.exact[start:stop] = False
        shown = (at / FRAME_RATE, min(last, self.n_old) / FRAME_RATE)
        if joined:
            self._join(stop, float(self.place[stop - 1]) + rate)
            last = float(end)
        piece = Piece(kind, start / FRAME_RATE, stop / FRAME_RATE, *shown, rate, joined, turned)
        return piece, round(last, 6)

    def _join(self, frame: int, before: float) -> None:
        """Join a frame to the one before, which is from another place of the performance."""
        stop = min(frame + JOIN_FRAMES, self.n_new)
        self._joins.append((frame, np.arange(stop - frame) + np.float64(before)))
        self.exact[frame:stop] = False

    def shown(self, rows: Float32) -> Float32:
        """Rows of the performance [shape=(T', N)] on the new time [shape=(T, N)]."""
        found = _sampled(rows, self.place)
        for frame, places in self._joins:
            share = (np.arange(len(places)) + 1.0) / (len(places) + 1)
            share = (share * share * (3 - 2 * share))[:, None]
            part = slice(frame, frame + len(places))
            found[part] = share * found[part] + (1 - share) * _sampled(rows, places)
        return found


def _sampled(rows: Float32, places: Float64) -> Float32:
    """Rows at places between them; at a whole place the row itself."""
    places = np.clip(places, 0, len(rows) - 1)
    low = np.floor(places).astype(int)
    share = (places - low)[:, None].astype(np.float32)
    high = np.minimum(low + 1, len(rows) - 1)
    found: Float32 = np.where(share > 0, rows[low] + share * (rows[high] - rows[low]), rows[low])
    return found


def _is_mouth(controls: ControlSet, name: str) -> bool:
    return controls[name].region in MOUTH_REGIONS or "suckBlow" in name


def _corners(controls: ControlSet) -> list[int]:
    """Columns of the controls of the mouth's corners."""
    names = enumerate(controls.names)
    return [k for k, n in names if _is_mouth(controls, n) and any(part in n for part in CORNERS)]


def _with_emotion(
    old: Float32, new: Float32, controls: ControlSet, places: Sequence[int]
) -> Float32:
    """Corners with the slow part of the performance and the quick part of the speech."""
    smooth = partial(gaussian_smooth, sigma=CORNER_SECONDS * FRAME_RATE, ends="mirror")
    slow, same = (
        np.stack([smooth(column) for column in part.T.astype(float)], axis=1)
        for part in (old, new)
    ) if places else (old, new)  # fmt: skip
    mixed = np.clip(slow + new - same, controls.minimum[places], controls.maximum[places])
    return mixed.astype(np.float32)


def _opened(
    values: Float32,
    face: RigCurves,
    known: frozenset[str],
    controls: ControlSet,
    old: Sequence[Span],
    new: Sequence[Span],
) -> float:
    """Open the mouth as far as the performance does, in place; the factor."""
    groups = ControlGroups(controls)
    jaw = controls.index("CTRL_C_jaw.ty")
    if controls.names[jaw] not in known or not old or not new:
        return 1.0
    was, now = (
        float(np.quantile(np.concatenate([rows[slice(*span), jaw] for span in spans]), 0.95))
        for rows, spans in ((face.values, old), (values, new))
    )
    factor = float(np.clip(was / max(now, 1e-3), *AMPLITUDE))
    closed = groups.closures(KeepContacts()).closed(values)[:, None]
    places = groups.lively
    opened = values[:, places] * (1 + (factor - 1) * (1 - closed))
    values[:, places] = np.clip(opened, controls.minimum[places], controls.maximum[places])
    return factor
