"""Blinks, gaze, brows, head and neck of a take, or of a voice that has not ended.

The times of all events come from the voice and the seed alone. What they move depends on the
emotion shown, which is 0 in the neutral reading: both readings blink and look alike, and intensity
0 gives the neutral reading with its motion.

Letters: T frames at 30 per second, C controls, S styles.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from deitalk.audio.frames import FRAME_RATE
from deitalk.config.rules import Idle
from deitalk.emotions import LABELS
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.eyes import LID_SHARE, Blinks, Gaze, as_controls
from deitalk.postprocess.life.head import (
    BREATH,
    SWALLOWS,
    BrowEvents,
    Brows,
    Head,
    move_brows,
    neck_tracks,
)
from deitalk.postprocess.life.voice import STILL_SECONDS, Cue, Seeds, Traits, Voice, presence
from rig import ControlSet
from rig.arrays import Float32, Float64
from rig.controls import DEFAULT_ID
from rig.curves import HEAD

# Left and right of the mouth: no face speaks or smiles evenly.
#
# Speech leans to the character's side, an expression further, and from event to event with the
# brows. `LEANS` are of the size of six Live Link takes, medians of the difference of the sides
# over their mean: smiles .03 to .20, corners pulled down .09 to .46, stretch .02 to .31, parted
# lips .01 to .08; a character's `side` is .10 to .15.

LEANS = {
    "mouth_cornerPull": 0.7,
    "mouth_sharpCornerPull": 0.7,
    "mouth_dimple": 0.7,
    "mouth_cornerDepress": 1.0,
    "mouth_stretch": 0.6,
    "mouth_upperLipRaise": 0.3,
    "mouth_lowerLipDepress": 0.3,
    "nose": 1.0,
    "nose_nasolabialDeepen": 0.8,
}
"""Factor on the character's side, by control; of the nose the wrinkle, as lips are sneered."""
SPOKEN = 0.5
"""Share of it in the neutral reading."""
EVENT = 0.4
"""Of the difference of the brows' accents."""


def lean_mouth(
    curves: Float32,
    neutral: Float32,
    controls: ControlSet,
    accents: Float64,
    side: float,
    amount: float,
) -> None:
    """Let one side do more, in place; in the neutral reading too, so intensity 0 stays it.

    Parameters
    ----------
    curves : array [shape=(T, C)]
        Changed.
    neutral : array [shape=(T, K)]
        `mouth_columns` of the neutral reading as the network gave it.
    controls : ControlSet
        Columns.
    accents : array [shape=(T, 2), range 0 to 1]
        Swells of the brows' accents on the left and the right.
    side : float
        How much stronger the left side is.
    amount : float
        Factor.
    """
    columns = mouth_columns(controls)
    event = side + EVENT * (accents[:, 0] - accents[:, 1])[:, None]
    leans = 0.5 * amount * np.array([sign * lean for lean in LEANS.values() for sign in (1, -1)])
    expression = curves[:, columns] - neutral
    curves[:, columns] += SPOKEN * side * leans * neutral + event * leans * expression


def mouth_columns(controls: ControlSet) -> NDArray[np.intp]:
    """Columns of `LEANS`, left before right [shape=(K,)]."""
    return _columns(controls.names)


@lru_cache(maxsize=8)
def _columns(names: tuple[str, ...]) -> NDArray[np.intp]:
    found = [names.index(f"CTRL_{side}_{stem}.ty") for stem in LEANS for side in "LR"]
    return np.array(found, np.intp)


ADDED_CONTROLS = ("_eye_blink.", "_eye.t")
"""Parts of the names of controls that blinks and gaze move, whatever the emotion."""
LOWER_LID = 0.14
"""Inner squint of a whole blink: the muscle that closes the lids draws the lower one up and towards
the nose (Evinger, Manning and Sibony 1991); amount by eye."""
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


@dataclass(frozen=True)
class Motion:
    """Motion of consecutive frames above the mouth [shape=(n,) each]."""

    side: float
    """How much stronger the character's left side moves than the right."""
    amount: float
    """Factor on brows, lids and cheeks."""
    lids: Float64
    """Closure of the left and the right lids [shape=(n, 2), range 0 to 1]."""
    gaze: tuple[Float64, Float64]
    """Degrees to the character's left and up, and those of the neutral reading [shape=(n, 2)]."""
    brows: BrowEvents
    head: Float32 | None
    """Track of the head [shape=(n, 6)], see `deitalk.postprocess.life.head`; None if it is off."""
    neck: dict[str, Float32]
    """Tracks of the neck's controls, range 0 to 1; empty if the head is off."""
    mixture: Float32
    """Emotion shown at each frame [shape=(n, S)]."""

    def move(self, curves: Float32, neutral: Float32, controls: ControlSet) -> None:
        """Add the motion to both readings, in place; a rig other than the board stays as it is.

        Parameters
        ----------
        curves : array [shape=(n, C)]
            The face that is shown.
        neutral : array [shape=(n, C)]
            The neutral reading of the same speech.
        controls : ControlSet
            Names of the columns.
        """
        if controls.id == DEFAULT_ID:
            plain = neutral[:, mouth_columns(controls)]
            self._add(curves, neutral, plain, controls, acted=True)
            self._add(neutral, neutral, plain, controls, acted=False)

    def show(self, curves: Float32, neutral: Float32, controls: ControlSet) -> None:
        """As `move`, to the face that is shown alone."""
        if controls.id == DEFAULT_ID:
            plain = neutral[:, mouth_columns(controls)]
            self._add(curves, neutral, plain, controls, acted=True)

    def _add(
        self,
        curves: Float32,
        neutral: Float32,
        plain: Float32,
        controls: ControlSet,
        *,
        acted: bool,
    ) -> None:
        """Add the motion to one reading; `plain` are mouth columns of the neutral one."""
        mixture = self.mixture if acted else np.zeros_like(self.mixture)
        lean_mouth(curves, plain, controls, self.brows.accents, self.side, self.amount)
        move_brows(curves, neutral, controls, self.brows, mixture, self.side, self.amount)
        move_eyes(curves, controls, self.gaze[not acted], self.lids)
        for name, track in self.neck.items():
            place = controls.index(name)
            curves[:, place] += track * (1 - curves[:, place])


