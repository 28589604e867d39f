"""Brows, lids and cheeks on the voice.

- Brows rise with pitch accents, their peak 60 ms before that of the accent (Flecha-Garcia 2010);
  brow height goes with pitch (Cave et al. 1996; Huron and Shanahan 2013) and lifts in questions
  (Srinivasan and Massaro 2003). Not every accent brings a brow: the stronger, the more often.
- Which muscles: the emotion decides. Accents knit brows in anger (AU4, AU7), raise the inner ones
  in sadness (AU1, AU4), all in surprise (AU1, AU2, AU5), cheeks and lower lids in happiness (AU6)
  (Ekman 1979; Ekman, Friesen and Hager 2002).
- Onsets of 150 to 400 ms and slower offsets, as of spontaneous brow raises and smiles (Schmidt,
  Cohn and Tian 2003).
- Sides differ by 10 to 15 %, by the character and from event to event (`traits.ASYMMETRY`); a few
  raises are of one brow, more often the stronger one. Some phrases have none at all.
- Brows knit in thought, in a pause before a phrase (Ekman 1979; Goodwin and Goodwin 1986).

An expression is held no longer as a plateau: it swells with accents and yields between them. What
an emotion holds besides (`HELD`), lids above all, and the opening of the lids waver slowly.

Letters: T frames at 30 per second, S styles, K stems of control names, 2 the sides.
"""

from typing import NamedTuple

import numpy as np

from deitalk.emotions import by_emotion
from deitalk.postprocess.life.tracks import Noise, Swells, Traits
from deitalk.postprocess.life.voice import Cue
from rig import ControlSet
from rig.arrays import Float32, Float64

STEMS = ("brow_raiseIn", "brow_raiseOut", "brow_down", "brow_lateral", "eye_squintInner",
         "eye_cheekRaise", "eye_blink")  # fmt: skip
"""Controls that this moves, on both sides."""
LIDS = STEMS.index("eye_blink")
ACCENTS: dict[str, tuple[float, ...]] = {
    "neutral": (0.18, 0.15, 0.0, 0.0, 0.02, 0.02, -0.03),
    "angry": (-0.17, -0.14, 0.24, 0.08, 0.18, 0.12, -0.04),
    "happy": (-0.03, 0.04, 0.0, 0.0, 0.15, 0.28, 0.03),
    "sad": (0.15, -0.14, 0.10, 0.14, 0.10, 0.13, 0.04),
    "surprised": (0.13, 0.16, 0.0, 0.0, 0.0, 0.20, -0.16),
    "fear": (0.16, 0.05, 0.06, 0.14, 0.0, 0.0, -0.14),
    "disgust": (-0.16, -0.14, 0.14, 0.04, 0.16, 0.14, 0.02),
    "contempt": (-0.06, 0.02, 0.0, 0.0, 0.04, 0.0, 0.05),
    "calm": (-0.09, -0.08, 0.0, 0.0, -0.01, 0.0, 0.02),
}
"""Motion of `STEMS` for a full accent; that of an emotion is added to the neutral one."""
HELD: dict[str, tuple[float, ...]] = {
    "neutral": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "angry": (0.0, 0.0, 0.32, 0.18, 0.24, 0.0, 0.0),
    "happy": (0.0, 0.0, 0.0, 0.0, 0.06, 0.12, 0.0),
    "sad": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.08),
    "surprised": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
}
"""What an emotion holds of `STEMS` besides the network's expression, also between the accents:
lower lids and knit brows in anger, raised cheeks and lower lids in joy, heavy lids in sadness
(Ekman, Friesen and Hager 2002); amounts by eye."""
HELD_SPREAD, HELD_SECONDS = 0.25, 2.0
"""Standard deviation of its slow factor, and the sigma of the Gaussian that smooths its noise."""
QUESTION = (0.16, 0.15, 0.0, 0.0, 0.0, 0.02, -0.05)
QUESTION_SECONDS = (0.4, 0.35, 0.8)
FROWN = (0.0, 0.0, 0.16, 0.12, 0.05, 0.0, 0.02)
"""The same of a full frown of thought."""
DRIFT = (0.014, 0.012, 0.006, 0.006, 0.010, 0.008, 0.020)
"""Standard deviation of the slow drift of a calm face."""
DRIFT_SECONDS = 0.9
LID_DRIFT, LID_SECONDS = 0.045, 4.0
"""A slower drift of the lids, of the size of what six readers of the GRID corpus do from sentence
to sentence (measured once)."""
LEAD_SECONDS, LEAD_SPREAD = 0.06, 0.05
ATTACK_SECONDS, HOLD_SECONDS, DECAY_SECONDS = (0.15, 0.4), (0.05, 0.2), (0.45, 1.0)
TAKEN_SHARE = (0.3, 0.6)
"""Share of the accents with a motion: of the weakest, and more of the strongest."""
EVENT_SIDE, MOST_UNEVEN = 0.1, 0.15
"""Standard deviation and limit of the difference of the sides in an event."""
ALONE_SHARE, OTHER_BROW = 0.12, 0.2
"""Share of the accents that raise one brow, and how far the other one follows."""
STILL_SHARE = 0.2
"""Share of the phrases without accents of the brows; never the first one of a take."""
FROWN_SHARE, FROWN_PAUSE, FROWN_LEAD = 0.35, 0.5, 0.15
"""Share of the pauses with a frown, the shortest such pause, and its peak before the phrase; s."""
FROWN_SECONDS, FROWN_HEIGHT = ((0.3, 0.5), (0.15, 0.5), (0.5, 0.9)), (0.5, 1.0)
"""Attack, hold and decay."""
HELD_SIDE = 0.25
"""Share of a character's difference of the sides in an expression that is held."""
SWELL = 0.4
"""Part of an expression that comes and goes with the accents."""
_STYLES = by_emotion(ACCENTS)
_HELD = by_emotion(HELD)
_LEAST = np.array([-1.0 if stem == "eye_blink" else 0.0 for stem in STEMS])
"""Lower end of a control's range; lids widen to -1."""


