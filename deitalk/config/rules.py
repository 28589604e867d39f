"""Settings of the rules after the network: a model's own, in its ``config.yaml``.

Each rule is a section with its numbers, or null where it is off. The defaults were chosen for
models that are trained on targets of phones; what an actor did should not be changed, so that a
fine-tuned model has those rules of its base whose work its captures do not show
(`RulesConfig.taught`).
"""

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from deitalk.config.section import Inner, Section, Share, Weight, checked
from deitalk.errors import ConfigError
from rig import limits

Emotion = Literal["neutral", "angry", "happy", "sad", "surprised"]
Slope = Annotated[float, Field(ge=0, le=10)]
Size = Annotated[float, Field(gt=0, le=100)]
Frames = Annotated[int, Field(ge=0, le=limits.TRAINING_FRAMES)]


class VoiceIntensity(Section):
    """Intensity is that of the voice: `deitalk.postprocess.feeling`; off: the network's own."""

    per_decibel: Slope = 0.1
    """State of feeling per decibel of the voice's strength, in the logarithm of odds."""
    middle: float = Field(default=0.5, ge=-100, le=100)
    """Strength whose intensity is half of the most, dB above the usual."""
    display: Slope = 0.3
    """Display of the changes within a phrase, per standard deviation of liveliness."""


class HoldPose(Section):
    """The mouth keeps its pose while a sound is held: a vowel, singing, a hum."""

    steady_db: Size = 2.5
    """Most mean difference of the spectrum's bands from those 0.27 s before, dB."""
    frames: Annotated[int, Field(ge=1, le=13)] = 12
    """Frames that a sound is steady before the pose is kept, after the first 0.33 s; with fewer,
    nasals and glides of slow speech are held."""
    leaves: Annotated[int, Field(ge=1, le=5)] = 5
    """Frames after the sound in which the pose is left."""


class SharpenContacts(Section):
    """Likely lip contacts are raised, and unlikely ones lowered, by the means of two frames."""

    peak: Inner = 0.25
    """Height of a peak that becomes one half."""
    height: Size = 4.0
    """Factor on the distance from it, in logits: how suddenly peaks become contacts."""
    steepness: Size = 4.0
    """Factor on the distance of the means beside a peak."""
    tail: Share = 0.0
    """Share of an S-curve of `deitalk.postprocess.curve_stages.GENTLE` in both: contacts that are
    certain stay higher than those that are likely."""
    shoulder: Inner = 0.7
    """Share of a peak of 1 at which a mean beside it becomes one half."""
    doubt: Share = 0.4
    """How much more as the peak goes to 0."""
    sharpest: Inner = 0.97
    """Shoulder at most."""


class ScaleOpening(Section):
    """The mouth opens further for a strong voice; for a weak one as for the usual.

    Intense anger and joy of actors widen the range of the lips to 1.41 and 1.32 times that of their
    neutral take (a measurement of video that is not repeated here). In proportion to the intensity,
    weak readings would be mumbled, and strong over neutral takes differ twice as much in one corpus
    of actors as in another, by the strength of their neutral takes.

    An emotion opens the mouth further where it is strong, and less where it is weak. Readings open
    no further in a shout, and over two takes of an actor differ by .16 and .30 in two corpora
    (standard deviation of the logarithm of the range), which is more than the factor of the voice.
    """

    gain: Slope = 1.8
    """Increase of the opening per unit of intensity above the usual."""
    usual: Share = 0.77
    """Intensity from which the opening increases: between the normal and the strong takes of two
    corpora of actors."""
    shown: Slope = 0.3
    """Increase of the opening per unit of an emotion's intensity in the voice above `middle`,
    decrease per unit below it, where an intensity of 1 or more is shown; in proportion under 1."""
    middle: float = Field(default=1.07, ge=0, le=4)
    """Intensity of an emotion in the voice that leaves the opening as it is."""


class KeepContacts(Section):
    """An expression does not part lips that are closed in the neutral reading."""

    begin: Share = 0.25
    """Contact from which it is kept in part."""
    full: Share = 0.75
    """Contact that is kept in full."""


class Expressions(Section):
    """The expression is changed by the table ``deitalk/postprocess/expressions.csv``.

    The neutral reading bares no teeth. In four real Live Link takes, 260 s of one person, ARKit's
    mouthUpperUp was .02 to .05 at any jawOpen; the median of mouthLowerDown was .06 at a jawOpen of
    .02 to .08, .15 up to .15, .26 up to .25 and .39 up to .4. The numbers are smaller changes than
    these, with which the range of the lips stays that of two measured speakers.
    """

    upper: Inner = 0.1
    """Value by which the upper lip is lowered."""
    lower: Share = 0.05
    """Lower lip's depression that is kept, jaw shut."""
    per_jaw: Slope = 1.1
    """More of it per opening of the jaw."""
    share: Share = 0.6
    """Share of what is above it that is taken away."""
    covers_teeth: bool = True
    """Whether the lips of the neutral reading are lowered so; captures of lips show their own."""
    size: Weight = 1.0
    """Size of the poses of the other emotions over those that networks are taught."""
    captured: tuple[Emotion, ...] = ()
    """Emotions that captures show, which the table leaves as they are."""


