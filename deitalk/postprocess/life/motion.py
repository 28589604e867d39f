"""Blinks, gaze, brows, head and neck of a take, or of a voice that has not ended.

The times of all events come from the voice and the seed alone. What they move depends on the
emotion shown, which is 0 in the neutral reading: both readings blink and look alike, and intensity
0 gives the neutral reading with its motion.

Letters: T frames at 30 per second, n frames of a call, S styles.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.config.rules import Idle
from deitalk.emotions import LABELS
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.eyes import Blinks, Gaze
from deitalk.postprocess.life.head import (
    BREATH,
    SWALLOWS,
    Brows,
    Head,
    brow_events,
    hold_postures,
    liveliness,
    move_heads,
    neck_tracks,
)
from deitalk.postprocess.life.voice import (
    ONSET_SECONDS,
    STILL_SECONDS,
    Cue,
    Seeds,
    Traits,
    Voice,
    presence,
)
from deitalk.postprocess.tracks import MotionTracks
from rig.arrays import AnyFloat, Bool, Float32, Float64
from rig.curves import HEAD

ADDED_CONTROLS = ("_eye_blink.", "_eye.t")
"""Parts of the names of controls that blinks and gaze move, whatever the emotion."""
SPEAKING_LEAD = 10
"""Frames by which speech moves the head before it is there, in a take that is known: those by
which the smoothing of `Head.at` is late."""
AGAINST = np.array([1, -1], np.float32)
"""Signs of a turn of the eyes that undoes yaw and pitch of the head."""
STARE = 0.8
"""Share of the aversions that anger takes away at intensity 1: its gaze stays on the listener."""
TURN_FRAMES = 6
"""Frames in which the eyes turn to another place, as long as an emotion takes to change."""
MOST_SHOWN = 1.5
"""Intensity above which accents and posture grow no more."""


class Motion(NamedTuple):
    """Motion of consecutive frames above the mouth."""

    tracks: MotionTracks
    """What `deitalk.postprocess.life.play.Play` plays."""
    head: Float32 | None
    """Track of the head [shape=(..., n, 6)], see `deitalk.postprocess.life.head`; None if it is off
    in a whole take."""


def attend(gaze: Float64, held: Float64, mixture: Float32) -> Float64:
    """Gaze of an emotion, degrees: anger stares, sadness alone looks where its head is lowered to.

    Parameters
    ----------
    gaze : array [shape=(..., 2)]
        Fixations and aversions of a neutral face.
    held : array [shape=(..., 2)]
        Turn of the eyes that undoes the posture of the head.
    mixture : array [shape=(..., S)]
        Emotion shown at each frame.
    """
    angry, sad = (mixture[..., [LABELS.index(name)]] for name in ("angry", "sad"))
    shown: Float64 = gaze * np.maximum(1 - STARE * angry, 0) + held * np.maximum(1 - sad, 0)
    return shown


class MotionStream:
    """Eyes, brows, head and neck of a take or of a stream, which the cues of a voice move.

    Parameters
    ----------
    seeds : Seeds
        Of the recording and its actor, or of the stream.
    idle : Idle
        The model's own numbers.
    life : Life
        Factors on them, and the listener's place.
    traits : Traits, optional
        Of the character; drawn from the seeds by default.
    voice : Voice, optional
        Of the whole take; None if it has not ended.
    has_begun, goes_on : bool
        Whether another take comes before, or after: motion does not begin at rest, or end there.
    """

    def __init__(
        self,
        seeds: Seeds,
        idle: Idle = Idle(),
        life: Life = Life(),
        traits: Traits | None = None,
        voice: Voice | None = None,
        *,
        has_begun: bool = False,
        goes_on: bool = False,
    ) -> None:
        self.life = amounts = life.times(idle)
        self.traits = traits = traits or Traits.of(seeds.character())
        self.n_frames = 0
        self.place = self.looks = np.array(life.look_at)
        self.turns: list[tuple[int, tuple[float, float]]] = []
        self.turning = 0
        self.end = math.inf if voice is None else (voice.n_frames - 1) / FRAME_RATE
        self.silence = 0.0 if voice is None or goes_on else voice.silence
        self.onset = 0.0 if has_begun else ONSET_SECONDS
        factor = traits.blink_interval / max(amounts.blinks, 0.05)
        still = self.end - STILL_SECONDS
        self.blinks = Blinks(seeds.generator("blinks"), idle, factor, still)
        self.gaze = Gaze(seeds.generator("gaze"), traits.avoids, self.end)
        self.brows = Brows(traits, seeds.generator("brows"))
        self.head = Head(traits, seeds.generator("head"), self.end)

    def cue(self, cue: Cue) -> None:
        """Take what comes next in the voice."""
        for part in (self.blinks, self.gaze, self.brows, self.head):
            part.cue(cue)

    def look_at(self, place: tuple[float, float], frame: int) -> None:
        """Turn to another place of the listener, degrees, within `TURN_FRAMES` from a frame on."""
        self.turns.append((frame, place))

    def looks_at(self, first: int, count: int) -> Float64:
        """Where the listener is in the next frames, degrees [shape=(n, 2)]."""
        looks = np.empty((count, 2))
        for k in range(count):
            while self.turns and self.turns[0][0] <= first + k:
                self.place, self.turning = np.array(self.turns.pop(0)[1]), TURN_FRAMES
            if self.turning:
                self.looks = self.looks + (self.place - self.looks) / self.turning
                self.turning -= 1
            looks[k] = self.looks
        return looks

    def eyes(self, count: int) -> tuple[Float64, Float64, Float64]:
        """Gaze, closure of the lids and the listener's place in the next frames [shape=(n, 2)]."""
        first, amounts = self.n_frames, self.life
        gaze = self.gaze.at(first, count)
        if amounts.gaze and math.isfinite(self.end):  # those of a stream are known too late
            for time in self.gaze.shifts:
                self.blinks.draw_to(time)
            self.gaze.shifts = []
        return gaze, self.blinks.at(first, count), self.looks_at(first, count)