class BrowEvents(NamedTuple):
    """Motion of a take before the emotion decides what moves."""

    accents: Float64
    """Swells of the accents on the left and the right [shape=(T, 2), range 0 to 1]."""
    frowns: Float64
    """The same of frowns of thought."""
    question: Float64
    """Swell of the questions [shape=(T,), range 0 to 1]."""
    drift: Float64
    """Slow noise of each stem [shape=(T, K)], control units."""
    posture: Float64
    """Share of `HELD` that is shown [shape=(T,)]."""


class BrowMove(NamedTuple):
    """Swell of an accent or a frown."""

    attack: float
    hold: float
    decay: float
    """Seconds."""
    sides: Float64
    """Heights on the left and the right [shape=(2,)]; 0 where there is none."""


def draw_accent(strength: float, side: float, rng: np.random.Generator) -> BrowMove:
    """Draw the motion of an accent.

    Parameters
    ----------
    strength : float, range 0 to 1
        Of the accent.
    side : float
        How much stronger the character's left side is.
    rng : numpy.random.Generator
        Gives eight numbers, whatever they are.
    """
    is_taken = rng.random() < TAKEN_SHARE[0] + TAKEN_SHARE[1] * strength
    attack, hold, decay = (
        float(rng.uniform(*span)) for span in (ATTACK_SECONDS, HOLD_SECONDS, DECAY_SECONDS)
    )
    height = (0.25 + 0.75 * strength) * rng.uniform(0.7, 1.2)
    sides = _uneven(side, rng)
    alone, place = rng.random(2)
    if alone < ALONE_SHARE:
        is_stronger = place < 0.7
        sides[int((side >= 0) == is_stronger)] *= OTHER_BROW
    return BrowMove(attack, hold, decay, is_taken * height * sides)


def draw_frown(side: float, rng: np.random.Generator) -> BrowMove:
    """Draw the frown of a pause; its height is 0 in most."""
    is_taken = rng.random() < FROWN_SHARE
    attack, hold, decay = (float(rng.uniform(*span)) for span in FROWN_SECONDS)
    height = rng.uniform(*FROWN_HEIGHT)
    return BrowMove(attack, hold, decay, is_taken * height * _uneven(side, rng))


def _uneven(side: float, rng: np.random.Generator) -> Float64:
    """Factors on the left and the right side in an event [shape=(2,)]."""
    event = float(np.clip(EVENT_SIDE * rng.standard_normal(), -MOST_UNEVEN, MOST_UNEVEN))
    return 1 + np.array([0.5, -0.5]) * (side + event)


