"""Motion above the mouth played on curves: what the tracks of `MotionTracks` move.

What moves depends on the emotion shown, which is 0 in the neutral reading: both readings blink and
look alike, and intensity 0 gives the neutral reading with its motion.

Letters: B streams, T frames, R = 2 readings (neutral, then the one that is shown), C controls.
"""

import torch
from torch import Tensor, nn

from deitalk.emotions import by_emotion
from deitalk.postprocess.life.face import ACCENTS, HELD, STEMS, UPPER
from deitalk.postprocess.life.gaze import DOWN_DEGREES, LID_SHARE, SIDE_DEGREES, UP_DEGREES
from deitalk.postprocess.life.neck import BREATH_CONTROL, SWALLOW_CONTROL, TURNS
from deitalk.postprocess.torch_columns import Columns, constant
from deitalk.postprocess.tracks import MOTION, MotionTracks
from rig import ControlSet

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
"""Factor on the character's side, by control; of the nose the wrinkle, as lips are sneered.

Speech leans to the character's side, an expression further, and from event to event with the brows.
The factors are of the size of six Live Link takes, medians of the difference of the sides over
their mean: smiles .03 to .20, corners pulled down .09 to .46, stretch .02 to .31, parted lips .01
to .08; a character's `side` is .10 to .15.
"""
SPOKEN = 0.5
"""Share of it in the neutral reading."""
EVENT = 0.4
"""Of the difference of the brows' accents."""
YIELDED, SMILE_YIELDED = 0.85, 2.5
"""Share of a neutral face's gestures that an emotion at intensity 1 takes away, and of its smiles:
what it shows must not depend on the seed."""
SWELL, USUAL_SWELL = 0.3, 0.2
"""Part of an expression above the mouth that comes and goes with the accents, and their mean in
speech: in silence, which has none, it is held as in speech on the average."""
HELD_SIDE = 0.5
"""Share of a character's difference of the sides in an expression that is held: one side is by so
much stronger, the other by so much weaker."""
LOWER_LID = 0.14
"""Inner squint of a whole blink: the muscle that closes the lids draws the lower one up and towards
the nose (Evinger, Manning and Sibony 1991); amount by eye."""
EYES = ("eye_blink.ty", "eye_squintInner.ty", "eye.tx", "eye.ty")
"""Controls that blinks and gaze move, on both sides."""


