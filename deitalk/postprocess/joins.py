"""Curves that are led from one take to the next.

A take that follows another begins in the pose and at the speeds of its edge
and passes to its own motion; one that leads into another ends so. Curves are mixed, not
shifted, so that values stay in their ranges, and a contact of the lips is met as soon as it is
slow enough.

Letters: T frames at 30 per second, C controls.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.postprocess.edges import LONGEST_QUIET, Edge
from rig import ControlSet
from rig.arrays import Bool, Float32, Float64

MOUTH_FRAMES, LIDS_FRAMES, FACE_FRAMES = 6, 6, 15
"""Frames in which the mouth, the lids, and brows, cheeks and corners pass into their own motion."""
HEAD_FRAMES, MOST_HEAD_FRAMES, FRAMES_A_DEGREE = 30, 90, 3
"""Frames of the head and of the eyes, which turn against it: more for a larger difference, so that
the head turns by half a degree in a frame at most."""
COASTING = 2.0
"""Time constant in frames of a speed that is left alone: a motion goes on by twice its step."""
CONTACT_FRAMES = 4
"""Frames over which contacts of the lips gain their full weight."""
PAUSE_SECONDS = 0.3
"""Silence beside a take of which nothing else is known: the mouth is shut, the expression held."""


def lead(
    values: Float32,
    head: Float32 | None,
    controls: ControlSet,
    edge: Edge,
    *,
    last: bool = False,
    most: int | None = None,
) -> None:
    """Have curves begin at the edge of the take before, or end at that of the take after.

    Parameters
    ----------
    values : array [shape=(T, C)]
        Changed in place, but for frames beyond those of the passage.
    head : array [shape=(T, 6)], optional
        Track of the head, changed in place.
    controls : ControlSet
        Of the columns.
    edge : Edge
        Of the other take.
    last : bool
        The curves end at the edge; else they begin there.
    most : int, optional
        Most frames of the passage; by default all but one, so that the other end stays.
    """
    most = len(values) - 1 if most is None else min(most, len(values) - 1)
    if most < 1:
        return
    if last:
        values, head = values[::-1], None if head is None else head[::-1]
    passage = Passage.of(controls, edge, None if head is None else head[0], most, last=last)
    passage.mix(values, head)


def _coasting(frames: Any) -> Float64:
    """Frames' worth of a speed that frames beside an edge have gone on by [shape=(n, 1)]."""
    gone: Float64 = COASTING * (1 - np.exp(-(frames + 1) / COASTING))
    return gone[:, None]


def _shares(frames: Any, lengths: Any, held: Any = 0) -> Float64:
    """Share of the own motion in frames beside an edge [shape=(n, C)]."""
    part = np.clip((frames[:, None] + 1 - held) / (np.atleast_1d(lengths) + 1), 0, 1)
    share: Float64 = part * part * (3 - 2 * part)
    return share


