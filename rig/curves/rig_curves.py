"""Curves of a face: values of named controls over time; slices, rates, mirroring, joining.

Frame i is at i/fps seconds. A clip of d seconds has ceil(fps * d) frames. Every
function returns new curves.
"""

import math
import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, SupportsIndex, overload

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from rig.arrays import Float32, Float64
from rig.controls import DEFAULT_ID, ControlSet, check_unique, default_controls
from rig.emotions import EMOTIONS, LABELS
from rig.errors import ControlError, CurveError, quoted
from rig.limits import FPS_HIGHEST, FPS_LOWEST, FRAMES, VALUES

if TYPE_CHECKING:
    from pandas import DataFrame

HEAD = ("yaw", "pitch", "roll", "x", "y", "z")
"""Column order of the head track: turn to the character's right, up, and to the right shoulder in
degrees; shift to the character's left, up and forward in cm."""
HEAD_MIRROR = (-1.0, 1.0, -1.0, -1.0, 1.0, 1.0)
NTSC_FILM = 24000 / 1001
NTSC = 30000 / 1001
NTSC_DOUBLE = 60000 / 1001
STANDARD_RATES = (24.0, NTSC_FILM, 25.0, NTSC, 30.0, 48.0, 50.0, NTSC_DOUBLE, 60.0, 100.0, 120.0)
"""Frame rates (Hz) of film and games; 23.976, 29.97 and 59.94 are exact fractions."""