class LimitContactSpeed(Section):
    """Lips start to close earlier and part later; the tongue comes out and goes back gradually."""

    step: float = Field(default=0.5, ge=0.02, le=1)
    """Largest step of a contact in a frame, at 30 Hz."""
    tongue: float = Field(default=0.15, ge=0.02, le=1)
    """The same of a tongue that comes out."""


class DeadZone(Section):
    """Small values of the controls that part the lips become 0."""

    width: Share = 0.01
    """Values below it are noise of the network."""


class Gates(Section):
    """Rule for silence: the mouth shuts, and the expression decays to a share that stays."""

    mouth_opens: Frames = 5
    """Frames before speech."""
    mouth_closes: Frames = 10
    """Frames after speech."""
    feeling_rises: Annotated[int, Field(ge=1, le=limits.TRAINING_FRAMES)] = 15
    """Frames before speech in which the expression rises."""
    feeling_decays: Annotated[int, Field(ge=1, le=limits.TRAINING_FRAMES)] = 75
    """Time constant of its decay after speech, frames."""
    feeling_leaves: Frames = 600
    """Frames from any speech beyond which the share that stays goes, over two time constants."""


Factor = Annotated[float, Field(ge=0, le=2)]


class Idle(Section):
    """Blinks, gaze, brows and head on the voice, from a seed; off: the model's own, from captures.

    The factors are those of `deitalk.animate`'s ``life``, which multiplies them.
    """

    interval_seconds: float = Field(default=3.2, ge=0.6, le=3600)
    """Median interval between blinks."""
    interval_spread: float = Field(default=0.55, ge=0, le=3)
    """Sigma of its logarithm."""
    blinks: Factor = 1.0
    """More or fewer; 0: none."""
    gaze: Factor = 1.0
    """Width of fixations and aversions."""
    brows: Factor = 1.0
    """Size of accents of brows, lids and cheeks."""
    head: Factor = 1.0
    """Size of the motion of the head, a track of its own, and of the neck."""


class RulesConfig(Section):
    """Rules on the curves of a model, in the order in which they apply."""

    voice_intensity: VoiceIntensity | None = VoiceIntensity()
    hold_pose: HoldPose | None = HoldPose()
    sharpen_contacts: SharpenContacts | None = SharpenContacts()
    scale_opening: ScaleOpening | None = ScaleOpening()
    keep_contacts: KeepContacts | None = KeepContacts()
    expressions: Expressions | None = Expressions()
    limit_contact_speed: LimitContactSpeed | None = LimitContactSpeed()
    dead_zone: DeadZone | None = DeadZone()
    gates: Gates | None = Gates()
    idle: Idle | None = Idle()

    @classmethod
    def none(cls) -> "RulesConfig":
        """Turn every rule off: the network alone."""
        return cls(**dict.fromkeys(cls.model_fields))

    @classmethod
    def for_captures(cls) -> "RulesConfig":
        """Held poses, gates and idle motion, which no capture shows, with the brows of an actor."""
        own = {"hold_pose": HoldPose(), "gates": Gates(), "idle": Idle(brows=0)}
        return cls.none().model_copy(update=own)

    def taught(
        self, base: "RulesConfig", emotions: Collection[str], *, lips: bool, other_rig: bool
    ) -> "RulesConfig":
        """These rules, and those of a base whose work captures do not show.

        Parameters
        ----------
        base : RulesConfig
            Of the model that is tuned.
        emotions : collection of str
            Captured ones, whose expression is the actor's.
        lips : bool
            Whether captures show how the jaw or the lips open.
        other_rig : bool
            Whether the controls are not those of the base, by whose names its rules act.
        """
        names = {"voice_intensity", "hold_pose"}
        if not other_rig:
            names |= {"sharpen_contacts", "keep_contacts", "limit_contact_speed"}
            names |= {"expressions"}
            names |= set() if lips else {"scale_opening", "dead_zone"}
        held = {name: getattr(self, name) or getattr(base, name) for name in names}
        shown = set(emotions) - {"neutral"}
        if (table := held.get("expressions")) is not None and (shown or lips):
            captured = tuple(sorted({*table.captured, *shown}))
            covers = table.covers_teeth and not lips
            held["expressions"] = table.model_copy(
                update={"captured": captured, "covers_teeth": covers}
            )
        return self.model_copy(update=held)


def read_rules(path: Path) -> RulesConfig | None:
    """Rules of a model's ``config.yaml``, whose other settings are not read; None of a mesh model.

    Raises
    ------
    ConfigError
        If the file cannot be read, is no mapping, or a rule has an unknown key or a bad value.
    """
    from deitalk.config.yaml_files import read_yaml

    tree = read_yaml(path) or {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: holds a {type(tree).__name__}; a configuration is a mapping")
    if tree.get("kind") == "sdfa":
        return None
    return checked(RulesConfig, tree.get("rules", {}), path)
