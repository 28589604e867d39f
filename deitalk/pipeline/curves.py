"""The main path: speech and an emotion in, 185 curves out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from deitalk.audio.arrays import Audio, recording_of
from deitalk.audio.frames import FRAME_RATE
from deitalk.audio.load import Recording
from deitalk.config import Idle, RulesConfig
from deitalk.emotions import ActorReference, Direction, EmotionTrack, IntensityCurve
from deitalk.errors import AudioError, DeitalkError
from deitalk.models.network import CurveNetwork, Reading, chosen_actor, load_network
from deitalk.pipeline.arguments import LONGEST_LISTENING, check_progress, emotion_text, whole_seed
from deitalk.pipeline.performance import Performance
from deitalk.pipeline.speech import Intensities, Speech, measure_intensities
from deitalk.pipeline.words.transcript import LANGUAGE, Transcript
from deitalk.postprocess.curve_rules import Expression
from deitalk.postprocess.known_phones import KnownPhone, meet_phones
from deitalk.postprocess.life.amounts import Life
from deitalk.postprocess.life.motion import TakeMotion, plan_motion
from deitalk.postprocess.life.traits import Seeds, Traits
from deitalk.postprocess.life.voice import measure_voice
from rig import ControlSet, RigCurves
from rig.arrays import Float32
from rig.curves.edit import gain_factors, parse_gains
from rig.errors import quoted

if TYPE_CHECKING:
    from deitalk.pipeline.words.align import WordFit

CURVE_OVERHANG_SECONDS = 0.5  # by which an intensity curve may outlast the recording, without note


def animate(
    audio: Audio,
    emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
    *,
    sample_rate: float | None = None,
    model: str | Path | CurveNetwork = "default",
    backend: str = "torch",
    actor: str | None = None,
    intensity: float = 1.0,
    intensity_curve: str | Path | IntensityCurve | None = None,
    voice: str | Path | ActorReference | None = None,
    idle: bool = True,
    life: Life | Mapping[str, float] | str | None = None,
    look_at: tuple[float, float] | str = (0.0, 0.0),
    raw: bool = False,
    seed: int = 0,
    listen: float = 0.0,
    gain: str | Mapping[str, float] | None = None,
    transcript: str | Path | Transcript | None = None,
    phones: str | Path | Transcript | None = None,
    language: str = LANGUAGE,
    progress: Callable[[float], None] = lambda share: None,
) -> Performance:
    """Animate a face from speech.

    Parameters
    ----------
    audio : path, bytes, file object, Recording, array or tensor
        Any recording `deitalk.audio.load.load_audio` reads, or samples [shape=(S,) or (S, C)] with
        their `sample_rate` (see `deitalk.audio.arrays.recording_from_array`).
    emotion : str, mapping, Path or EmotionTrack
        A label (``"happy"``), weights (``"happy=0.7,surprised=0.3"``) or a keyframed track.
    sample_rate : float, optional
        Hz, of an array or a tensor; nothing else takes it.
    model : str, Path, DEITalk or OnnxNetwork
        Name of an embedded model, a model folder, an ``.onnx`` file, or a loaded model.
    backend : str
        ``torch``, or ``onnx`` for ONNX Runtime; see `deitalk.models.network.load_network`.
    actor : str, optional
        Whose style, of a model that was tuned on several actors; by default its first.
    intensity : float, range 0 to 4
        Factor on the intensity predicted from the voice; 0 gives the neutral reading.
    intensity_curve : path or IntensityCurve, optional
        Intensity to apply instead of the predicted one, as in a take's ``intensity.csv``.
    voice : path or ActorReference, optional
        Usual voice of the speaker (`deitalk actor build`), from which intensity counts.
    idle : bool
        Add blinks, gaze, brows and head on the voice, as the model's rules have them.
    life : str, mapping or Life, optional
        Factors on them, 0 (off) to 2: ``"brows=.8,head=1.2,blinks=1,gaze=.5"``.
    look_at : tuple of float or str
        Place of the listener: degrees to the character's left and up, -35 to 35.
    raw : bool
        The network alone, without the model's rules (`deitalk.config.RulesConfig`).
    seed : int
        Another drawing of the idle motion; each recording and each actor has its own already.
    listen : float, range 0 to 600
        Seconds of silence after the recording in which the face listens: its eyes and head live on.
    gain : str or mapping, optional
        Factors on how far controls or sets of controls go from rest: ``"jaw=1.2,brow=0.8"``; values
        stay within their ranges.
    transcript : str or Path, optional
        What is said, so that its closures, bites and rounding are met: text, a ``.txt``, a table
        ``.csv`` (start, end, word) or a ``.TextGrid``. Words that the sound contradicts are
        reported in ``performance.words`` and not used.
    phones : str or Path, optional
        The same as phones, ARPABET or IPA, which needs no espeak-ng.
    language : str
        Voice of espeak-ng that pronounces the words: ``en-us``, ``de``, ``cmn`` …
    progress : callable
        Called with the share of the network's work that is done, 0 to 1.

    Returns
    -------
    Performance

    Raises
    ------
    AudioError, EmotionError, CheckpointError, DataError, MissingError, CurveError, ControlError
        One line each: the value, the rule and the way out.
    """
    check_progress(progress)
    load = partial(load_network, model, backend=backend)
    shot = prepare(
        audio, emotion, load, sample_rate=sample_rate, actor=actor, intensity=intensity,
        intensity_curve=intensity_curve, voice=voice, idle=idle, life=life, look_at=look_at,
        raw=raw, seed=seed, listen=listen, gain=gain, transcript=transcript, phones=phones,
        language=language,
    )  # fmt: skip
    reading = shot.network.read(
        shot.speech.waveform, shot.weights, shot.actor, progress, shot.speech.gain
    )
    return finish(shot, reading, str(model) if isinstance(model, str | Path) else "")


@dataclass(frozen=True)
class Shot:
    """A recording and how it is to be acted, ready for the network."""

    network: CurveNetwork
    recording: Recording
    direction: Direction
    speech: Speech
    weights: Float32
    """Emotion of each frame [shape=(T, 5)]."""
    actor: str
    rules: RulesConfig
    idle: Idle | None
    """Motion above the mouth; None: there is none."""
    life: Life
    seed: int
    gain: Float32
    """Factor of each control [shape=(C,)]."""
    words: Transcript | None
    settings: Mapping[str, Any]
    """Arguments of `animate`, as a take stores them."""
    clock: "_Clock"


def prepare(
    audio: Audio,
    emotion: Any,
    load: Callable[[], CurveNetwork],
    *,
    sample_rate: float | None = None,
    actor: str | None = None,
    intensity: float = 1.0,
    intensity_curve: Any = None,
    voice: Any = None,
    idle: bool = True,
    life: Any = None,
    look_at: Any = (0.0, 0.0),
    raw: bool = False,
    seed: int = 0,
    listen: float = 0.0,
    gain: Any = None,
    transcript: Any = None,
    phones: Any = None,
    language: str = LANGUAGE,
) -> Shot:
    """Read and check what `animate` is given, and measure the speech.

    `load` returns the network, after the recording was read. Other arguments and errors are those
    of `animate`.
    """
    clock = _Clock()
    direction, seed = Direction.of(emotion, intensity, intensity_curve, voice), whole_seed(seed)
    life, gains = Life.of(life, look_at), parse_gains(gain)
    words = Transcript.given(transcript, phones, language)
    if raw and words is not None:
        raise DeitalkError("words belong to the rules, which raw leaves out; give one of the two")
    recording = _extended(_with_note_on(direction.curve, recording_of(audio, sample_rate)), listen)
    clock.lap("audio")
    network = load()
    clock.lap("model")
    factors = gain_factors(network.controls, gains)
    rules = RulesConfig.none() if raw else network.rules
    speech = Speech.of_recording(recording, rules.gates)
    weights = direction.emotion.at(speech.times)
    name = chosen_actor(network.actors, actor)
    moves = idle and (listen or speech.activity.any())
    others: dict[str, Any] = {
        "voice": _name(voice), "idle": idle, "raw": raw, "seed": seed, "actor": actor,
        "listen": listen, "words": words and words.source, "language": language,
    }  # fmt: skip
    settings = _settings(emotion, direction, intensity_curve, life, gain=gains, **others)
    motion = rules.idle if moves else None
    return Shot(
        network, recording, direction, speech, weights, name, rules, motion, life, seed, factors,
        words, settings, clock,
    )  # fmt: skip


def finish(
    shot: Shot, reading: Reading, model: str = "", words: "WordFit | None" = None
) -> Performance:
    """Apply the rules to what the network read.

    Parameters
    ----------
    shot, reading
        What was prepared, and read of it.
    model : str
        Its name or folder, for a take.
    words : WordFit, optional
        Times of the shot's words, if they are known already.
    """
    neutral, emotional, tracks = reading
    speech, rules, controls, clock = shot.speech, shot.rules, shot.network.controls, shot.clock
    intensities = measure_intensities(speech, tracks, shot.direction, rules.voice_intensity)
    clock.lap("network")
    expression = Expression(controls, rules)
    if words is None and shot.words is not None:
        words = _aligned(speech, shot.words)
    known = () if words is None else words.known
    values = _apply_rules(expression, neutral, emotional, shot.weights, intensities, speech, known)
    head = None
    if shot.idle is not None:
        shown = shot.weights * intensities.applied[:, None]
        seeds = Seeds.of(speech.waveform, shot.actor, shot.seed)
        actor = shot.direction.voice
        motion = _idle_motion(speech, shown, seeds, shot.idle, shot.life, actor)
        motion.move(values, neutral, controls)
        head = motion.head
    clipped = _clamp(values, controls)
    _clamp(neutral, controls)
    for curves in (values, neutral):
        _scale(curves, shot.gain, controls)
    clock.lap("expression")
    emotion, applied = shot.weights, intensities.applied
    return Performance(
        _curves(controls, values, emotion=emotion, intensity=applied, head=head),
        _curves(controls, neutral),
        intensities.saliency,
        intensities.predicted,
        _with_note_of(words, shot.recording),
        clipped,
        clock.laps,
        shot.settings,
        model,
        words,
    )


def _apply_rules(
    rules: Expression,
    neutral: Float32,
    emotional: Float32,
    weights: Float32,
    intensities: Intensities,
    speech: Speech,
    known: Sequence[KnownPhone] = (),
) -> Float32:
    """Apply the rules to both readings in place; return the blend of them [shape=(T, C)]."""
    for reading in (neutral,) if emotional is neutral else (neutral, emotional):
        rules.sharpen_contacts(reading)
        meet_phones(reading, rules, known)
        rules.scale_opening(reading, intensities.voice, intensities.network, intensities.take)
    out = None if emotional is neutral else emotional  # not needed any more
    values = rules.blend(neutral, emotional, intensities.scale, out)
    rules.widen_speech(values, neutral, weights, intensities.applied)
    for reading in (neutral, values):
        rules.limit_contact_speed(reading)
        rules.apply_dead_zone(reading)
        rules.rest_in_silence(reading, speech.mouth, speech.shown)
    return values


def _aligned(speech: Speech, words: Transcript) -> "WordFit":
    """Times of the words in the sound."""
    from deitalk.pipeline.words.align import align_words  # needs torch

    return align_words(speech, words)


def _idle_motion(
    speech: Speech,
    shown: Float32,
    seeds: Seeds,
    idle: Idle,
    life: Life,
    actor: ActorReference | None,
) -> TakeMotion:
    """Motion above the mouth for the emotion that is shown [shape=(T, 5)]."""
    voice = measure_voice(speech.activity, speech.prosody)
    traits = Traits(**actor.traits) if actor is not None and actor.traits else None
    return plan_motion(voice, shown, seeds, idle, life, traits)


def _settings(
    emotion: Any, direction: Direction, curve: Any, life: Life, **others: Any
) -> dict[str, Any]:
    """Arguments of `animate`, as a take stores them."""
    return {
        "emotion": emotion_text(emotion),
        "intensity": direction.intensity,
        "intensity_curve": _name(curve),
        "life": str(life),
        "look_at": list(life.look_at),
        **others,
    }


def _name(argument: Any) -> str | None:
    """Name of the file of an optional argument."""
    if argument is None:
        return None
    return Path(argument).name if isinstance(argument, str | Path) else "in memory"


def _curves(controls: ControlSet, values: Float32, **tracks: Float32 | None) -> RigCurves:
    values.setflags(write=False)  # not copied: an hour is 80 MB
    return RigCurves(
        values, controls.names, fps=float(FRAME_RATE), control_set=controls.id, **tracks
    )


def _with_note_on(curve: IntensityCurve | None, recording: Recording) -> Recording:
    """The recording, with a note if the intensity curve was made for a longer one."""
    if curve is None or curve.times[-1] <= recording.duration + CURVE_OVERHANG_SECONDS:
        return recording
    note = (
        f"the intensity curve lasts {curve.times[-1]:.1f} s, the recording "
        f"{recording.duration:.1f} s: what comes after is not used"
    )
    return replace(recording, warnings=(*recording.warnings, note))


def _with_note_of(words: "WordFit | None", recording: Recording) -> Recording:
    """The recording, with a note if the sound contradicts words."""
    if words is None or words.fits:
        return recording
    return replace(recording, warnings=(*recording.warnings, words.line))


def _extended(recording: Recording, seconds: Any) -> Recording:
    """The recording with so much silence after it."""
    is_number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    if not is_number or not 0 <= seconds <= LONGEST_LISTENING:
        raise AudioError(
            f"listen {quoted(seconds)} must be a number of seconds, 0 to {LONGEST_LISTENING:g}"
        )
    silence = np.zeros(round(seconds * recording.sample_rate), np.float32)
    if not len(silence):
        return recording
    return replace(recording, waveform=np.concatenate([recording.waveform, silence]))


def _scale(values: Float32, gain: Float32, controls: ControlSet) -> None:
    """Scale the distance of every control from rest within its range, in place."""
    places = np.flatnonzero(gain != 1)
    rest, low, high = (x[places] for x in (controls.rest, controls.minimum, controls.maximum))
    values[:, places] = np.clip(rest + (values[:, places] - rest) * gain[places], low, high)


def _clamp(values: Float32, controls: ControlSet) -> int:
    """Clamp to the controls' ranges in place; count the values that were more than 1 % outside."""
    low, high = controls.minimum, controls.maximum
    count = 0
    for start in range(0, len(values), 4096):
        rows = values[start : start + 4096]
        count += int(((rows < low - 0.01) | (rows > high + 0.01)).sum())
        np.clip(rows, low, high, out=rows)
    return count


class _Clock:
    """Seconds between laps."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = perf_counter()

    def lap(self, name: str) -> None:
        now = perf_counter()
        self.laps[name] = now - self._last
        self._last = now
