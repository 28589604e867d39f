"""Brows, and turn and shift of the head, on the voice.

- Nods on stressed syllables, deeper where level and pitch are high (Hadar et al. 1983; Munhall et
  al. 2004; Graf et al. 2002), lowering at the end of a phrase and a raise before the next one
  (McClave 2000), stillness in pauses, where the breath lifts head and shoulders a little.
- An emotion has a posture and a liveliness: sadness lowers and tilts the head, anger lowers and
  advances it, surprise and fear draw it back (Coulson 2004), disgust turns it away, contempt
  raises it (amounts of the moods by eye); motion is wider and faster in happiness and
  anger, and smaller in sadness, than in neutral speech (Busso et al. 2007).
- `NODS`, `SWAY` and `STIR` are set so that range and speed of a neutral take, and the correlation
  of its pitch with stressed syllables, are those of six readers on video (docs/life.md).

The track has six columns (`rig.curves.HEAD`): yaw to the character's right, pitch up, roll to the
right shoulder, degrees; then the shift in cm to the character's
left, up and forward, the axes of the embedded head.

Letters: T frames at 30 per second.
"""

import math
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.emotions import LABELS, by_emotion
from deitalk.postprocess.life.voice import LISTENING_SECONDS, Cue, Noise, Swells, Traits
from rig.arrays import Float32, Float64
from rig.curves import HEAD

# Brows, lids and cheeks on the voice.
#
# - Brows rise with pitch accents, their peak 60 ms before that of the accent (Flecha-Garcia 2010);
#   brow height goes with pitch (Cave et al. 1996; Huron and Shanahan 2013) and lifts in questions
#   (Srinivasan and Massaro 2003). Not every accent brings a brow: the stronger, the more often.
# - Which muscles: the emotion decides. Accents knit brows in anger (AU4, AU7), raise the inner ones
#   in sadness (AU1, AU4), all in surprise (AU1, AU2, AU5), cheeks and lower lids in happiness (AU6)
#   (Ekman 1979; Ekman, Friesen and Hager 2002).
# - Onsets of 150 to 400 ms and slower offsets, as of spontaneous brow raises and smiles (Schmidt,
#   Cohn and Tian 2003).
# - Sides differ by 10 to 15 %, by the character and from event to event (`traits.ASYMMETRY`); a few
#   raises are of one brow, more often the stronger one. Some phrases have none at all.
# - Brows knit in thought, in a pause before a phrase (Ekman 1979; Goodwin and Goodwin 1986).
#
# An expression is held no longer as a plateau: it swells with accents and yields between them. What
# an emotion holds besides (`HELD`), lids above all, and the opening of the lids waver slowly.
#
# Letters: T frames at 30 per second, S styles, K stems of control names, 2 the sides.


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


class BrowEvents(NamedTuple):
    """Motion of a take before the emotion decides what moves."""

    accents: Float64
    """Swells of the accents on the left and the right [shape=(T, 2), range 0 to 1]."""
    frowns: Float64
    """The same of frowns of thought."""
    question: Float64
    """Swell of the questions [shape=(T, 1), range 0 to 1]."""
    drift: Float64
    """Slow noise of each stem [shape=(T, K)], control units."""
    posture: Float64
    """Share of `HELD` that is shown [shape=(T, 1)]."""


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
            np.minimum(swells[:, 4:], 1) * share,
            drift * share,
            np.maximum(1 + noise[:, -1:], 0) * share,
        )


# Neck: breath before phrases (.3 to .6 s: Winkworth et al. 1995), swallowing about once a minute in
# pauses (Lear et al. 1965; it takes a second: Logemann 1998), the muscle that turns the head
# (Bexander et al. 2005). Amounts are set by eye: no data here measures a neck.