def move_together(
    streams: Sequence[MotionStream], speaking: AnyFloat | Bool, mixture: Float32
) -> Motion:
    """Motion of the next frames of streams side by side.

    Parameters
    ----------
    streams : sequence of MotionStream
        B.
    speaking : array [shape=(B, n)]
        1 in speech, else 0.
    mixture : array [shape=(B, n, S)]
        Emotion shown: weights times intensity.
    """
    count, mixture = speaking.shape[1], np.minimum(mixture, MOST_SHOWN)
    first = np.array([stream.n_frames for stream in streams])
    eyes = (stream.eyes(count) for stream in streams)
    looks, lids, place = (np.stack(parts) for parts in zip(*eyes, strict=True))
    for stream in streams:
        stream.n_frames += count

    def each(values: Sequence[float]) -> Float64:
        return np.array(values)[:, None, None]

    factors = [stream.life for stream in streams]
    gaze, amount = each([one.gaze for one in factors]), each([one.head for one in factors])
    ends = np.array([stream.end for stream in streams])
    silence, onset = (np.array([getattr(s, n) for s in streams]) for n in ("silence", "onset"))
    shown = presence(first[:, None] + np.arange(count), ends, silence, onset)
    heads = [stream.head for stream in streams]
    moves = amount * shown[..., None] * move_heads(heads, first, speaking)
    posture = amount * shown[..., None] * hold_postures(heads, mixture)
    turn = moves[..., : len(HEAD)] * liveliness(heads, mixture)[..., None]
    head = (turn + posture).astype(np.float32)
    turned, held = turn[..., :2] * AGAINST, posture[..., :2] * AGAINST
    place = shown[..., None] * place
    neck = neck_tracks(moves[..., BREATH], moves[..., SWALLOWS], head[..., 0])
    still = np.ones((*speaking.shape, 1))
    tracks = MotionTracks(
        lids * each([bool(one.blinks) for one in factors]),
        gaze * (attend(looks, held, mixture) + turned) + place,
        gaze * (looks + turned) + place,
        *brow_events([stream.brows for stream in streams], first, shown),
        neck * (amount > 0),
        mixture,
        still * each([stream.traits.side for stream in streams]),
        still * each([one.brows for one in factors]),
    )
    return Motion(tracks, head)


def plan_motion(
    voice: Voice,
    mixture: Float32,
    seeds: Seeds,
    idle: Idle = Idle(),
    life: Life = Life(),
    traits: Traits | None = None,
    *,
    has_begun: bool = False,
    goes_on: bool = False,
) -> Motion:
    """Motion of a whole take.

    Parameters
    ----------
    voice : Voice
        Of the recording.
    mixture : array [shape=(T, S)]
        Weights of the emotions times the applied intensity.
    seeds, idle, life, traits, has_begun, goes_on
        As for `MotionStream`.
    """
    stream = MotionStream(seeds, idle, life, traits, voice, has_begun=has_begun, goes_on=goes_on)
    for cue in voice.cues():
        stream.cue(cue)
    lead = min(SPEAKING_LEAD, voice.n_frames)
    speaking = np.append(voice.speaking[lead:], np.zeros(lead, np.float32))
    motion = move_together([stream], speaking[None], mixture[None])
    head = None if motion.head is None or not stream.life.head else motion.head[0]
    return Motion(MotionTracks(*(track[0] for track in motion.tracks)), head)