class Play(nn.Module):
    """Motion of frames added to both readings.

    Parameters
    ----------
    controls : ControlSet
        The board's.
    """

    leans: Tensor
    styles: Tensor
    poses: Tensor
    least: Tensor
    swells: Tensor
    yielded: Tensor

    def __init__(self, controls: ControlSet) -> None:
        super().__init__()
        size = len(controls)

        def columns(names: "list[str]") -> Columns:
            return Columns([controls.index(name) for name in names], size)

        self.mouth = columns([f"CTRL_{side}_{stem}.ty" for stem in LEANS for side in "LR"])
        self.face = columns([f"CTRL_{side}_{stem}.ty" for side in "LR" for stem in STEMS])
        neck = [BREATH_CONTROL, SWALLOW_CONTROL, *TURNS]
        self.eyes = columns([f"CTRL_{side}_{stem}" for stem in EYES for side in "LR"] + neck)
        constant(self, "leans", [sign * 0.5 * lean for lean in LEANS.values() for sign in (1, -1)])
        constant(self, "styles", by_emotion(ACCENTS))
        constant(self, "poses", by_emotion(HELD))
        constant(self, "least", [-1.0 if stem == "eye_blink" else 0.0 for stem in STEMS])
        smiles = ("mouth_cornerPull", "eye_cheekRaise")
        shares = [SMILE_YIELDED if stem in smiles else YIELDED for stem in STEMS]
        constant(self, "yielded", shares)
        constant(self, "swells", [float(k < UPPER) for k in range(len(STEMS))])

    def forward(self, curves: Tensor, motion: Tensor, spoken: Tensor) -> Tensor:
        """Play tracks (B, T, 43) on curves (B, T, R, C), by the gate of the mouth (B, T, 1).

        Controls approach the end of their range and do not reach it: a motion of m takes the share
        m of what is left.
        """
        tracks = MotionTracks(*torch.split(motion, [*MOTION], dim=-1))
        curves = self._lean_mouth(curves, tracks)
        curves = self._move_face(curves, tracks, USUAL_SWELL * spoken.unsqueeze(2))
        return self._turn_eyes(curves, tracks)

    def _lean_mouth(self, curves: Tensor, tracks: MotionTracks) -> Tensor:
        """Let one side do more; in the neutral reading too, so that intensity 0 stays it."""
        part = self.mouth(curves)
        left, right = tracks.accents.chunk(2, dim=-1)
        event = (tracks.side + EVENT * (left - right)).unsqueeze(2)
        leans, neutral = tracks.amount.unsqueeze(2) * self.leans, part[:, :, :1]
        spoken = SPOKEN * tracks.side.unsqueeze(2) * leans * neutral
        return self.mouth.put(curves, part + spoken + event * leans * (part - neutral))

    def _move_face(self, curves: Tensor, tracks: MotionTracks, usual: Tensor) -> Tensor:
        """Move brows, lids and cheeks on accents, by the emotion that is shown, and by gestures.

        `usual` (B, T, 1, 1) is the mean of the accents.
        """
        # (B, T, R, sides, stems)
        part = torch.stack(self.face(curves).chunk(2, dim=-1), dim=-2)
        calm = part[:, :, :1]
        amount, side = tracks.amount.unsqueeze(2), tracks.side.unsqueeze(2)
        mixture = tracks.mixture.unsqueeze(2)[..., 1:]
        mixture = torch.cat((0 * mixture, mixture), dim=2)
        shown = mixture.sum(dim=-1, keepdim=True).clamp_max(1)
        styles, posture = mixture @ self.styles[1:], mixture @ self.poses[1:]
        accents = tracks.accents.unsqueeze(2)  # (B, T, 1, sides)
        # An expression swells on accents, and one side of it is stronger.
        uneven = torch.cat((side, -side), dim=-1) * amount.clamp_max(1) * HELD_SIDE
        swell = ((1 + amount * SWELL * (accents - usual)) * (1 + uneven)).unsqueeze(-1)
        values = calm + (part - calm) * (1 + (swell - 1) * self.swells)
        values = torch.maximum(values, self.least).clamp_max(1)
        gestures = torch.stack(tracks.gestures.chunk(2, dim=-1), dim=-2).unsqueeze(2)
        moved = gestures * (1 - self.yielded * shown.unsqueeze(-1)).clamp_min(0)
        moved = moved + accents.unsqueeze(-1) * styles.unsqueeze(3)
        moved = moved + (tracks.posture.unsqueeze(2) * posture).unsqueeze(3)
        moved = (amount.unsqueeze(-1) * moved).clamp(-1, 1)
        values = values + moved * torch.where(moved > 0, 1 - values, values - self.least)
        values = torch.where(amount.unsqueeze(-1) > 0, values, part)
        return self.face.put(curves, values.flatten(-2))

    def _turn_eyes(self, curves: Tensor, tracks: MotionTracks) -> Tensor:
        """Turn the eyes, close the lids, draw breath, swallow, turn the neck."""
        part = self.eyes(curves)
        looks = torch.stack((tracks.calm_gaze, tracks.gaze), dim=2)  # (B, T, R, 2)
        side, up = looks.chunk(2, dim=-1)
        up = up / torch.where(up > 0, UP_DEGREES + 0 * up, DOWN_DEGREES + 0 * up)
        inwards = tracks.vergence.unsqueeze(2)
        side = torch.cat((side - inwards, side + inwards), dim=-1) / SIDE_DEGREES
        lids, neck = tracks.lids.unsqueeze(2), tracks.neck.unsqueeze(2)
        closure = torch.maximum(lids, LID_SHARE * (-up).clamp_min(0))
        lids, neck = (track.expand(-1, -1, 2, -1) for track in (lids, neck))
        shut = torch.cat((closure, LOWER_LID * lids), dim=-1) * (1 - part[..., :4])
        tense = neck * (1 - part[..., 8:])
        moved = torch.cat((shut, side, up.expand(-1, -1, -1, 2), tense), dim=-1)
        return self.eyes.put(curves, part + moved)
