"""From two readings of one speech, neutral and emotional, to the face an artist asked for.

The network reads the speech twice: once neutrally, once in the emotion. The difference is the
expression; it is scaled by the intensity curve, kept from forcing closed lips open, and brought
to rest in silence. The laws hold by construction: intensity 0 is the neutral reading, more is
more, lips that meet still meet. Letters: T frames, C controls.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.special import expit, logit

from rig import ControlSet
from rig.arrays import Bool, Float32

LEAST_PREDICTED = 0.15
"""Where the voice is fainter than this, an edited curve scales as if it were this strong."""
CONTACT_FROM, CONTACT_FULL = 0.25, 0.75
"""Neutral lips-together (or lip-bite) value at which protection begins, and is complete."""
STILL = 0.01
"""Openings below this are the network's murmur, not speech."""

DECIDED, DECISION = 0.25, 4.0
"""Height of a lips-together peak that becomes one half, and the factor on the distance from it, in
logits.

Chosen on validation speakers: on the average there are as many contacts as bilabials (1.00 times),
of which 87 % are reached and 95 % of those found held at 0.9 for two frames; 1.4 % of the vowels
shut the lips."""
SHOULDER, DOUBT, SHARPEST = 0.7, 0.4, 0.97
"""Share of a peak of 1 at which a frame beside it becomes one half, how much more as the peak goes
to 0, and at most: what is only suspected is brief, or it would reach into the vowels around."""
PEAK_FRAMES = 7
"""A frame belongs to the highest peak within three frames (0.1 s) of it."""

LIVELINESS_GAIN, USUAL = 0.45, 0.575
"""A livelier moment opens more, by this factor on the intensity above the usual one."""
EFFORT_GAIN = 0.3
"""A take of more vocal effort opens more by this share for a standard deviation: loud talkers lower
the jaw far more than the network, which hears all takes at one level, could know."""
LIVELY = ("jaw.ty", "upperLipRaise", "lowerLipDepress")

FASTEST_CONTACT = 0.4
"""Lips close and part by at most this a frame at 30 Hz, as fast as captured mouths move."""

OPENING = ("jaw.ty", "jaw_openExtreme", "upperLipRaise", "lowerLipDepress", "funnel", "lipsRoll",
           "lipsBlow", "suckBlow")  # fmt: skip
"""Parts of the names of controls that part the lips."""
SPEAKING = ("lipsTogether", "lipBite", "purse", "owards", "mouth_press", "tongue", "teeth", "icky",
            "lipsPress", "pushPull", "jaw_fwdBack")  # fmt: skip
"""Parts of the names of the other controls that speech moves."""


def _decided(values: Float32, middle: "Float32 | float") -> Float32:
    """S-curve from 0 to 1 that makes one half of `middle`."""
    return np.asarray(expit(DECISION * (logit(values) - logit(middle))), np.float32)


def expression_scale(applied: Float32, predicted: Float32) -> Float32:
    """Factor on the difference of the emotional and the neutral reading [shape=(T,)].

    Parameters
    ----------
    applied : array [shape=(T,), range 0 to 4]
        Intensity to show.
    predicted : array [shape=(T,), range 0 to 1]
        Intensity that the emotional reading holds.
    """
    return np.asarray(applied / np.maximum(predicted, LEAST_PREDICTED), np.float32)