INHALE = 0.35
INHALE_SECONDS, INHALE_LEAD = (0.45, 0.0, 0.35), 0.08
"""Rise, top and fall; the top is so long before the phrase."""
SWALLOW_EVERY, LEAST_WAIT = 60.0, 5.0
"""Mean and shortest time between two swallows, seconds."""
SWALLOW_PAUSE = 1.2
SWALLOW = (0.45, 0.15, 0.4)
"""Rise, top and fall of a swallow, seconds."""
FREE_DEGREES, FULL_DEGREES = 2.0, 40.0
"""Yaw from which a turning muscle shows, and what it takes more to contract in full."""

BREATH_CONTROL, SWALLOW_CONTROL = "CTRL_neck_throatExhaleInhale.ty", "CTRL_C_neck_swallow.ty"
TURNS = ("CTRL_L_neck_mastoidContract.ty", "CTRL_R_neck_mastoidContract.ty")


def neck_tracks(breath: Float64, swallows: Float64, yaw: Float32 | Float64) -> Float64:
    """Tracks of `BREATH_CONTROL`, `SWALLOW_CONTROL` and `TURNS` [shape=(T, 4), range 0 to 1].

    Of breath and swallowing (range 0 to 1) and of the head's turn in degrees [shape=(T,)].
    """
    turns = (np.maximum(np.abs(yaw) - FREE_DEGREES, 0) / FULL_DEGREES).clip(max=1)
    tracks: Float64 = np.stack((breath, swallows, turns * (yaw > 0), turns * (yaw < 0)), axis=1)
    return tracks.clip(0, 1)


NODS = (0.26, 1.8, 0.26)
"""Turn of a full nod, degrees: its pitch, and the standard deviation of its yaw and roll."""
NOD_SECONDS = ((0.13, 0.2), (0.15, 0.24))
"""Attack and decay."""
NOD_SPEED = 15.0
"""Degrees per second: a nod that would go down faster takes longer and is less deep. The fastest
moments of six readers' pitch are of 7 to 28 (mean 17)."""
NOD_LAG, NOD_SPREAD = 0.03, 0.015
"""Seconds from the peak of the syllable to the lowest point, and their standard deviation."""
NOD_SHARE, ASIDE_SHARE, UP_SHARE = (0.78, 0.2), 0.06, 0.05
"""Share of the stressed syllables with a nod: of the weakest, and more of the strongest. Of these
the share that turns or tilts the head instead (McClave 2000), and that raises it."""
TURN, TURN_SECONDS = ((2.2, 0.4, 0.5), (0.5, 0.4, 1.7)), ((0.35, 0.6), (0.5, 1.0))
"""Yaw, pitch and roll of a full turn and of a full tilt; attack and decay."""
MOST_ASIDE = 1.2
"""Height of the largest turn or tilt."""
VIGOUR, VIGOUR_SECONDS = 0.35, 1.6
"""A speaker moves the head in phases: standard deviation of the logarithm of the factor on nods and
slow turns, and the sigma of the Gaussian that its noise is smoothed with."""
LEAST_NOD, HIGH_NOD = 0.5, 0.3
"""Height of the nod of the weakest stress, and what a prominence of 1 adds to any."""
NOD_RAISE = 0.4
"""Pitch from which a speaker nods, degrees: about the mean of the nods."""
LISTENING_DEGREES = (0.8, 1.6)
"""Depth of single and double nods in long silence, `LISTENING_EVERY` apart (Dittmann and Llewellyn
1968)."""
SWAY, SWAY_SECONDS = (0.25, 0.7, 0.2), 0.7
STIR, STIR_SECONDS = (0.46, 0.28, 0.3), 0.14
"""Standard deviation of slow and of quick turns, yaw, pitch and roll in degrees, and the sigma of
the Gaussian that their noise is smoothed with."""
QUIET = 0.5
"""Share of the sway that is left in a pause."""
FINAL_DEGREES, INITIAL_DEGREES = -0.8, 0.5
"""Pitch at the end and before the start of a phrase."""
FINAL_SECONDS, INITIAL_SECONDS = (1.0, 0.1, 1.2), (0.6, 0.0, 0.8)
"""Attack, hold and decay."""
LATE_SECONDS = 0.4
"""Attack of the lowering where the end of a phrase is known late."""
INITIAL_LEAD, LIFT_LEAD = 0.2, 0.05
"""The raise and the breath are highest so long before a phrase, seconds."""
INHALE_AFTER, READY_AFTER = 0.6, 0.9
"""Seconds of a pause whose end is not known after which the breath is drawn and the head raised."""
BREATH_SECONDS, BREATH_CM, BREATH_DEGREES = 4.0, 0.05, 0.15
"""Period of quiet breathing, its lift, and the pitch that goes with it."""
INHALE_PAUSE, INHALE_CM, INHALE_DEGREES = 0.3, 0.14, 0.35
"""The same in a pause of at least 0.3 s before a phrase."""
LIFT_SECONDS = (0.35, 0.0, 1.2)
SHIFT_CM, SHIFT_SECONDS = (0.07, 0.05, 0.1), 0.8
POSTURE: dict[str, tuple[float, ...]] = {
    "neutral": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "angry": (0.0, -3.0, 0.0, 0.0, -0.1, 0.8),
    "happy": (0.0, 1.0, 1.5, 0.0, 0.1, 0.1),
    "sad": (0.0, -4.5, 2.5, 0.0, -0.3, -0.1),
    "surprised": (0.0, 2.5, 0.0, 0.0, 0.15, -0.7),
    "fear": (0.0, -1.0, 0.0, 0.0, -0.2, -1.0),
    "disgust": (4.0, 1.5, -1.5, 0.0, 0.0, -0.6),
    "contempt": (3.0, 3.5, 2.5, 0.0, 0.1, -0.3),
    "calm": (0.0, 0.0, 1.0, 0.0, -0.05, 0.0),
}
"""Held turn and shift of an emotion at intensity 1; its roll goes to the character's own side."""
LIVELINESS = {"neutral": 1.0, "angry": 1.35, "happy": 1.4, "sad": 0.85, "surprised": 1.25,
              "fear": 0.8, "disgust": 0.9, "contempt": 0.7, "calm": 0.5}  # fmt: skip
