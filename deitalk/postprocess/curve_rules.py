"""Rules on the curves of two readings of one speech, neutral and emotional.

The difference of the readings is the expression; it is scaled by the intensity, does not part
closed lips, and goes to rest in silence. By construction, intensity 0 gives the neutral reading,
the expression grows with the intensity, and lips that meet in the neutral reading still meet.
Each rule has its numbers in `deitalk.config.rules`, and changes nothing where it is off.
"""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deitalk.config.rules import KeepContacts, RulesConfig
from deitalk.emotions import EMOTIONS, LABELS
from rig import ControlSet
from rig.arrays import AnyFloat, Bool, Float32
from rig.controls import DEFAULT_ID
from rig.curves.edit import gaussian_smooth, sliding_maximum
from rig.files.reading import rows_of

# Expressions after the network: what an emotion adds to the neutral reading, by a table.
#
# The network was taught poses of the five emotions; on renders they were too faint or ambiguous:
# anger with drowsy lids, joy without cheeks and teeth. ``expressions.csv`` has, by emotion and
# control, a gain on the network's difference of the readings and a pose in units of the control at
# intensity 1, with the action unit (Ekman, Friesen and Hager 2002). Both grow in proportion to the
# intensity. Sizes follow what acted faces do against the same actor's neutral face, and how raw
# controls move together in a MetaHuman take ("the take": the slope of one control on another).
#
# Moods are procedural: the network reads their mixture of the trained emotions
# (`rig.emotions.MOODS`) and the table adds the prototype of their action units; contempt is of one
# side.
#
# A smile yields to rounding: spread corners and a raised upper lip are muscles that act against
# those of /u/ and /o/.
#
# Letters: T frames, C controls, S styles, K controls of the table.


SPREADING = ("cornerPull", "CornerPull", "stretch", "dimple", "corner.", "upperLipRaise")
"""Parts of the names of the controls whose expression yields to rounding."""
ROUNDING = ("mouth_funnel", "mouth_purse")
ROUNDED = (0.15, 0.6)
"""Mean of purse, or of funnel, at which an expression begins to yield, and yields fully."""
YIELDED = 0.8
"""Share that is taken away by full rounding."""
PARTING = ("jaw.ty", "lowerLipDepress", "upperLipRaise")
"""Parts of the names of the controls whose poses yield to closed lips. Corners of a trained emotion
yield too; those of a mood, up to .8 of a range, would jump at every closure."""
YIELDING_STEP = 1 / 3
"""Share of a mood's pose that yields in a frame, 0.1 s in all: disgust raises the lip by .6."""


@dataclass(frozen=True)
class ExpressionTable:
    """Gains and poses of the emotions for the controls of one rig.

    Attributes
    ----------
    places : array [shape=(K,)]
        Columns of the controls.
    gains, poses, parting : array [shape=(S, K)]
        Factor on the difference of the readings, what is added to it at intensity 1, and what is
        added as far as the lips are open.
    spreading : array [shape=(K,), 0 or 1]
        Whether a control yields to rounding.
    rounding : array [shape=(2, 4)]
        Columns of funnel, and of purse.
    changed : array [shape=(S,), 0 or 1]
        0 of emotions that stay as captures show them.
    """

    places: NDArray[np.intp]
    gains: Float32
    poses: Float32
    parting: Float32
    spreading: Float32
    rounding: NDArray[np.intp]
    changed: Float32

    def add_to(
        self,
        curves: Float32,
        neutral: Float32,
        weights: Float32,
        strength: Float32,
        free: Float32,
        slow: Float32,
    ) -> None:
        """Change the expression, in place; nothing where there is none.

        Parameters
        ----------
        curves, neutral : array [shape=(T, C)]
            The blend of both readings, and the neutral one.
        weights : array [shape=(T, S)]
            Emotion of each frame.
        strength : array [shape=(T,), range 0 to 4]
            Intensity that the blend shows.
        free : array [shape=(T,), range 0 to 1]
            Share of the opening that closed lips leave to an expression.
        slow : array [shape=(T,), range 0 to 1]
            The same of the moods, which changes slowly and is never more.
        """
        if not len(self.places):
            return
        base = neutral[:, self.places]
        shown = (curves[:, self.places] - base) * (weights @ self.gains)
        own, moods = slice(len(EMOTIONS)), slice(len(EMOTIONS), None)
        pose = weights @ self.poses + (weights[:, own] @ self.parting[own]) * free[:, None]
        pose += (weights[:, moods] @ self.parting[moods]) * slow[:, None]
        shown += pose * strength[:, None]
        kept = 1 - YIELDED * self._rounded(neutral) * (weights @ self.changed)
        shown *= 1 - self.spreading + self.spreading * kept[:, None]
        curves[:, self.places] = base + shown

    def _rounded(self, neutral: Float32) -> Float32:
        """How rounded the lips are [shape=(T,), range 0 to 1]."""
        rounding = neutral[:, self.rounding].mean(axis=2).max(axis=1)
        begin, full = ROUNDED
        share = np.clip((rounding - begin) / (full - begin), 0, 1)
        smooth: Float32 = share * share * (3 - 2 * share)
        return smooth