def attend(gaze: Float64, held: Float64, mixture: Float32) -> Float64:
    """Gaze of an emotion, degrees: anger stares, sadness alone looks where its head is lowered to.

    Parameters
    ----------
    gaze : array [shape=(n, 2)]
        Fixations and aversions of a neutral face.
    held : array [shape=(n, 2)]
        Turn of the eyes that undoes the posture of the head.
    mixture : array [shape=(n, S)]
        Emotion shown at each frame.
    """
    angry, sad = (mixture[:, [LABELS.index(name)]] for name in ("angry", "sad"))
    shown: Float64 = gaze * np.maximum(1 - STARE * angry, 0) + held * np.maximum(1 - sad, 0)
    return shown


def move_eyes(
    curves: Float32, controls: ControlSet, gaze: Float32 | Float64, lids: Float32 | Float64
) -> None:
    """Turn the eyes and close the lids, in place.

    Parameters
    ----------
    curves : array [shape=(T, C)]
        Changed.
    controls : ControlSet
        Columns, of the board.
    gaze : array [shape=(T, 2)]
        Degrees to the character's left and up.
    lids : array [shape=(T, 2), range 0 to 1]
        Closure of the left and the right lids.
    """
    looks = as_controls(gaze)
    lowered = LID_SHARE * np.maximum(-looks[:, 1], 0)
    for place, side in enumerate("LR"):
        lid = controls.index(f"CTRL_{side}_eye_blink.ty")
        closure = np.maximum(lids[:, place], lowered)
        curves[:, lid] += closure * (1 - curves[:, lid])
        squint = controls.index(f"CTRL_{side}_eye_squintInner.ty")
        curves[:, squint] += LOWER_LID * lids[:, place] * (1 - curves[:, squint])
        for axis in (0, 1):
            curves[:, controls.index(f"CTRL_{side}_eye.t{'xy'[axis]}")] += looks[:, axis]


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
    """

    def __init__(
        self,
        seeds: Seeds,
        idle: Idle = Idle(),
        life: Life = Life(),
        traits: Traits | None = None,
        voice: Voice | None = None,
    ) -> None:
        self.life = amounts = life.times(idle)
        self.traits = traits = traits or Traits.of(seeds.character())
        self.n_frames = 0
        self.place = self.looks = np.array(life.look_at)
        self.turns: list[tuple[int, tuple[float, float]]] = []
        self.turning = 0
        self.end = math.inf if voice is None else (voice.n_frames - 1) / FRAME_RATE
        self.silence = 0.0 if voice is None else voice.silence
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

    def _looks(self, first: int, count: int) -> Float64:
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

    def take(self, speaking: Float32, mixture: Float32) -> Motion:
        """Motion of the next frames.

        Parameters
        ----------
        speaking : array [shape=(n,)]
            1 in speech, else 0.
        mixture : array [shape=(n, S)]
            Emotion shown: weights times intensity.
        """
        first, count, amounts = self.n_frames, len(speaking), self.life
        self.n_frames += count
        shown = presence(first, count, self.end, self.silence)
        mixture = np.minimum(mixture, MOST_SHOWN)
        looks = self.gaze.at(first, count)
        if amounts.gaze and math.isfinite(self.end):  # those of a stream are known too late
            for time in self.gaze.shifts:
                self.blinks.draw_to(time)
            self.gaze.shifts = []
        moves = amounts.head * shown[:, None] * self.head.at(first, count, speaking)
        posture = amounts.head * shown[:, None] * self.head.posture(mixture)
        turn = moves[:, : len(HEAD)] * self.head.liveliness(mixture)[:, None]
        head = (turn + posture).astype(np.float32)
        turned, held = turn[:, :2] * AGAINST, posture[:, :2] * AGAINST
        place = shown[:, None] * self._looks(first, count)
        calm = amounts.gaze * (looks + turned) + place
        acted = amounts.gaze * (attend(looks, held, mixture) + turned) + place
        return Motion(
            self.traits.side,
            amounts.brows,
            self.blinks.at(first, count) * bool(amounts.blinks),
            (acted, calm),
            self.brows.at(first, count, shown),
            head if amounts.head else None,
            neck_tracks(moves[:, BREATH], moves[:, SWALLOWS], head[:, 0]) if amounts.head else {},
            mixture,
        )


def plan_motion(
    voice: Voice,
    mixture: Float32,
    seeds: Seeds,
    idle: Idle = Idle(),
    life: Life = Life(),
    traits: Traits | None = None,
) -> Motion:
    """Motion of a whole take.

    Parameters
    ----------
    voice : Voice
        Of the recording.
    mixture : array [shape=(T, S)]
        Weights of the emotions times the applied intensity.
    seeds, idle, life, traits
        As for `MotionStream`.
    """
    stream = MotionStream(seeds, idle, life, traits, voice)
    for cue in voice.cues():
        stream.cue(cue)
    lead = min(SPEAKING_LEAD, voice.n_frames)
    return stream.take(np.append(voice.speaking[lead:], np.zeros(lead, np.float32)), mixture)