POSTURE_SECONDS = 0.35
"""Over which a posture, and the raise of speech, come and go."""
PITCH, UP, BREATH, SWALLOWS = 1, 4, 6, 7
CHANNELS = 8
"""The columns of `rig.curves.HEAD`, breath and swallowing of the neck."""


class Nod(NamedTuple):
    """A nod of one syllable."""

    lag: float
    """Seconds from the peak of the syllable to the lowest point."""
    attack: float
    """Seconds down."""
    decay: float
    """Seconds up."""
    degrees: Float64
    """Yaw, pitch and roll at the lowest point [shape=(3,)]; 0 where the syllable has no nod."""

    def scaled(self, factor: float) -> "Nod":
        """So much deeper; where that is faster than `NOD_SPEED`, longer and less deep."""
        degrees = factor * self.degrees
        fastest = 0.5 * np.pi * abs(float(degrees[1])) / self.attack
        share = max(fastest / NOD_SPEED, 1.0) ** 0.5
        return Nod(self.lag, share * self.attack, share * self.decay, degrees / share)


def draw_nod(strength: float, prominence: float, rng: np.random.Generator) -> Nod:
    """Draw the nod of a stressed syllable.

    Parameters
    ----------
    strength : float, range 0 to 1
        Of the stress.
    prominence : float
        Level and pitch of the syllable, as in `Voice`.
    rng : numpy.random.Generator
        Gives nine numbers, whatever they are.
    """
    lag = NOD_LAG + NOD_SPREAD * rng.standard_normal()
    height = LEAST_NOD + (1 - LEAST_NOD) * strength
    height *= (1 + HIGH_NOD * min(max(prominence, 0.0), 2.0)) * rng.uniform(0.5, 1.5)
    height *= rng.random() < NOD_SHARE[0] + NOD_SHARE[1] * strength
    quick, slow, kind = rng.random(3)
    aside = rng.standard_normal(2)
    sign = 1.0 if rng.random() < 0.5 else -1.0
    is_aside = kind < ASIDE_SHARE
    attack, decay = (
        low + share * (high - low)
        for (low, high), share in zip(
            TURN_SECONDS if is_aside else NOD_SECONDS, (quick, slow), strict=True
        )
    )
    if is_aside:
        yaw, pitch, roll = TURN[int(kind < ASIDE_SHARE / 2)]
        degrees = np.array([sign * yaw, -pitch, sign * roll]) / max(height / MOST_ASIDE, 1)
    else:
        up = 0.7 if kind > 1 - UP_SHARE else -1.0
        degrees = np.asarray(NODS) * np.array([aside[0], up, aside[1]])
    return Nod(lag, attack, decay, height * degrees)