class Brows:
    """Motion of a take before the emotion decides what moves.

    Parameters
    ----------
    traits : Traits
        Of the character.
    rng : numpy.random.Generator
        Equal generators give equal motion.
    """

    def __init__(self, traits: Traits, rng: np.random.Generator) -> None:
        self.traits, self.swells = traits, Swells(5)
        self.cues, noise = rng.spawn(2)
        seconds = (*[DRIFT_SECONDS] * len(STEMS), LID_SECONDS, HELD_SECONDS)
        self.noise = Noise((*DRIFT, LID_DRIFT, HELD_SPREAD), seconds, noise)
        self.is_still, self.is_first = False, True

    def cue(self, cue: Cue) -> None:
        """Begin the motion of an accent, of a question, or of thought in a pause."""
        if cue.kind == "start":
            self.is_still = bool(self.cues.random() < STILL_SHARE) and not self.is_first
            self.is_first = False
        elif cue.kind == "accent":
            move = draw_accent(cue.size, self.traits.side, self.cues)
            peak = cue.time - LEAD_SECONDS + LEAD_SPREAD * self.cues.standard_normal()
            if not self.is_still:
                self._add(peak, move, 0, cue.known)
        elif cue.kind == "pause" and cue.size == FROWN_PAUSE and cue.time:
            move = draw_frown(self.traits.side, self.cues)
            frown = cue.before_next(FROWN_LEAD + move.hold, FROWN_PAUSE + move.attack)
            if frown is not None:
                self._add(frown, move, 2, cue.known)
        elif cue.kind == "end" and cue.is_question:
            self.swells.add(cue.time - 0.15, QUESTION_SECONDS, {4: 1.0}, cue.known)

    def _add(self, peak: float, move: BrowMove, channel: int, known: float) -> None:
        left, right = move.sides
        seconds = move.attack, move.hold, move.decay
        self.swells.add(peak, seconds, {channel: left, channel + 1: right}, known)

    def at(self, first: int, count: int, shown: Float64) -> BrowEvents:
        """Events of the next frames, of which the share `shown` [shape=(n,)] is seen."""
        swells, noise = self.swells.at(first, count), self.noise.at(first, count)
        drift = noise[:, : len(STEMS)].copy()
        drift[:, LIDS] += noise[:, -2]
        share = shown[:, None]
        raised = self.traits.brow_range * (1 - np.exp(-swells[:, :4])) * share
        return BrowEvents(
            raised[:, :2],
            raised[:, 2:],
            np.minimum(swells[:, 4], 1) * shown,
            drift * share,
            np.maximum(1 + noise[:, -1], 0) * shown,
        )


def move_brows(
    curves: Float32,
    neutral: Float32,
    controls: ControlSet,
    events: BrowEvents,
    mixture: Float32,
    side: float,
    amount: float,
) -> None:
    """Add the motion to curves, in place; nothing at an amount of 0.

    Controls approach the end of their range and do not reach it: a motion of m takes the share m
    of what is left.

    Parameters
    ----------
    curves : array [shape=(T, C)]
        Changed.
    neutral : array [shape=(T, C)]
        The neutral reading, without this motion; may be the same array as `curves`.
    controls : ControlSet
        Columns.
    events : BrowEvents
        From `Brows`.
    mixture : array [shape=(T, S)]
        Emotion shown at each frame: weights times intensity. With 0 the neutral reading gets the
        same motion as a neutral take.
    side : float
        How much stronger the left side is, of an expression that is held.
    amount : float
        Factor.
    """
    if not amount:
        return
    shares = np.concatenate([np.ones((len(curves), 1)), mixture[:, 1:]], axis=1)
    gains = amount * (shares @ _STYLES)
    posture = amount * events.posture[:, None] * (mixture[:, 1:] @ _HELD[1:])
    calm = amount * (events.question[:, None] * np.asarray(QUESTION) + events.drift)
    for place, letter in enumerate("LR"):
        swells = events.accents[:, place]
        breath = 1 + amount * SWELL * (swells - 0.4)
        breath *= 1 + min(amount, 1) * (side, -side)[place] * HELD_SIDE
        columns = [controls.index(f"CTRL_{letter}_{stem}.ty") for stem in STEMS]
        held = neutral[:, columns]
        values = np.clip(held + (curves[:, columns] - held) * breath[:, None], _LEAST, 1)
        thought = amount * events.frowns[:, place, None] * np.asarray(FROWN)
        motion = np.clip(gains * swells[:, None] + posture + thought + calm, -1, 1)
        room = np.where(motion > 0, 1 - values, values - _LEAST)
        curves[:, columns] = values + motion * room