@lru_cache(maxsize=8)
def expression_table(names: tuple[str, ...], captured: tuple[str, ...] = ()) -> ExpressionTable:
    """The table for the columns of a rig; controls that it lacks are left out.

    Emotions that captures show have a gain of 1 and no pose.
    """
    rows = [
        (LABELS.index(row["emotion"]), name, float(row["gain"]), float(row["pose"]))
        for row in rows_of(Path(__file__).with_name("expressions.csv"))
        for name in (row["control"].replace("*", side) for side in "LR")
        if name in names
    ]
    moved = sorted({name for _, name, _, _ in rows}, key=names.index)
    gains = np.ones((len(LABELS), len(moved)), np.float32)
    poses, parting = np.zeros_like(gains), np.zeros_like(gains)
    for emotion, name, gain, pose in rows:
        place = emotion, moved.index(name)
        yielding = PARTING + (SPREADING if LABELS[emotion] in EMOTIONS else ())
        gains[place] = gain
        (parting if any(part in name for part in yielding) else poses)[place] = pose
    changed = np.array([label not in captured for label in LABELS], np.float32)
    gains = 1 + changed[:, None] * (gains - 1)
    for table in (poses, parting):
        table *= changed[:, None]
    return ExpressionTable(
        np.array([names.index(name) for name in moved], np.intp),
        gains,
        poses,
        parting,
        np.array([any(part in name for part in SPREADING) for name in moved], np.float32),
        np.array([[i for i, name in enumerate(names) if part in name] for part in ROUNDING]),
        changed,
    )


LEAST_PREDICTED = 0.15
"""Lower bound of the predicted intensity that an applied one is divided by."""
PEAK_FRAMES = 7
"""A frame belongs to the highest peak within three frames (0.1 s) of it."""
LIVELY = ("jaw.ty", "upperLipRaise", "lowerLipDepress")

POSING = ("brow", "eye", "nose", "cornerPull", "cornerDepress", "stretch")
"""Parts of the names of the controls whose change is the size of a pose."""
AROUND_FRAMES = 30.0
"""Sigma of the speech around a frame in which it and the intensity are measured, 1 s."""
MOST_RESIZED = 2.0
"""Most by which the intensity that a pose holds and the predicted one differ, a factor."""

OPENING = ("jaw.ty", "jaw_openExtreme", "upperLipRaise", "lowerLipDepress", "funnel", "lipsRoll",
           "lipsBlow", "suckBlow")  # fmt: skip
"""Parts of the names of controls that part the lips."""
SPEAKING = ("lipsTogether", "lipBite", "purse", "owards", "mouth_press", "tongue", "teeth", "icky",
            "lipsPress", "pushPull", "jaw_fwdBack")  # fmt: skip
"""Parts of the names of the other controls that speech moves."""


def _decided(values: Float32, middle: "Float32 | float", steepness: float) -> Float32:
    """S-curve from 0 to 1 that makes one half of `middle`."""
    with np.errstate(divide="ignore", over="ignore"):  # 0 and 1 stay what they are
        odds = np.log(values / (1 - values)) - np.log(middle / (1 - middle))
        return np.asarray(1 / (1 + np.exp(-steepness * odds)), np.float32)


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


def mean_around(values: AnyFloat, speaking: Bool) -> Float32:
    """Mean of the frames of speech around each frame, over about 2 s [shape=(T,)]."""
    if not speaking.any():
        return np.asarray(values, np.float32)
    used = speaking.astype(np.float64)
    weight = gaussian_smooth(used, AROUND_FRAMES) + 1e-6
    total = gaussian_smooth(np.asarray(values * used), AROUND_FRAMES)
    return np.asarray((total + 1e-6 * values[speaking].mean()) / weight, np.float32)