class Head:
    """Motion of head and neck of a take, and the posture beneath it.

    Parameters
    ----------
    traits : Traits
        Of the character.
    rng : numpy.random.Generator
        Equal generators give equal motion.
    end : float
        Seconds of the last frame; infinite if it is not known.
    """

    def __init__(self, traits: Traits, rng: np.random.Generator, end: float = math.inf) -> None:
        self.traits, self.end, self.swells = traits, end, Swells(CHANNELS)
        self.cues, self.pauses, noise = rng.spawn(3)
        spread = (*SWAY, *STIR, *SHIFT_CM, 0.6, VIGOUR)
        seconds = [SWAY_SECONDS] * 3 + [STIR_SECONDS] * 3 + [SHIFT_SECONDS] * 3
        self.noise = Noise(spread, [*seconds, 1.5, VIGOUR_SECONDS], noise)
        self.phase = 2 * np.pi * self.pauses.random()
        self.swallow = self.pauses.exponential(SWALLOW_EVERY)
        """Seconds of the next one."""
        self.speaks = 0.0
        self.held = np.zeros((2, len(HEAD)))

    def cue(self, cue: Cue) -> None:
        """Begin the motion of a syllable, of a phrase's ends, or of a pause."""
        if cue.kind == "stress":
            vigour = math.exp(self.noise.peek(round(cue.time * FRAME_RATE))[-1])
            nod = draw_nod(cue.size, cue.prominence, self.cues).scaled(vigour)
            heights = dict(enumerate(nod.degrees))
            self.swells.add(cue.time + nod.lag, (nod.attack, 0.0, nod.decay), heights, cue.known)
        elif cue.kind == "start" and cue.stop is not None:
            attack, hold, decay = INITIAL_SECONDS
            seconds = attack, hold, min(decay, cue.size / 2)
            self.swells.add(cue.time - INITIAL_LEAD, seconds, {PITCH: INITIAL_DEGREES}, cue.known)
        elif cue.kind == "end":
            attack, hold, decay = FINAL_SECONDS
            seconds = min(attack, cue.size / 2), hold, decay
            pitch = {PITCH: -0.5 * FINAL_DEGREES if cue.is_question else FINAL_DEGREES}
            self.swells.add(cue.time, seconds, pitch, cue.known, LATE_SECONDS)
        elif cue.kind == "pause":
            self._pause(cue)

    def _pause(self, cue: Cue) -> None:
        """Breath and raise before the next phrase, a swallow, nods of a listener."""
        to_come = cue.stop is None
        if cue.size == (INHALE_AFTER if to_come else INHALE_PAUSE):
            lift = cue.before_next(LIFT_LEAD, INHALE_AFTER + LIFT_SECONDS[0])
            breath = cue.before_next(INHALE_LEAD, INHALE_AFTER + INHALE_SECONDS[0])
            if lift is not None and breath is not None:
                heights = {UP: INHALE_CM, PITCH: INHALE_DEGREES}
                self.swells.add(lift, LIFT_SECONDS, heights, cue.known)
                self.swells.add(breath, INHALE_SECONDS, {BREATH: INHALE}, cue.known)
        if to_come and cue.size == READY_AFTER:
            peak = cue.time + READY_AFTER + INITIAL_SECONDS[0]
            self.swells.add(peak, INITIAL_SECONDS, {PITCH: INITIAL_DEGREES}, cue.known)
        stop = min(self.end if cue.stop is None else cue.stop, self.end)
        if cue.size >= SWALLOW_PAUSE:
            begin = max(cue.known, cue.time, self.swallow - 0.5)
            is_due = begin == cue.known if to_come else stop - begin >= SWALLOW_PAUSE
            if is_due:
                self.swells.add(begin + 0.5, SWALLOW, {SWALLOWS: 1.0}, cue.known)
                wait = self.pauses.exponential(SWALLOW_EVERY - LEAST_WAIT)
                self.swallow = begin + LEAST_WAIT + wait
        if cue.size >= LISTENING_SECONDS:
            beats = 0.45 * np.arange(self.pauses.integers(1, 3))
            times = cue.time + cue.size + self.pauses.uniform(0, 2) + beats
            depths = self.pauses.uniform(*LISTENING_DEGREES, len(beats))
            for time, depth in zip(times.tolist(), depths.tolist(), strict=True):
                if time < stop - 1:
                    self.swells.add(time, (0.25, 0.0, 0.35), {PITCH: -depth}, cue.known)

    def at(self, first: int, count: int, speaking: Float32) -> Float64:
        """Motion of the next frames on a neutral face [shape=(n, `CHANNELS`)].

        `speaking` [shape=(n,)] is 1 in speech, else 0.
        """
        total, noise = self.swells.at(first, count), self.noise.at(first, count)
        speaks = np.empty(count)
        for k, value in enumerate(speaking.tolist()):
            self.speaks += (value - self.speaks) / (POSTURE_SECONDS * FRAME_RATE)
            speaks[k] = self.speaks
        lively = QUIET + (1 - QUIET) * speaks[:, None]
        total[:, :3] += (np.exp(noise[:, 10:]) * noise[:, :3] + noise[:, 3:6]) * lively
        total[:, 3:6] += noise[:, 6:9]
        time = np.arange(first, first + count) / FRAME_RATE
        quiet = np.sin(self.phase + 2 * np.pi * time / BREATH_SECONDS + noise[:, 9])
        quiet *= 1 - 0.7 * speaks
        total[:, UP] += BREATH_CM * quiet
        total[:, PITCH] += BREATH_DEGREES * quiet + NOD_RAISE * speaks
        total[:, SWALLOWS] *= 1 - speaks
        return total

    def posture(self, mixture: Float32) -> Float64:
        """Posture of the emotion in the next frames [shape=(n, 6)], which comes and goes slowly.

        `mixture` [shape=(n, S)] is the emotion shown: weights times intensity.
        """
        share = 1.4 / (POSTURE_SECONDS * FRAME_RATE)
        side = np.array([1, 1, 1 if self.traits.side >= 0 else -1, 1, 1, 1])
        rows: Float64 = mixture @ by_emotion(POSTURE) * side
        for row in rows:
            self.held[0] += share * (row - self.held[0])
            self.held[1] += share * (self.held[0] - self.held[1])
            row[:] = self.held[1]
        return rows

    def liveliness(self, mixture: Float32) -> Float64:
        """Factor on the motion [shape=(n,)]: of the emotion shown, and of the character."""
        calm = np.maximum(1 - mixture[:, 1:].sum(axis=1), 0)
        lively = np.array([LIVELINESS.get(name, 1.0) for name in LABELS])
        factor: Float64 = (calm + mixture[:, 1:] @ lively[1:]) * self.traits.head_range
        return factor