@dataclass(frozen=True, eq=False, repr=False)
class RigCurves:
    """Values of named controls, one row per frame.

    A sequence of its frames: ``curves[0]`` is an array [shape=(C,)], ``curves[30:60]`` are curves,
    ``numpy.asarray(curves)`` is `values`. ``curves["CTRL_C_jaw.ty"]`` is one control over time.

    Parameters
    ----------
    values : array [shape=(T, C)]
        Stored as read-only float32. Ranges belong to the control set, see
        `rig.curves.edit.clamp`.
    names : sequence of str [length C]
        Canonical control names, none doubled.
    fps : float
        Frames per second, 1 to 300. 23.976, 29.97 and 59.94 are taken as the exact
        fractions 24000/1001, 30000/1001 and 60000/1001.
    emotion : array [shape=(T, 9), range 0 to 1], optional
        Weights in the order of `rig.emotions.LABELS`; of the five `EMOTIONS` alone, too.
    intensity : array [shape=(T,), >= 0], optional
        Applied emotional intensity, no unit.
    head : array [shape=(T, 6)], optional
        Turn and shift of the head in the order of `HEAD`, degrees and cm.
    control_set : str
        Id of the control set that the names belong to.
    notes : tuple of str
        What a reader corrected, filled in or left out, a line each.

    Raises
    ------
    CurveError
        If shapes disagree, a value is NaN or infinite, or the rate or the number of frames is not
        allowed.
    ControlError
        If a name is empty or doubled.
    """

    values: Float32
    names: tuple[str, ...]
    fps: float = 30.0
    emotion: Float32 | None = None
    intensity: Float32 | None = None
    control_set: str = DEFAULT_ID
    head: Float32 | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names = tuple(str(name) for name in self.names)
        values = _array(self.values, "values", (None, len(names)))
        check_unique(names, where="curves")
        n_frames = values.shape[0]
        check_clip(n_frames, len(names))
        tracks = {
            "values": values,
            "names": names,
            "fps": snap_fps(self.fps),
            "emotion": _track(with_moods(self.emotion), "emotion", (n_frames, len(LABELS))),
            "intensity": _track(self.intensity, "intensity", (n_frames,)),
            "head": None if self.head is None else _array(self.head, "head", (n_frames, len(HEAD))),
        }
        for field, value in tracks.items():
            object.__setattr__(self, field, value)

    def __len__(self) -> int:
        return int(self.values.shape[0])

    def __repr__(self) -> str:
        names = list(self.tracks)
        kept = " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))
        tracks = f", with {kept}" if kept else ""
        return (
            f"<RigCurves: {len(self)} frames at {self.fps:g} fps, {self.duration:.2f} s, "
            f"{len(self.names)} controls of {self.control_set}{tracks}>"
        )

    @overload
    def __getitem__(self, key: str | SupportsIndex) -> Float32: ...
    @overload
    def __getitem__(self, key: slice) -> "RigCurves": ...
    def __getitem__(self, key: str | SupportsIndex | slice) -> "Float32 | RigCurves":
        """Return a control over time [shape=(T,)], a frame [shape=(C,)], or the frames of a slice.

        A control goes by any spelling of the default board; every n-th frame is at the n-th part
        of the rate.

        Raises
        ------
        ControlError
            If there is no such control.
        CurveError
            If it is none of these.
        IndexError
            If there is no such frame.
        """
        if isinstance(key, str):
            return self.values[:, self.index(key)]
        if isinstance(key, slice):
            step = 1 if key.step is None else key.step
            if step < 1:
                raise CurveError(f"step {step} of a slice of frames must be 1 or more")
            part = self._with_rows(lambda rows: rows[key])
            return part if step == 1 else replace(part, fps=self.fps / step)
        try:
            place = operator.index(key)
        except TypeError:
            raise CurveError(
                f"curves[{quoted(key)}]: give a control's name, a frame or a slice of frames; the "
                "array of all is curves.values"
            ) from None
        if not -len(self) <= place < len(self):
            raise IndexError(f"frame {place} of {len(self)}")
        frame: Float32 = self.values[place]
        return frame

    def __iter__(self) -> Iterator[Float32]:
        return iter(self.values)

    def __contains__(self, name: object) -> bool:
        """Whether there is a control of this name."""
        try:
            return isinstance(name, str) and self.index(name) >= 0
        except ControlError:
            return False

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return `values`, for numpy."""
        if dtype is None and not copy:
            return self.values
        return self.values.astype(dtype or np.float32)

    def to_pandas(self) -> "DataFrame":
        """Return a table of the controls [shape=(T, C)], by ``time`` in seconds; without tracks."""
        from pandas import DataFrame, Index

        return DataFrame(self.values, Index(self.times, name="time"), list(self.names), copy=True)

    @property
    def tracks(self) -> dict[str, Float32]:
        """The tracks there are, by name: emotion, intensity, head."""
        found = {name: getattr(self, name) for name in ("emotion", "intensity", "head")}
        return {name: track for name, track in found.items() if track is not None}

    @property
    def duration(self) -> float:
        """Length in seconds: frames / fps."""
        return len(self) / self.fps

    @cached_property
    def times(self) -> Float64:
        """Time of each frame in seconds [shape=(T,)]."""
        return frames_to_time(np.arange(len(self)), fps=self.fps)

    def index(self, name: str) -> int:
        """Return the column of a control, by any spelling of the default board."""
        place = self._places.get(name)
        if place is None and self.control_set == DEFAULT_ID:
            place = self._places.get(default_controls().canonical(name))
        if place is None:
            raise ControlError(f"control {name!r} is not among these {len(self.names)} curves")
        return place

    def slice_frames(self, start: int = 0, stop: int | None = None) -> "RigCurves":
        """Return the frames from start up to stop (excluded); negative ones count from the end."""
        return self[start:stop]

    def slice_seconds(self, start: float = 0.0, stop: float | None = None) -> "RigCurves":
        """Return the frames whose time t satisfies start <= t < stop (seconds)."""
        first = time_to_frames(start, fps=self.fps)
        last = None if stop is None else time_to_frames(stop, fps=self.fps)
        return self.slice_frames(max(first, 0), None if last is None else max(last, 0))

    def select(self, names: Iterable[str]) -> "RigCurves":
        """Return the named controls in the order given.

        Raises
        ------
        ControlError
            If one is not among the curves or is named twice.
        """
        places = [self.index(name) for name in names]
        chosen = tuple(self.names[i] for i in places)
        return replace(self, values=self.values[:, places], names=chosen)

    def reorder(self, controls: ControlSet | None = None) -> "RigCurves":
        """Return all controls of a set in its order; controls that are absent rest.

        Raises
        ------
        ControlError
            If the curves hold a control that is not in the set.
        """
        controls = controls or default_controls()
        places = controls.indices(self.names)
        values = np.tile(controls.rest, (len(self), 1))
        values[:, places] = self.values
        values.setflags(write=False)  # not copied again
        return replace(self, values=values, names=controls.names, control_set=controls.id)

    def resample(self, fps: float) -> "RigCurves":
        """Return the curves at another rate, linear on the time axis, the duration kept.

        The result has ceil(duration * fps) frames, so that audio and curves still end together.
        Times after the last frame hold it. Tracks are resampled alike.
        """
        fps = snap_fps(fps)
        if fps == self.fps or not len(self):
            return replace(self, fps=fps)
        n_frames = n_frames_for(self.duration, fps=fps)
        check_clip(n_frames, len(self.names))
        position = np.minimum(np.arange(n_frames) * (self.fps / fps), len(self) - 1)
        low = np.floor(position + 1e-9).astype(np.intp)
        high = np.minimum(low + 1, len(self) - 1)
        weight = np.clip(position - low, 0.0, 1.0).astype(np.float32)

        def interpolate(rows: Float32) -> Float32:
            w = weight.reshape(-1, *[1] * (rows.ndim - 1))
            blended: Float32 = rows[low] * (1 - w) + rows[high] * w
            return blended

        return replace(self._with_rows(interpolate), fps=fps)

    def mirror(self, controls: ControlSet | None = None) -> "RigCurves":
        """Return the mirrored face: left and right swapped, sideways values negated.

        Raises
        ------
        ControlError
            If the curves lack the counterpart of one of their controls.
        """
        controls = controls or default_controls()
        in_set = controls.indices(self.names)
        sources = [self.index(controls.names[i]) for i in controls.mirror_index[in_set]]
        head = None if self.head is None else self.head * np.array(HEAD_MIRROR, np.float32)
        values = self.values[:, sources] * controls.mirror_sign[in_set]
        return replace(self, values=values, head=head)

    def _with_rows(self, change: Callable[[Float32], Float32]) -> "RigCurves":
        tracks = {name: change(track) for name, track in self.tracks.items()}
        return replace(self, values=change(self.values), **tracks)  # type: ignore[arg-type]

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}


def concatenate(parts: Sequence[RigCurves]) -> RigCurves:
    """Join curves one after the other.

    Tracks are kept if every part has them.

    Raises
    ------
    CurveError
        If there are no parts, or rates, names or control sets differ.
    """
    if not parts:
        raise CurveError("no curves to join; give at least one")
    first = parts[0]
    for number, part in enumerate(parts[1:], start=2):
        if part.fps != first.fps:
            raise CurveError(
                f"part {number} has {part.fps:g} fps and part 1 has {first.fps:g}; resample first"
            )
        if (part.names, part.control_set) != (first.names, first.control_set):
            raise CurveError(f"part {number} has other controls than part 1; reorder first")
    tracks: dict[str, Any] = dict.fromkeys(("emotion", "intensity", "head"))
    for name in tracks:
        if all(name in part.tracks for part in parts):
            tracks[name] = np.concatenate([part.tracks[name] for part in parts])
    return replace(first, values=np.concatenate([part.values for part in parts]), **tracks)


def rest_curves(
    n_frames: int, *, fps: float = 30.0, controls: ControlSet | None = None
) -> RigCurves:
    """Return the face at rest for a number of frames."""
    controls = controls or default_controls()
    check_clip(n_frames, len(controls))
    values = np.tile(controls.rest, (n_frames, 1))
    values.setflags(write=False)
    return RigCurves(values, controls.names, fps, control_set=controls.id)


def frames_to_time(frames: ArrayLike, *, fps: float) -> Float64:
    """Return the time of frames in seconds: frame / fps."""
    return np.asarray(frames, dtype=np.float64) / fps


def time_to_frames(seconds: float, *, fps: float) -> int:
    """Return the first frame at or after a time (seconds), to within a billionth of a frame."""
    if not math.isfinite(seconds * fps):
        raise CurveError(f"time {seconds:g} s is not a finite number of frames")
    return math.ceil(seconds * fps - 1e-9)


def n_frames_for(seconds: float, *, fps: float) -> int:
    """Return the number of frames of a clip: ceil(fps * seconds)."""
    return max(time_to_frames(seconds, fps=fps), 0)


def check_clip(n_frames: int, n_curves: int) -> None:
    """Refuse a clip of more frames or values than are held in memory.

    Raises
    ------
    CurveError
        If there are more than `limits.FRAMES` frames or `limits.VALUES` values.
    """
    if n_frames > FRAMES:
        raise CurveError(
            f"{n_frames} frames; at most {FRAMES} (three hours at 120 fps) are held: cut the clip, "
            "or lower the rate"
        )
    if n_frames * n_curves > VALUES:
        raise CurveError(
            f"{n_frames} frames of {n_curves} curves are more than {VALUES} values; cut the clip, "
            "or lower the rate"
        )


def snap_fps(fps: float) -> float:
    """Return the rate, a standard one exactly if it is within 2e-5 of it (29.97 is 30000/1001).

    Raises
    ------
    CurveError
        If it is not a number from 1 to 300.
    """
    fps = float(fps)
    if not FPS_LOWEST <= fps <= FPS_HIGHEST:
        raise CurveError(f"fps={fps:g} must be from {FPS_LOWEST:g} to {FPS_HIGHEST:g}")
    for standard in STANDARD_RATES:
        if abs(fps - standard) <= 2e-5 * standard:
            return standard
    return fps


def _array(values: ArrayLike, what: str, shape: tuple[int | None, ...]) -> Float32:
    """Return a read-only float32 array of a shape, or raise CurveError naming the wrong value."""
    with np.errstate(over="ignore"):  # what becomes infinite is named below
        array = np.asarray(values, dtype=np.float32)
    if array.ndim != len(shape) or any(
        want not in (None, got) for want, got in zip(shape, array.shape, strict=True)
    ):
        wanted = ", ".join("frames" if size is None else str(size) for size in shape)
        raise CurveError(f"{what} has shape {array.shape}; it must be ({wanted})")
    finite = np.isfinite(array)
    if not finite.all():
        place = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise CurveError(f"{what} is {array[place]} at {place}; every value must be finite")
    if array.flags.writeable:
        array = array.copy() if np.may_share_memory(array, np.asarray(values)) else array
        array.setflags(write=False)
    return array


def with_moods(emotion: Any) -> Any:
    """Weights of the five trained emotions alone get columns of 0 for the moods."""
    if np.shape(emotion)[1:] != (len(EMOTIONS),):
        return emotion
    return np.pad(emotion, ((0, 0), (0, len(LABELS) - len(EMOTIONS))))


def _track(values: ArrayLike | None, what: str, shape: tuple[int, ...]) -> Float32 | None:
    if values is None:
        return None
    track = _array(values, what, shape)
    if track.size and track.min() < 0:
        raise CurveError(f"{what} falls to {track.min():g}; it must not be negative")
    return track