@dataclass(frozen=True)
class Expression:
    """The rules of expression for one control set.

    Parameters
    ----------
    controls : ControlSet
        Columns of the curves.
    settings : RulesConfig
        Which rules apply, and their numbers.
    """

    controls: ControlSet
    settings: RulesConfig = field(default_factory=RulesConfig)

    def held_intensity(
        self,
        neutral: Float32,
        emotional: Float32,
        weights: Float32,
        speaking: Bool,
        network: Float32,
    ) -> Float32:
        """Intensity that the emotional reading holds [shape=(T,), range 0 to 2].

        The predicted one; with the rule `pose_size` the measured size of the pose, over about 2 s
        of speech and as far as one trained emotion is shown. The pose of anger grows less than
        the prediction: divided by it, a strong take would show less.

        Parameters
        ----------
        neutral, emotional : array [shape=(T, C)]
            Two readings of the same speech.
        weights : array [shape=(T, 5)]
            Trained emotions of each frame.
        speaking : array of bool [shape=(T,)]
            Frames of speech.
        network : array [shape=(T,), range 0 to 1]
            Predicted intensity.
        """
        rule = self.settings.pose_size
        if rule is None or not speaking.any():
            return network
        usual = np.array([getattr(rule, name, 0.0) for name in EMOTIONS])
        size = np.abs(emotional[:, self.posing] - neutral[:, self.posing]).sum(axis=1)
        change = mean_around(size, speaking) / np.maximum((weights @ usual) * network, 1e-6)
        pure = np.clip(2 * (weights * (usual > 0)).max(axis=1) - 1, 0, 1)
        return np.asarray(
            network * np.clip(change, 1 / MOST_RESIZED, MOST_RESIZED) ** pure, np.float32
        )

    def blend(
        self,
        neutral: Float32,
        emotional: Float32,
        scale: Float32,
        out: Float32 | None = None,
    ) -> Float32:
        """Scale the expression and keep contacts closed.

        Parameters
        ----------
        neutral, emotional : array [shape=(T, C)]
            Two readings of the same speech.
        scale : array [shape=(T,)]
            Factor on their difference, from `expression_scale`.
        out : array [shape=(T, C)], optional
            Where the result is written; `emotional` is possible.

        Returns
        -------
        array [shape=(T, C)]
        """
        delta = np.subtract(emotional, neutral, out=out)  # in place: an hour of it is 80 MB
        delta *= scale[:, None]
        if self.settings.keep_contacts is not None:
            free = 1 - self.contact(neutral)
            delta[:, self.opening] *= free[:, None]
            delta[:, self.seals] = np.maximum(delta[:, self.seals], 0)
        delta += neutral
        return delta

    def express(
        self,
        curves: Float32,
        neutral: Float32,
        weights: Float32,
        scale: Float32,
        network: Float32,
        closing: Float32 | None = None,
    ) -> None:
        """Change the expression by the table of `deitalk.postprocess.curve_rules`, in place.

        Parameters
        ----------
        curves, neutral : array [shape=(T, C)]
            The blend of both readings, and the neutral one.
        weights : array [shape=(T, 9)]
            Emotion of each frame.
        scale : array [shape=(T,)]
            Factor on the difference of the readings.
        network : array [shape=(T,), range 0 to 1]
            Intensity that the emotional reading holds.
        closing : array [shape=(T,), range 0 to 1], optional
            From `closing`; by default of `neutral`, whose frames then follow one another.
        """
        if (rule := self.settings.expressions) is not None:
            strength = scale * np.maximum(network, LEAST_PREDICTED)
            if closing is None:
                closing = self.closing(neutral[:, self.seals])
            table, free = (
                expression_table(self.controls.names, rule.captured),
                1 - self.contact(neutral),
            )
            table.add_to(curves, neutral, weights, strength, free, 1 - closing)

    def rest_lips(self, curves: Float32, neutral: Float32) -> None:
        """Cover the teeth of the neutral reading, in place; the expression stays.

        Parameters
        ----------
        curves, neutral : array [shape=(T, C)]
            The blend of both readings, and the neutral one: both change by as much.
        """
        rule = self.settings.expressions
        if rule is None or not rule.covers_teeth or not len(self.lips):
            return
        jaw, upper, lower = self.lips[0], self.lips[1:3], self.lips[3:]
        raised = np.minimum(neutral[:, upper], 2 * rule.upper)
        above = neutral[:, lower] - rule.lower - rule.per_jaw * neutral[:, [jaw]]
        for reading in (curves, neutral):
            reading[:, upper] -= raised * (1 - raised / (4 * rule.upper))
            reading[:, lower] -= rule.share * np.maximum(above, 0)

    def sharpen_contacts(self, curves: Float32) -> None:
        """Raise likely contacts and lower unlikely ones, in place.

        A network trained on squared errors gives an uncertain /b/ as 0.5: lips that almost meet.
        Two S-curves decide how high a peak is, and which frames beside it belong to the contact.
        A lone peak of 0.2 becomes 0.24, 0.25 one half, and 0.5 becomes 0.99; 0 and 1 stay, and
        between two peaks the lips part. With the numbers of `SharpenContacts`, chosen on validation
        speakers with former weights, there were then on the average as many contacts as bilabials
        (1.00 times), of which 87 % were reached and 95 % of those found held at 0.9 for two frames;
        1.4 % of the vowels shut the lips. An uncertain contact is brief, or it would reach into the
        vowels around.

        Parameters
        ----------
        curves : array [shape=(T, C)]
            A reading as the network predicts it, 30 frames per second.
        """
        curves[:, self.seals] = self.sharpened(curves[:, self.seals])

    def sharpened(self, contacts: Float32) -> Float32:
        """Contacts as `sharpen_contacts` raises and lowers them [shape=(T, ...)]."""
        rule = self.settings.sharpen_contacts
        if rule is None or not contacts.size:
            return contacts
        values = np.clip(contacts, 0, 1)
        peaks: Float32 = sliding_maximum(values, PEAK_FRAMES)
        shares = np.asarray(values / np.maximum(peaks, 1e-6), np.float32)
        shoulder = np.minimum(rule.shoulder + rule.doubt * (1 - peaks), rule.sharpest)
        heights = _decided(peaks, rule.peak, rule.steepness)
        return np.asarray(heights * _decided(shares, shoulder, rule.steepness), np.float32)

    def opening_factor(self, voice: Float32, network: Float32, take: float = 0.0) -> Float32:
        """Factor on the opening of the mouth for the corrected intensity of the voice [shape=(T,)].

        The network opens it for the intensity that it predicts, by the law of its training data:
        45 % more per unit of intensity (`deitalk.research.corpus.rig_targets`). The factor is that
        law at the corrected intensity over that at the predicted one. Loud talkers lower the jaw
        further, which a network with all takes at one level cannot predict: hence `take`.

        Parameters
        ----------
        voice, network : array [shape=(T,), range 0 to 1]
            Corrected intensity, and the one that the network predicts, each as its mean over the
            speech around a frame; the reading itself has the faster variation.
        take : float
            Strength of the whole take, standard deviations above the usual
            (`deitalk.postprocess.voice_intensity.take_z`).
        """
        rule = self.settings.scale_opening
        if rule is None:
            return np.ones(len(voice), np.float32)
        ratio = (1 + rule.gain * (voice - rule.usual)) / (1 + rule.gain * (network - rule.usual))
        return np.asarray(ratio * max(0.0, 1 + rule.take * take), np.float32)

    def scale_opening(self, curves: Float32, factor: Float32) -> None:
        """Open the mouth by a factor [shape=(T,)] where lips do not meet, in place.

        Parameters
        ----------
        curves : array [shape=(T, C)]
            A reading after `sharpen_contacts`.
        factor : array [shape=(T,)]
            From `opening_factor`.
        """
        if self.settings.scale_opening is not None:
            free = 1 - self.contact(curves)
            curves[:, self.lively] *= 1 + ((factor - 1) * free)[:, None]

    def limit_contact_speed(self, curves: Float32) -> None:
        """Limit the speed of contacts, in place: lips start closing earlier and part later.

        Contacts keep their height; the frames around them are raised until no step of a
        lips-together or lip-bite control is larger than that of `LimitContactSpeed`.

        Parameters
        ----------
        curves : array [shape=(T, C)]
            30 frames per second.
        """
        curves[:, self.seals] = self.limited(curves[:, self.seals])

    def limited(self, contacts: Float32) -> Float32:
        """Contacts as `limit_contact_speed` raises them [shape=(T, ...)]; a copy."""
        rule = self.settings.limit_contact_speed
        return contacts.copy() if rule is None else _raised(contacts, rule.step)

    def closing(self, seals: Float32) -> Float32:
        """How closed lips are [shape=(T, ...)] that start closing earlier and part later.

        Parameters
        ----------
        seals : array [shape=(T, ..., K)]
            The controls `seals` of frames that follow one another.
        """
        return _raised(self._closed(seals), YIELDING_STEP)

    def contact(self, neutral: Float32) -> Float32:
        """How closed the lips are [shape=(T,), range 0 to 1]: lips together, or lip on teeth."""
        return self._closed(neutral[:, self.seals])

    def _closed(self, seals: Float32) -> Float32:
        """The same of `seals` [shape=(..., K)]."""
        if not len(self.seals):
            return np.zeros(seals.shape[:-1], np.float32)
        together, bite = np.split(seals, [len(self.together)], axis=-1)
        closed = np.maximum(together.mean(axis=-1), bite.mean(axis=-1))
        rule = self.settings.keep_contacts or KeepContacts()
        share = np.clip((closed - rule.begin) / (rule.full - rule.begin), 0, 1)
        smooth: Float32 = share * share * (3 - 2 * share)
        return smooth

    def rest_in_silence(self, curves: Float32, mouth: Float32, expression: Float32) -> None:
        """Bring curves to rest in silence, in place.

        Parameters
        ----------
        curves : array [shape=(T, C)]
            Changed.
        mouth, expression : array [shape=(T,), range 0 to 1]
            From `deitalk.postprocess.voice_intensity.mouth_gate` and `expression_gate`.
        """
        if self.settings.gates is None:
            return
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
        """Set small values of the controls that part the lips to 0, in place.

        Magnitudes below the width (0.01) become 0; larger ones are reduced by it.
        """
        rule, places = self.settings.dead_zone, self.opening
        if rule is None:
            return
        values = curves[:, places]
        curves[:, places] = np.sign(values) * np.maximum(np.abs(values) - rule.width, 0)

    @cached_property
    def opening(self) -> NDArray[np.intp]:
        """Controls that part the lips."""
        return self._named(*OPENING)

    @cached_property
    def lively(self) -> NDArray[np.intp]:
        """Controls that `scale_opening` scales; they rest at 0."""
        return self._named(*LIVELY)

    @cached_property
    def posing(self) -> NDArray[np.intp]:
        """Controls whose change is the size of a pose."""
        return self._named(*POSING)

    @cached_property
    def lips(self) -> NDArray[np.intp]:
        """The jaw, the raises of the upper lip and the depressions of the lower one; or none."""
        places = np.concatenate([self._named(part) for part in LIVELY])
        return places if len(places) == 5 else places[:0]

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
        """Controls that close the lips; an expression may increase them only."""
        return np.concatenate((self.together, self.bite))

    @cached_property
    def follows_mouth(self) -> Bool:
        """Controls that the mouth gate brings to rest: those of speech and of parted lips.

        Controls of the expression alone (corners, brows, lids, cheeks) stay through pauses. Of a
        rig other than the board, those of its lip set follow it.
        """
        speaks = np.zeros(len(self.controls.names), bool)
        if self.controls.id != DEFAULT_ID:
            speaks[self.controls.subset("lip")] = True
            return speaks
        speaks[self.opening] = True
        speaks[self._named(*SPEAKING)] = True
        return speaks

    def _named(self, *parts: str) -> NDArray[np.intp]:
        return _places(self.controls.names, parts)


def _raised(values: Float32, step: float) -> Float32:
    """Values by frame [shape=(T, ...)], raised until none differs from the next by over `step`."""
    slow = values.copy()
    for frames in range(1, int(1 / step) + 1):
        lower = values - np.float32(frames * step)
        slow[frames:] = np.maximum(slow[frames:], lower[:-frames])
        slow[:-frames] = np.maximum(slow[:-frames], lower[frames:])
    return slow


@lru_cache(maxsize=64)
def _places(names: tuple[str, ...], parts: tuple[str, ...]) -> NDArray[np.intp]:
    """Places of the names that hold one of some parts; not to be changed."""
    places = np.array([i for i, n in enumerate(names) if any(p in n for p in parts)], np.intp)
    places.setflags(write=False)
    return places