@dataclass(frozen=True)
class Expression:
    """The rules of expression for one control set."""

    controls: ControlSet

    def blend(self, neutral: Float32, emotional: Float32, scale: Float32) -> Float32:
        """Scale the expression and keep contacts closed.

        Parameters
        ----------
        neutral, emotional : array [shape=(T, C)]
            Two readings of the same speech.
        scale : array [shape=(T,)]
            Factor on their difference, from `expression_scale`.

        Returns
        -------
        array [shape=(T, C)]
        """
        delta = emotional - neutral  # in place from here: an hour of it is 80 MB
        delta *= scale[:, None]
        free = 1 - self.contact(neutral)
        delta[:, self.opening] *= free[:, None]
        delta[:, self.seals] = np.maximum(delta[:, self.seals], 0)
        delta += neutral
        return delta

    def sharpen_contacts(self, curves: Float32) -> None:
        """Make contacts of what the network only believes, in place.

        A network trained on squared errors answers a doubtful /b/ with 0.5: lips that almost meet
        and say nothing. Two S-curves decide: how high a peak was meant to be, and which frames
        beside it belong to the contact. A lone peak of 0.2 becomes 0.24, 0.25 one half, and
        0.5 becomes 0.99; 0 and 1 stay, and between two peaks the lips part.

        Parameters
        ----------
        curves : ndarray [shape=(T, C)]
            A reading, as the network gave it, at 30 frames per second.
        """
        if not len(curves):
            return
        values = np.clip(curves[:, self.seals], 0, 1)
        peaks: Float32 = maximum_filter1d(values, PEAK_FRAMES, axis=0)
        shares = np.asarray(values / np.maximum(peaks, 1e-6), np.float32)
        shoulder = np.minimum(SHOULDER + DOUBT * (1 - peaks), SHARPEST)
        curves[:, self.seals] = _decided(peaks, DECIDED) * _decided(shares, shoulder)

    def scale_opening(
        self, curves: Float32, strength: Float32, heard: Float32, effort: float = 0.0
    ) -> None:
        """Open the mouth as far as the voice is lively, in place.

        The network opens it for the intensity it heard, by the law it was taught: 45 % more for
        one of intensity (`deitalk.corpus.rig_targets`). Where the voice is livelier than that by
        measurement, so is the mouth; closed lips stay closed.

        Parameters
        ----------
        curves : ndarray [shape=(T, C)]
            A reading, its contacts decided.
        strength, heard : ndarray [shape=(T,), range 0 to 1]
            Intensity of the voice, and what the network heard of it.
        effort : float
            Vocal effort of the whole take, standard deviations from the usual
            (`deitalk.postprocess.voice_intensity.vocal_effort_z`).
        """
        free = 1 - self.contact(curves)
        ratio = (1 + LIVELINESS_GAIN * (strength - USUAL)) / (1 + LIVELINESS_GAIN * (heard - USUAL))
        ratio *= 1 + EFFORT_GAIN * effort
        curves[:, self.lively] *= 1 + ((ratio - 1) * free)[:, None]

    def limit_contact_speed(self, curves: Float32) -> None:
        """Let lips start closing early and part late rather than jump, in place.

        Contacts keep their height; the frames around them are raised until no step of a
        lips-together or lip-bite control is larger than `FASTEST_CONTACT`.

        Parameters
        ----------
        curves : ndarray [shape=(T, C)]
            At 30 frames per second.
        """
        for place in self.seals:
            sharp = curves[:, place].copy()
            for frames in range(1, int(1 / FASTEST_CONTACT) + 1):
                reach = frames * FASTEST_CONTACT
                curves[frames:, place] = np.maximum(curves[frames:, place], sharp[:-frames] - reach)
                curves[:-frames, place] = np.maximum(
                    curves[:-frames, place], sharp[frames:] - reach
                )

    def contact(self, neutral: Float32) -> Float32:
        """How closed the lips are [shape=(T,), range 0 to 1]: lips together, or lip on teeth."""
        closed = np.maximum(
            neutral[:, self.together].mean(axis=1), neutral[:, self.bite].mean(axis=1)
        )
        share = np.clip((closed - CONTACT_FROM) / (CONTACT_FULL - CONTACT_FROM), 0, 1)
        smooth: Float32 = share * share * (3 - 2 * share)
        return smooth

    def rest_in_silence(self, curves: Float32, mouth: Float32, expression: Float32) -> None:
        """Bring curves to rest where nobody speaks, in place.

        Parameters
        ----------
        curves : ndarray [shape=(T, C)]
            Changed.
        mouth, expression : ndarray [shape=(T,), range 0 to 1]
            From `deitalk.postprocess.gates.mouth_gate` and `expression_gate`.
        """
        rest = self.controls.rest
        curves -= rest
        gate = np.where(self.follows_mouth, 1, 0).astype(np.float32)
        for start in range(0, len(curves), 4096):
            rows = slice(start, start + 4096)
            part = curves[rows]
            part *= expression[rows, None]
            part *= 1 - gate + gate * mouth[rows, None]
        curves += rest

    def apply_dead_zone(self, curves: Float32) -> None:
        """Remove the network's murmur from controls that part or move the lips, in place.

        Values below 0.01 go to 0; above, nothing but that is lost.
        """
        places = self.opening
        values = curves[:, places]
        curves[:, places] = np.sign(values) * np.maximum(np.abs(values) - STILL, 0)

    @cached_property
    def opening(self) -> NDArray[np.intp]:
        """Controls that part the lips."""
        return self._named(*OPENING)

    @cached_property
    def lively(self) -> NDArray[np.intp]:
        """Controls that open further in a lively voice; they rest at 0."""
        return self._named(*LIVELY)

    @cached_property
    def together(self) -> NDArray[np.intp]:
        """The four lips-together controls."""
        return self._named("lipsTogether")

    @cached_property
    def bite(self) -> NDArray[np.intp]:
        """The lower lip's bite."""
        return self._named("lipBiteD")

    @cached_property
    def seals(self) -> NDArray[np.intp]:
        """Controls that close the lips; an expression may add to them, never take away."""
        return np.concatenate((self.together, self.bite))

    @cached_property
    def follows_mouth(self) -> Bool:
        """Controls that rest as soon as the mouth does: they speak, or part the lips.

        What an expression alone moves (corners, brows, lids, cheeks) stays through pauses.
        """
        speaks = np.zeros(len(self.controls.names), bool)
        speaks[self.opening] = True
        speaks[self._named(*SPEAKING)] = True
        return speaks

    def _named(self, *parts: str) -> NDArray[np.intp]:
        names = self.controls.names
        return np.array([i for i, n in enumerate(names) if any(p in n for p in parts)], np.intp)
