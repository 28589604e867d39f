"""Brows, lids, cheeks and the small motion of lips and nose, on the voice and by themselves.

- Brows move on the syllables that stand out, their onset about .1 s before the syllable's, so that
  the peak is at its loudest (Flecha-Garcia 2010; Cave et al. 1996); they rise at questions
  (Srinivasan and Massaro 2003) and knit in thought, in a pause before a phrase (Ekman 1979; Goodwin
  and Goodwin 1986). Few syllables have one: `deitalk.postprocess.life.voice.ACCENTS_PER_SECOND`.
- Which muscles: the emotion decides. Accents knit brows in anger (AU4, AU7), raise the inner ones
  in sadness (AU1, AU4), all in surprise (AU1, AU2, AU5), cheeks and lower lids in happiness (AU6)
  (Ekman 1979; Ekman, Friesen and Hager 2002). A neutral face raises or knits them.
- A face at rest is not still: it smiles a little, tightens a lid, knits or raises its brows, one
  after the other, and is still between (`IDLE`). Ranges, speeds and shares of stillness of a
  neutral take are of the size of five captured ones (docs/life.md).
- Onsets of 150 to 400 ms and slower offsets, as of spontaneous brow raises and smiles (Schmidt,
  Cohn and Tian 2003).
- Sides differ by 10 to 15 %, by the character and from event to event (`voice.ASYMMETRY`); a few
  events are of one side, more often the stronger one.

All of this yields to an expression, whose strength it must not hide.

Streams are side by side. Letters: B streams, n frames of a call, N events, S styles, K stems of
control names, 2 the sides.
"""

from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.postprocess.life.draws import (
    Swells,
    UInt64,
    between,
    normals,
    smooth_noise,
    sub_keys,
    swell,
    uniforms,
)
from deitalk.postprocess.life.voice import ACCENT, END, PAUSE, Cues
from rig.arrays import Float64, Int64

STEMS = ("brow_raiseIn", "brow_raiseOut", "brow_down", "brow_lateral", "eye_squintInner",
         "eye_cheekRaise", "eye_blink", "mouth_cornerPull", "nose")  # fmt: skip
"""Controls that this moves, on both sides."""
LIDS = STEMS.index("eye_blink")
UPPER = 7
"""Stems above the mouth."""
ACCENTS: dict[str, tuple[float, ...]] = {
    "angry": (-0.12, -0.10, 0.24, 0.08, 0.18, 0.12, -0.04, 0.0, 0.06),
    "happy": (0.14, 0.16, 0.0, 0.0, 0.10, 0.16, -0.02, 0.0, 0.0),
    "sad": (0.38, 0.0, 0.08, 0.12, 0.08, 0.0, 0.04, 0.0, 0.0),
    "surprised": (0.28, 0.32, 0.0, 0.0, 0.0, 0.0, -0.16, 0.0, 0.0),
    "fear": (0.24, 0.14, 0.06, 0.14, 0.0, 0.0, -0.14, 0.0, 0.0),
    "disgust": (-0.08, -0.08, 0.16, 0.04, 0.16, 0.12, 0.02, 0.0, 0.14),
    "contempt": (0.06, 0.14, 0.0, 0.0, 0.06, 0.0, 0.05, 0.0, 0.02),
    "calm": (0.07, 0.06, 0.0, 0.0, 0.02, 0.0, 0.02, 0.0, 0.0),
}
"""Motion of `STEMS` for a full accent in an emotion; 0 in the neutral reading, see `GESTURES`."""
HELD: dict[str, tuple[float, ...]] = {
    "angry": (0.0, 0.0, 0.32, 0.18, 0.24, 0.0, 0.0, 0.0, 0.0),
    "happy": (0.0, 0.0, 0.0, 0.0, 0.0, 0.12, 0.0, 0.0, 0.0),
}
"""What an emotion holds of `STEMS` besides the network's expression, also between the accents:
lower lids and knit brows in anger, raised cheeks in joy (Ekman, Friesen and Hager 2002); amounts by
eye."""
MIRROR: dict[str, tuple[float, ...]] = {
    "angry": (0.10, 0.0, 0.30, 0.30, 0.20, 0.0, 0.0, 0.0, 0.0),
    "happy": (0.05, 0.10, 0.0, 0.0, 0.30, 0.50, 0.0, 0.60, 0.0),
    "sad": (0.50, 0.0, 0.20, 0.30, 0.10, 0.0, 0.10, 0.0, 0.0),
    "surprised": (0.50, 0.50, 0.0, 0.0, 0.0, 0.0, -0.20, 0.0, 0.0),
}
"""Pose of a listener who feels with a speaker in full; a frown of concern for anger."""
GESTURES: dict[str, tuple[float, ...]] = {
    "raise": (0.44, 0.22, 0.0, 0.20, 0.0, 0.04, -0.10, 0.0, 0.0),
    "knit": (0.0, 0.0, 0.35, 0.20, 0.16, 0.04, 0.02, 0.0, 0.12),
    "frown": (0.0, 0.0, 0.22, 0.18, 0.10, 0.0, 0.02, 0.0, 0.05),
    "question": (0.22, 0.16, 0.0, 0.06, 0.0, 0.02, -0.06, 0.0, 0.0),
    "smile": (0.0, 0.0, 0.0, 0.0, 0.17, 0.20, 0.02, 0.30, 0.0),
    "squint": (0.0, 0.0, 0.02, 0.0, 0.24, 0.05, 0.03, 0.0, 0.0),
    "sneer": (0.0, 0.0, 0.02, 0.0, 0.08, 0.05, 0.0, 0.0, 0.18),
    "lids": (0.0, 0.0, 0.0, 0.0, 0.04, 0.0, 0.10, 0.0, 0.0),
}
"""Motion of `STEMS` for gestures of a neutral face, in full."""