@dataclass(frozen=True)
class Passage:
    """From an edge to the own motion of a take, of consecutive frames.

    Attributes
    ----------
    controls : ControlSet
        Of the columns.
    pose, speed : array [shape=(C,)]
        Of the edge, in the direction of the frames.
    head, head_speed : array [shape=(6,)], or None without a head
    lengths : array [shape=(C,)]
        Frames in which each control passes.
    head_length : int
        The same of the head.
    held : array [shape=(C,)] or int
        Frames for which each control stays at the edge before it passes.
    """

    controls: ControlSet
    pose: Float64
    speed: Float64
    head: Float64 | None
    head_speed: Float64 | None
    lengths: Any
    head_length: int
    held: Any = 0

    @classmethod
    def of(
        cls,
        controls: ControlSet,
        edge: Edge,
        head: Float32 | None,
        most: int,
        *,
        last: bool = False,
        mouth: int = MOUTH_FRAMES,
        held: int = 0,
    ) -> "Passage":
        """The passage from an edge to a take.

        Parameters
        ----------
        controls : ControlSet
            Of the take.
        edge : Edge
            Where the passage begins.
        head : array [shape=(6,)], optional
            Of the take beside the edge.
        most : int
            Most frames of any control.
        last : bool
            The frames go backwards, from the end of the take.
        mouth : int
            Frames of the mouth.
        held : int
            Frames for which brows, cheeks and corners stay first.
        """
        turned = None if head is None or not edge.head else np.array(edge.head)
        head_length = FACE_FRAMES
        if turned is not None and head is not None:
            furthest = float(np.abs(head[:3] - turned[:3]).max())
            wanted = np.ceil(FRAMES_A_DEGREE * furthest)
            head_length = int(np.clip(wanted, HEAD_FRAMES, MOST_HEAD_FRAMES))
        names, sign = controls.names, -1.0 if last else 1.0
        speaks: Bool = ControlGroups(controls).follows_mouth
        lengths, stay = np.where(speaks, mouth, FACE_FRAMES), np.where(speaks, 0, held)
        lids, looks = (
            [k for k, name in enumerate(names) if part in name] for part in ("eye_blink", "_eye.t")
        )
        lengths[lids], lengths[looks], stay[lids + looks] = LIDS_FRAMES, head_length, 0
        return cls(
            controls,
            np.array([edge.pose.get(name, 0.0) for name in names]),
            sign * np.array([edge.speed.get(name, 0.0) for name in names]),
            turned,
            None if turned is None else sign * np.array(edge.head_speed),
            np.minimum(lengths, most),
            min(head_length, most),
            stay,
        )

    @property
    def n_frames(self) -> int:
        """Frames of the whole passage."""
        return int(max((self.lengths + self.held).max(), self.head_length))

    def mix(self, values: Float32, head: Float32 | None, start: int = 0) -> None:
        """Mix the edge into frames (n, C) and their head (n, 6) in place.

        They are those from number `start` of the passage on.
        """
        count = min(len(values), self.n_frames - start)
        if count <= 0:
            return
        frames, controls = start + np.arange(count), self.controls
        rows = values[:count]
        coasted = self.pose + _coasting(frames) * self.speed
        coasted = np.clip(coasted, controls.minimum, controls.maximum)
        share = _shares(frames, self.lengths, self.held)
        groups = ControlGroups(controls)
        if len(groups.together):
            closed = 2 * rows[:, groups.together].mean(axis=1) - 1
            gains = np.minimum((frames + 1) / CONTACT_FRAMES, 1)
            met = (closed.clip(0, 1) * gains)[:, None]
            share = np.where(groups.follows_mouth, np.maximum(share, met), share)
        rows[:] = coasted + share * (rows - coasted)
        if head is not None and self.head is not None and self.head_speed is not None:
            turned = self.head + _coasting(frames) * self.head_speed
            part = _shares(frames, self.head_length)
            head[:count] = turned + part * (head[:count] - turned)


def unknown_controls(edge: Edge, controls: ControlSet) -> tuple[str, ...]:
    """A note on controls of an edge that a network's curves do not have."""
    others = sorted(edge.pose.keys() - set(controls.names))
    if not others:
        return ()
    return (f"{len(others)} controls of the other take are none of the model's: {others[0]} …",)


def activity_beside(edge: Edge | None, *, before: bool) -> Float32:
    """Activity of the sound before or after a take, as far as its gates depend on it.

    The edge's seconds without speech, then speech; nothing without an edge. Without a known time
    the face is held, as in a short pause.
    """
    if edge is None:
        return np.zeros(0, np.float32)
    quiet = PAUSE_SECONDS if edge.quiet is None else edge.quiet
    silence = np.zeros(round(min(quiet, LONGEST_QUIET) * FRAME_RATE), np.float32)
    speech = np.ones(1 if quiet < LONGEST_QUIET else 0, np.float32)
    return np.concatenate((speech, silence) if before else (silence, speech))
