"""Blinks, gaze, brows, head and neck of one take.

The times of all events come from the voice and the seed alone. What they move depends on the
emotion shown, which is 0 in the neutral reading: both readings blink and look alike, and intensity
0 gives the neutral reading with its motion.

Letters: T frames at 30 per second, C controls, S styles.
"""

from dataclasses import dataclass

import numpy as np

from deitalk.config import Idle
from deitalk.emotions import EMOTIONS
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.blinks import lid_closure, plan_blinks
from deitalk.postprocess.life.brows import BrowEvents, move_brows, plan_brows
from deitalk.postprocess.life.gaze import LID_SHARE, as_controls, gaze_degrees, plan_aversions
from deitalk.postprocess.life.head import head_motion
from deitalk.postprocess.life.mouth import lean_mouth, mouth_columns
from deitalk.postprocess.life.neck import neck_motion
from deitalk.postprocess.life.tracks import presence
from deitalk.postprocess.life.traits import Seeds, Traits
from deitalk.postprocess.life.voice import Voice
from rig import ControlSet
from rig.arrays import Float32, Float64
from rig.controls import DEFAULT_ID

ADDED_CONTROLS = ("_eye_blink.", "_eye.t")
"""Parts of the names of controls that blinks and gaze move, whatever the emotion."""
LOWER_LID = 0.14
"""Inner squint of a whole blink: the muscle that closes the lids draws the lower one up and towards
the nose (Evinger, Manning and Sibony 1991); amount by eye."""
AGAINST = np.array([1, -1], np.float32)
"""Signs of a turn of the eyes that undoes yaw and pitch of the head."""
STARE = 0.8
"""Share of the aversions that anger takes away at intensity 1: its gaze stays on the listener."""
MOST_SHOWN = 1.5
"""Intensity above which accents and posture grow no more."""


@dataclass(frozen=True)
class TakeMotion:
    """Motion of a take above the mouth."""

    amounts: Life
    traits: Traits
    lids: Float32
    """Closure of the left and the right lids [shape=(T, 2), range 0 to 1]."""
    gaze: tuple[Float32 | Float64, Float32]
    """Degrees to the character's left and up, and those of the neutral reading [shape=(T, 2)]."""
    brows: BrowEvents
    head: Float32 | None
    """Track of the head [shape=(T, 6)], see `deitalk.postprocess.life.head`; None if it is off."""
    neck: dict[str, Float32]
    """Tracks of the neck's controls [shape=(T,), range 0 to 1]; empty if the head is off."""
    mixture: Float32
    """Emotion shown at each frame [shape=(T, S)]."""

    def move(self, curves: Float32, neutral: Float32, controls: ControlSet) -> None:
        """Add the motion to both readings, in place; a rig other than the board stays as it is.

        Parameters
        ----------
        curves : array [shape=(T, C)]
            The face that is shown.
        neutral : array [shape=(T, C)]
            The neutral reading of the same speech.
        controls : ControlSet
            Names of the columns.
        """
        if controls.id != DEFAULT_ID:
            return
        calm = np.zeros_like(self.mixture)
        side, amount = self.traits.side, self.amounts.brows
        plain = neutral[:, mouth_columns(controls)]
        for reading, mixture, gaze in zip(
            (curves, neutral), (self.mixture, calm), self.gaze, strict=True
        ):
            lean_mouth(reading, plain, controls, self.brows.accents, side, amount)
            move_brows(reading, neutral, controls, self.brows, mixture, side, amount)
            move_eyes(reading, controls, gaze, self.lids)
            move_neck(reading, controls, self.neck)


def attend(gaze: Float32 | Float64, held: Float32 | Float64, mixture: Float32) -> Float64:
    """Gaze of an emotion, degrees: anger stares, sadness alone looks where its head is lowered to.

    Parameters
    ----------
    gaze : array [shape=(T, 2)]
        Fixations and aversions of a neutral face.
    held : array [shape=(T, 2)]
        Turn of the eyes that undoes the posture of the head.
    mixture : array [shape=(T, S)]
        Emotion shown at each frame.
    """
    angry, sad = (mixture[:, [EMOTIONS.index(name)]] for name in ("angry", "sad"))
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


def move_neck(curves: Float32, controls: ControlSet, neck: dict[str, Float32]) -> None:
    """Add tracks of the neck by name [shape=(T,), range 0 to 1], in place."""
    for name, track in neck.items():
        place = controls.index(name)
        curves[:, place] += track * (1 - curves[:, place])


def plan_motion(
    voice: Voice,
    mixture: Float32,
    seeds: Seeds,
    idle: Idle = Idle(),
    life: Life = Life(),
    traits: Traits | None = None,
) -> TakeMotion:
    """Draw the motion of a take.

    Parameters
    ----------
    voice : Voice
        Of the recording.
    mixture : array [shape=(T, S)]
        Weights of the emotions times the applied intensity.
    seeds : Seeds
        Of the recording and its actor.
    idle : Idle
        The model's own numbers.
    life : Life
        Factors on them, and the listener's place.
    traits : Traits, optional
        Of the character; drawn from the seeds by default.
    """
    n_frames = voice.n_frames
    amounts = life.times(idle)
    traits = traits or Traits.of(seeds.character())
    rng = seeds.generator("gaze")
    aversions = plan_aversions(voice, rng, traits.avoids)
    gaze, shifts = gaze_degrees(n_frames, aversions, rng)
    shown = presence(n_frames, voice.silence)[:, None]
    place = shown * np.asarray(life.look_at, np.float32)
    mixture = np.minimum(mixture, MOST_SHOWN)
    head, neck = None, {}
    turned = held = np.zeros((n_frames, 2), np.float32)
    if amounts.head:
        motion, posture = head_motion(voice, traits, mixture, seeds.generator("head"))
        motion, head = amounts.head * motion, amounts.head * (motion + posture)
        neck = neck_motion(voice, head, amounts.head, seeds.generator("neck"))
        turned, held = (track[:, :2] * AGAINST for track in (motion, amounts.head * posture))
    calm = amounts.gaze * (gaze + turned) + place
    acted = amounts.gaze * (attend(gaze, held, mixture) + turned) + place
    rng, lids = seeds.generator("blinks"), np.zeros((n_frames, 2), np.float32)
    if amounts.blinks:
        factor = traits.blink_interval / amounts.blinks
        shifts = shifts if amounts.gaze else []
        lids = lid_closure(plan_blinks(voice, rng, idle, shifts, factor), n_frames, rng)
    brows = plan_brows(voice, traits, seeds.generator("brows"))
    return TakeMotion(amounts, traits, lids, (acted, calm), brows, head, neck, mixture)