class Idle(NamedTuple):
    """How a gesture comes by itself."""

    gesture: str
    every: float
    """Seconds of a slot, in which there is one or none."""
    share: float
    """Slots with one."""
    height: tuple[float, float]
    attack: tuple[float, float]
    hold: tuple[float, float]
    decay: tuple[float, float]
    """Seconds; of all three at most `every`."""
    speaking: float
    """Factor on the height in speech, whose accents move brows."""


IDLE = (
    Idle("smile", 6.0, 0.85, (0.35, 0.90), (0.30, 0.60), (0.4, 1.5), (0.6, 1.1), 1.0),
    Idle("squint", 4.2, 0.85, (0.35, 1.00), (0.15, 0.35), (0.4, 1.4), (0.3, 0.6), 1.0),
    Idle("sneer", 6.8, 0.80, (0.35, 1.00), (0.15, 0.30), (0.1, 0.6), (0.3, 0.6), 1.0),
    Idle("knit", 5.3, 0.80, (0.25, 0.60), (0.25, 0.45), (0.3, 1.2), (0.5, 0.9), 0.0),
    Idle("raise", 4.7, 0.80, (0.25, 0.60), (0.25, 0.45), (0.2, 0.9), (0.5, 0.9), 0.0),
    Idle("lids", 2.1, 0.85, (-0.8, 1.0), (0.20, 0.50), (0.3, 1.0), (0.3, 0.6), 1.0),
    Idle("lids", 1.7, 0.90, (-0.6, 0.8), (0.30, 0.60), (0.1, 0.5), (0.3, 0.6), 0.0),
    Idle("squint", 2.9, 0.80, (0.10, 0.35), (0.30, 0.60), (0.1, 0.6), (0.5, 0.9), 0.0),
    Idle("smile", 3.7, 0.80, (0.10, 0.40), (0.40, 0.80), (0.2, 0.8), (0.7, 1.2), 0.0),
    Idle("raise", 3.3, 0.80, (0.08, 0.25), (0.30, 0.60), (0.1, 0.6), (0.6, 1.0), 0.0),
)
"""The last ones are of a face that is silent, which is never frozen."""
KNIT_SHARE = 0.35
"""Accents of a neutral face that knit the brows instead of raising them."""
QUESTION_SECONDS, QUESTION_LEAD = (0.4, 0.35, 0.8), 0.15
DRIFT, DRIFT_SECONDS = (0.008, 0.008, 0.006, 0.005, 0.012, 0.008, 0.018, 0.006, 0.003), 0.5
"""Standard deviation of slow noise, control units."""
HELD_SPREAD, HELD_SECONDS = 0.1, 2.0
"""Standard deviation of the slow factor on `HELD`."""
LEAD_SECONDS, LEAD_SPREAD = 0.06, 0.02
ATTACK_SECONDS, HOLD_SECONDS, DECAY_SECONDS = (0.2, 0.28), (0.03, 0.1), (0.35, 0.55)
LEAST_HEIGHT, HEIGHT_SPREAD = 0.35, (0.85, 1.15)
"""Height of the weakest accent, and what the seed changes of any."""
EVENT_SIDE, MOST_UNEVEN = 0.1, 0.15
"""Standard deviation and limit of the difference of the sides in an event."""
ALONE_SHARE, OTHER_BROW, STRONGER_SHARE = 0.12, 0.2, 0.7
"""Share of the accents that move one side, how far the other one follows, and how often it is the
character's stronger one."""
FROWN_SHARE, FROWN_PAUSE, FROWN_LEAD = 0.35, 0.5, 0.15
"""Share of the pauses with a frown, the shortest such pause, and its peak before the phrase; s."""
FROWN_SECONDS, FROWN_HEIGHT = ((0.3, 0.5), (0.15, 0.5), (0.5, 0.9)), (0.5, 1.0)
"""Attack, hold and decay."""
_IDLE_POSES = np.array([GESTURES[row.gesture] for row in IDLE])
_EVERY = np.array([row.every for row in IDLE])
_SPANS = np.array([[row.attack, row.hold, row.decay, row.height] for row in IDLE])
_SHARES, _SPOKEN = (np.array([getattr(row, f) for row in IDLE]) for f in ("share", "speaking"))


class FaceTracks(NamedTuple):
    """Motion of frames before the emotion decides what moves."""

    accents: Float64
    """Swells of the accents on the left and the right [shape=(B, n, 2), range 0 to 1]."""
    gestures: Float64
    """Motion of the stems of a neutral face on the left, then on the right [shape=(B, n, 2 K)]."""
    posture: Float64
    """Share of `HELD` that is shown [shape=(B, n, 1)]."""


def uneven_sides(side: Float64, shares: Float64) -> Float64:
    """Factors on the left and the right side in events [shape=(..., 2)], of uniform numbers."""
    event = np.clip(EVENT_SIDE * normals(shares), -MOST_UNEVEN, MOST_UNEVEN)
    factors: Float64 = 1 + (side + event)[..., None] * np.array([0.5, -0.5])
    return factors


class Face:
    """Brows, lids, cheeks, smiles and sneers of streams.

    Parameters
    ----------
    keys : array of uint64 [shape=(B,)]
        Equal keys give equal motion.
    side, ranges : array [shape=(B,)]
        How much stronger the left side moves; factor on the motion.
    """

    def __init__(self, keys: UInt64, side: Float64, ranges: Float64) -> None:
        self.keys, self.side, self.ranges = keys, side, ranges
        self.swells = Swells(2 + 2 * len(STEMS))

    def reset(self, stream: int) -> None:
        """Begin a stream again."""
        self.swells.clear(stream)

    def cue(self, cues: Cues) -> None:
        """Begin the motion of an accent, of a question, or of thought in a pause."""
        self._accents(cues.where(cues.kind == ACCENT))
        self._frowns(cues.where((cues.kind == PAUSE) & (cues.size == FROWN_PAUSE)))
        asked = cues.where((cues.kind == END) & cues.is_question)
        both = np.ones((len(asked.time), 2))
        self._add(asked, asked.time - QUESTION_LEAD, QUESTION_SECONDS, 0 * both, both, "question")

    def _shares(self, cues: Cues) -> Float64:
        return uniforms(self.keys[cues.stream], np.round(cues.time * FRAME_RATE), 10)

    def _accents(self, cues: Cues) -> None:
        shares, side = self._shares(cues), self.side[cues.stream]
        spans = ATTACK_SECONDS, HOLD_SECONDS, DECAY_SECONDS
        seconds = [between(share, span) for share, span in zip(shares.T, spans, strict=False)]
        height = LEAST_HEIGHT + (1 - LEAST_HEIGHT) * cues.size
        sides = uneven_sides(side, shares[:, 4])
        is_left = (side >= 0) == (shares[:, 6] < STRONGER_SHARE)
        other = np.stack((~is_left, is_left), axis=1) & (shares[:, 5] < ALONE_SHARE)[:, None]
        sides = sides * np.where(other, OTHER_BROW, 1)
        sides *= (height * between(shares[:, 3], HEIGHT_SPREAD))[:, None]
        peak = cues.time - LEAD_SECONDS + LEAD_SPREAD * normals(shares[:, 7])
        knits = shares[:, 8] < KNIT_SHARE
        for chosen, gesture in ((knits, "knit"), (~knits, "raise")):
            part = [length[chosen] for length in seconds]
            some = sides[chosen]
            self._add(cues.where(chosen), peak[chosen], part, some, some, gesture)

    def _frowns(self, cues: Cues) -> None:
        shares = self._shares(cues)
        seconds = [
            between(share, span) for share, span in zip(shares.T, FROWN_SECONDS, strict=False)
        ]
        peak = cues.before_next(FROWN_LEAD + seconds[1], FROWN_PAUSE + seconds[0])
        taken = (shares[:, 3] < FROWN_SHARE) & ~np.isnan(peak) & (cues.time > 0)
        height = between(shares[:, 4], FROWN_HEIGHT)[:, None]
        sides = height * uneven_sides(self.side[cues.stream], shares[:, 5])
        part = [length[taken] for length in seconds]
        some = sides[taken]
        self._add(cues.where(taken), peak[taken], part, 0 * some, some, "frown")

    def _add(
        self,
        cues: Cues,
        peak: Float64,
        seconds: "tuple[float, float, float] | list[Float64]",
        accent: Float64,
        sides: Float64,
        gesture: str,
    ) -> None:
        """Add events with heights (N, 2) of accents and of a gesture on both sides."""
        poses = sides[:, :, None] * np.array(GESTURES[gesture])
        heights = np.concatenate((accent, poses.reshape(len(peak), 2 * len(STEMS))), axis=1)
        attack, hold, decay = seconds
        self.swells.add(cues.stream, peak, (attack, hold, decay), heights, cues.known)

    def play(self, streams: Int64, first: Int64, talks: Float64) -> FaceTracks:
        """Motion of the next frames of some streams.

        Parameters
        ----------
        streams, first : array of int [shape=(B,)]
            Which streams, and their next frames.
        talks : array [shape=(B, n), range 0 to 1]
            How far the face talks, over the last seconds.
        """
        count = talks.shape[1]
        keys, ranges = self.keys[streams], self.ranges[streams, None, None]
        times = (first[:, None] + np.arange(count)) / FRAME_RATE
        swells = self.swells.play(streams, first, count)
        spread = np.array([*DRIFT, HELD_SPREAD])
        seconds = np.array([*[DRIFT_SECONDS] * len(DRIFT), HELD_SECONDS])
        noise = smooth_noise(keys, times, spread, seconds)
        gestures = swells[..., 2:] + self._idle(keys, self.side[streams], times, talks)
        drift = noise[..., : len(DRIFT)]
        return FaceTracks(
            ranges * (1 - np.exp(-swells[..., :2])),
            ranges * gestures + np.concatenate((drift, drift), axis=-1),
            np.maximum(1 + noise[..., len(DRIFT) :], 0),
        )

    def _idle(self, keys: UInt64, side: Float64, times: Float64, talks: Float64) -> Float64:
        """Gestures that come by themselves [shape=(B, n, 2 K)]."""
        own = sub_keys(keys, len(IDLE))[:, None, :, None]
        number = np.floor(times[..., None] / _EVERY)[..., None] - np.arange(2)
        shares = uniforms(own, number, 7)  # (B, n, gestures, this slot and the one before, 7)
        begin = (number + shares[..., 0]) * _EVERY[:, None]
        low, high = _SPANS[:, None, :, 0], _SPANS[:, None, :, 1]
        attack, hold, decay, height = np.moveaxis(low + (high - low) * shares[..., 1:5], -1, 0)
        shape = height * swell(times[..., None, None] - begin, attack, hold, decay)
        shape = shape * (shares[..., 5] < _SHARES[:, None])
        sides = uneven_sides(side[:, None, None, None], shares[..., 6])
        heights = (shape[..., None] * sides).sum(axis=3)  # (B, n, gestures, 2)
        heights *= (1 + (_SPOKEN - 1) * talks[..., None])[..., None]
        poses = heights.swapaxes(2, 3) @ _IDLE_POSES  # (B, n, 2, K)
        found: Float64 = poses.reshape(*times.shape, 2 * len(STEMS))
        return found
