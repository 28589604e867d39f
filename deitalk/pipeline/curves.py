"""The main path: speech and an emotion in, 185 curves out.

::

    prepare        recording, acting, network              -> Prepared
    Prepared.read  the network                             -> Reading
    finish         intensity, words, held sounds, traits   -> Measured   (_measured)
                   motion, drawn; the rules, block by block              (_ruled, apply_rules)
                   breaths, takes beside, edits            -> Performance (_performance)

The rules themselves are `deitalk.postprocess.curve_pass.CurvePass.forward`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deitalk.acting import Acting, acted_as
from deitalk.acting_fields import AUTO
from deitalk.audio.arrays import Audio, recording_of
from deitalk.audio.choice import AudioChoice
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count
from deitalk.audio.load import Recording
from deitalk.config.rules import RulesConfig
from deitalk.emotions import EmotionTrack, IntensityCurve
from deitalk.errors import AudioError, DeitalkError, MissingError
from deitalk.models.load import load_network
from deitalk.models.protocol import (
    CurveNetwork,
    CurveRules,
    Reading,
    chosen_actor,
    mean_actor_note,
    trained_weights,
    unshown_note,
)
from deitalk.pipeline.layers import edited
from deitalk.pipeline.performance import Performance
from deitalk.pipeline.speech import Intensities, Speech, measure_intensities
from deitalk.pipeline.words.marks import TimedMark, levels, with_accents, with_emotions
from deitalk.postprocess.factors import held_intensity, mean_around, opening_factor
from deitalk.postprocess.feeling import state_of_intensity
from deitalk.postprocess.joins import activity_beside, lead, unknown_controls
from deitalk.postprocess.known_phones import phone_tracks
from deitalk.postprocess.life.breath import draw_breaths
from deitalk.postprocess.life.character import Seeds, Traits
from deitalk.postprocess.life.motion import Character, Motion, Moved, plan_motions
from deitalk.postprocess.life.other import OtherVoice
from deitalk.postprocess.life.voice import measure_voice
from deitalk.postprocess.tracks import VoiceTracks, shown_columns
from deitalk.postprocess.variants import (
    choose_ways,
    habit_factors,
    show_habits,
    unused_variants,
)
from rig import ControlSet, RigCurves
from rig.arrays import Float32
from rig.curves.apply_layers import target_columns
from rig.curves.edit import gain_factors
from rig.errors import quoted

if TYPE_CHECKING:
    from deitalk.models.checkpoint import Model
    from deitalk.pipeline.words.align import WordFit
    from deitalk.pipeline.words.script import Script
    from deitalk.pipeline.words.transcript import Transcript

READ_ON_SAMPLES = SAMPLE_RATE // 2
FADE_SECONDS = 0.005
"""Half of the time over which the sound of others fades."""
BLOCK_FRAMES = 1024
"""Frames of a recording that pass the rules at once."""
CURVE_OVERHANG_SECONDS = 0.5  # by which an intensity curve may outlast the recording, without note


def animate(
    audio: Audio,
    emotion: str | Path | Mapping[str, float] | EmotionTrack = "neutral",
    *,
    acting: Acting | None = None,
    model: "str | Path | CurveNetwork | Model" = "default",
    backend: str = "auto",
    device: str = "cpu",
    sample_rate: float | None = None,
    track: int | None = None,
    channel: str | int | None = None,
    raw: str | None = None,
    progress: Callable[[float], None] = lambda share: None,
    **fields: Any,
) -> Performance:
    """Animate a face from speech.

    Parameters
    ----------
    audio : path, bytes, file object, Recording, array or tensor
        Any recording `deitalk.audio.load.load_audio` reads, or samples [shape=(S,) or (S, C)] with
        their `sample_rate` (see `deitalk.audio.arrays.recording_from_array`).
    emotion : str, mapping, Path or EmotionTrack
        A label (``"happy"``), weights (``"happy=0.7,surprised=0.3"``), a keyframed track, or
        ``"auto"``: the one that the voice suggests.
    acting : Acting, optional
        How the recording is acted; `emotion` and `fields` replace its own.
    model : str, Path, DEITalk or OnnxNetwork
        Name of an embedded model, a model folder, or a loaded model.
    backend : str
        ``auto``, ``torch`` or ``onnx``; see `deitalk.models.load.load_network`.
    device : str
        ``cpu``, ``cuda``, ``cuda:N`` or ``mps``; for a model given by name or folder.
    sample_rate : float, optional
        Hz, of an array or a tensor; nothing else takes it.
    track, channel, raw
        Which signal of the recording, as for `deitalk.load_audio`.
    progress : callable
        Called with the share of the network's work that is done, 0 to 1.
    **fields
        Of `deitalk.acting.Acting`: intensity, intensity_curve, rest, voice, style, words, script,
        role, language, life, variant, look_at, gain, edit, listen, after, into, rules, seed.

    Returns
    -------
    Performance

    Raises
    ------
    AudioError, EmotionError, CheckpointError, DataError, MissingError, CurveError, ControlError
        One line each: the value, the rule and the way out.
    """
    check_progress(progress)
    acted = acted_as(emotion, acting, fields, animate)
    load = partial(load_network, model, backend=backend, device=device, once=True)
    choice = AudioChoice.of(track, channel, raw)
    prepared = prepare(audio, acted, load, sample_rate=sample_rate, choice=choice)
    name = str(model) if isinstance(model, str | Path) else ""
    return finish(prepared, prepared.read(progress), name)


def check_progress(progress: Any) -> None:
    """Refuse a progress that cannot be called."""
    if not callable(progress):
        raise DeitalkError(
            f"progress {quoted(progress)} must be a function of one number, the share done"
        )


@dataclass(frozen=True)
class Prepared:
    """A recording and its acting, ready for the network."""

    network: CurveNetwork
    recording: Recording
    acting: Acting
    """Acting with the emotion that the voice suggests in place of ``auto``."""
    speech: Speech
    weights: Float32
    """Emotion of each frame [shape=(T, 9)]."""
    style: str
    rules: RulesConfig
    gain: Float32
    """Factor of each control [shape=(C,)]."""
    words: "Transcript | None"
    clock: "_Clock"
    suggestion: Mapping[str, float] | None = None
    said: "WordFit | None" = None
    """Times of the words of a script."""
    marks: "tuple[TimedMark, ...]" = ()
    """What the script says of them."""

    @cached_property
    def inputs(self) -> tuple[Float32, Float32]:
        """Sound [shape=(S,)] and weights of the trained emotions [shape=(T, 5)] for the network.

        Of a recording that is cut in its speech `READ_ON_SAMPLES` more, which are its last ones
        backwards: a network's emotion fades before the end of its input.
        """
        sound, weights = self.speech.waveform, trained_weights(self.weights)
        if self.speech.is_cut:
            sound = np.concatenate((sound, sound[: -1 - READ_ON_SAMPLES : -1]))
            more = frame_count(len(sound)) - len(weights)
            weights = np.pad(weights, ((0, more), (0, 0)), mode="edge")
        return sound, weights

    def read(self, progress: Callable[[float], None] = lambda share: None) -> Reading:
        """What the network reads, on beyond the end of a cut recording."""
        return self.network.read(*self.inputs, self.style, progress, self.speech.gain)


def prepare(
    audio: Audio,
    acting: Acting,
    load: Callable[[], CurveNetwork],
    *,
    sample_rate: float | None = None,
    choice: AudioChoice = AudioChoice(),
) -> Prepared:
    """Read and check what `animate` is given, and measure the speech.

    `load` returns the network, after the recording was read. Errors are those of `animate`.
    """
    clock = _Clock()
    words, script = read_words(acting)
    recording = recording_of(audio, sample_rate, choice)
    recording = _of_role(recording, acting)
    recording = _with_note_on("intensity curve", acting.intensity_curve, recording)
    suggestion = None
    if acting.emotion == AUTO:
        acting, recording, suggestion = _suggested(acting, recording)
    recording = _with_note_on("emotion", acting.emotion_track, recording)
    recording = _extended(recording, acting.listen)
    if acting.listen_to is not None:
        recording = _extended(recording, acting.listen_to.seconds - recording.duration)
        acting, recording = _felt(acting, acting.listen_to, recording)
    clock.lap("audio")
    network = load()
    clock.lap("model")
    factors = gain_factors(network.controls, acting.gain)
    for target in dict.fromkeys(edit.target for layer in acting.edit for edit in layer.edits):
        target_columns(network.controls, target)
    rules = network.rules if acting.rules else RulesConfig.none()
    recording = recording.noted(*_notes_on_unused(acting, rules))
    before = activity_beside(acting.after, before=True)
    after = activity_beside(acting.into, before=False)
    speech = Speech.of_recording(recording, rules.gates)
    speech = replace(speech, before=before, after=after)
    if acting.after is not None:
        recording = recording.noted(*unknown_controls(acting.after, network.controls))
    weights, said = acting.emotion_track.at(speech.times), None
    marks: tuple[TimedMark, ...] = ()
    if script is not None:
        from deitalk.pipeline.words.align import align_words

        said = align_words(speech, script.transcript)
        marks = script.timed(said, recording.duration)
        weights = with_emotions(weights, marks, speech.times)
        lost = ("its tags are not used: they have no times",) if script.marks and not marks else ()
        recording = recording.noted(*script.notes(), *lost)
    style = chosen_actor(network.actors, acting.style)
    unshown = unshown_note(network.emotions, trained_weights(weights))
    recording = recording.noted(*mean_actor_note(network.actors, style), *unshown)
    return Prepared(
        network, recording, acting, speech, weights, style, rules, factors, words, clock,
        suggestion, said, marks,
    )  # fmt: skip


def read_words(acting: Acting) -> "tuple[Transcript | None, Script | None]":
    """The words of an acting, or its script."""
    if (acting.words or acting.script) and not acting.rules:
        raise DeitalkError("words belong to the rules, which are off; give one of the two")
    if acting.words and acting.script:
        raise DeitalkError("a script has its words; give words or script, not both")
    if acting.script:
        from deitalk.pipeline.words.script import Script

        script = Script.of(acting.script, acting.language, acting.role)
        return script.transcript, script
    if acting.words is None:
        return None, None
    from deitalk.pipeline.words.transcript import Transcript

    return Transcript.of(acting.words, acting.language, acting.role), None


def _of_role(recording: Recording, acting: Acting) -> Recording:
    """The recording, silent where others than the role speak."""
    given = acting.script or acting.words
    if acting.role is None:
        return recording
    if given is None:
        raise DeitalkError(
            f"role {quoted(acting.role)} needs lines with times; give words or a script as .srt "
            "or .vtt"
        )
    from deitalk.pipeline.words.subtitles import other_spans

    spans = other_spans(given, given.source or "the subtitles", acting.role)
    if not spans:
        return recording
    heard = np.ones(len(recording.waveform), np.float32)
    fade = round(FADE_SECONDS * recording.sample_rate)
    for begin, end in spans:
        first, stop = (round(seconds * recording.sample_rate) for seconds in (begin, end))
        heard[max(first, 0) : max(stop, 0)] = 0
    kernel = np.full(2 * fade + 1, 1 / (2 * fade + 1), np.float32)
    share = np.convolve(np.pad(heard, fade, mode="edge"), kernel, mode="valid")
    silent = replace(recording, waveform=recording.waveform * share.astype(np.float32))
    seconds = sum(end - begin for begin, end in spans)
    return silent.noted(f"silent where others than {acting.role} speak: {seconds:.1f} s")


def _notes_on_unused(acting: Acting, rules: RulesConfig) -> Iterator[str]:
    """Notes on fields that are given and change nothing."""
    if not (acting.words or acting.script) and "language" in acting.settings:
        yield f"language {acting.language} is of words: none are given"
    if rules.expressions is not None:
        yield from unused_variants(acting.variant, acting.emotion_track.weights)
    elif acting.variant:
        yield "variant not used: the rule that shows it is off"
    if rules.idle is None or acting.motion is None:
        of_motion = acting.settings.keys() & {"life", "look_at", "seed", "listen_to"}
        if unused := sorted(of_motion - ({"life"} if acting.motion is None else set())):
            why = "the rules that move it are off" if acting.motion else "life is off"
            yield f"{', '.join(unused)} not used: {why}"


def _suggested(
    acting: Acting, recording: Recording
) -> tuple[Acting, Recording, Mapping[str, float] | None]:
    """The acting with the suggested emotion, the recording with a note on it, probabilities.

    Neutral without probabilities where there is too little speech.
    """
    from deitalk.pipeline.suggest import suggest_emotion  # needs torch

    try:
        found = suggest_emotion(recording)
    except AudioError as error:
        return Acting.of(acting, emotion="neutral"), recording.noted(f"{error}: neutral"), None
    others = ", ".join(
        f"{name} {share:.2f}" for name, share in found.probabilities.items() if name != found.label
    )
    note = f"suggested from the voice: {found.line}; {others}"
    recording = recording.noted(note)
    return Acting.of(acting, emotion=found.label), recording, found.probabilities


def _felt(acting: Acting, other: OtherVoice, recording: Recording) -> tuple[Acting, Recording]:
    """Return the acting with the emotion of the other recording, and the recording with a note.

    The emotion is suggested from the other voice; where it is given there is no note.
    """
    if other.recording is None:
        return acting, recording
    try:
        from deitalk.pipeline.suggest import suggest_emotion  # needs torch

        found = suggest_emotion(other.recording)
        emotion = f"{found.label}={found.probabilities[found.label]:.2f}"
        note = f"listens to a voice that sounds {emotion}"
    except (AudioError, MissingError) as error:
        emotion, note = "", f"listens without its feeling: {error}"
    other = replace(other, emotion=emotion, recording=None)
    return Acting.of(acting, listen_to=other), recording.noted(note)


def finish(
    prepared: Prepared, reading: Reading, model: str = "", words: "WordFit | None" = None
) -> Performance:
    """Apply the rules to what the network read.

    Parameters
    ----------
    prepared, reading
        What was prepared, and read of it.
    model : str
        Its name or folder, for a take.
    words : WordFit, optional
        Times of the words, if they are known already.
    """
    return _ruled([_measured(prepared, reading, words)], model)[0]


def finish_together(prepared: Sequence[Prepared], readings: Sequence[Reading]) -> list[Performance]:
    """Apply the rules to recordings of one network in one pass, as `finish` does to one."""
    return _ruled([_measured(*given) for given in zip(prepared, readings, strict=True)])


class Unruled(NamedTuple):
    """A recording before the rules, which finish its readings in place."""

    neutral: Float32
    """Reading [shape=(T, C)]; then the neutral curves."""
    shown: Float32
    """Another array, the emotional reading [shape=(T, C)]; then the curves that are shown."""
    voice: Float32
    """Columns of `deitalk.postprocess.tracks.VoiceTracks` [shape=(T, 44)]."""
    gates: Float32
    """Gates and motion, from `deitalk.postprocess.tracks.shown_columns` [shape=(T, 45)]."""
    gain: Float32
    """Factor of each control [shape=(C,)]."""
    ruled: bool = True
    """False leaves the readings as they are, but for gain and range."""


class Measured(NamedTuple):
    """What is known of a recording before its motion is drawn and the rules apply."""

    prepared: Prepared
    neutral: Float32
    shown: Float32
    voice: Float32
    """Columns of `deitalk.postprocess.tracks.VoiceTracks` [shape=(T, 44)]."""
    intensities: Intensities
    traits: Traits
    habits: Float32
    """Factors of the character on the expression of each control [shape=(C,)]."""
    moved: Moved | None
    words: "WordFit | None"


def _measured(prepared: Prepared, reading: Reading, words: "WordFit | None" = None) -> Measured:
    """Intensity, words, held sounds and character of a recording."""
    neutral, emotional, tracks = reading.first(len(prepared.weights))
    speech, rules, acting, clock = prepared.speech, prepared.rules, prepared.acting, prepared.clock
    network, weights = prepared.network, prepared.weights
    # Intensity: of the voice, and what the reading holds of it.
    speaking = speech.activity > 0
    held = partial(held_intensity, rules.expressions, network.controls, neutral, emotional, weights)
    factor = levels(prepared.marks, speech.times) if prepared.marks else 1.0
    intensities = measure_intensities(
        speech, tracks, acting, rules.voice_intensity, held, weights, factor
    )
    clock.lap("network")
    # Times of the words in the sound.
    words = words or prepared.said
    if words is None and prepared.words is not None:
        from deitalk.pipeline.words.align import align_words

        words = align_words(speech, prepared.words)
    phones = phone_tracks(() if words is None else words.known, len(weights))
    # What the pass reads of each frame besides the readings.
    near, usual = (mean_around(x, speaking) for x in (intensities.voice, intensities.network))
    opening = opening_factor(rules.scale_opening, near, usual)
    kept = speech.held(rules.hold_pose)
    state = state_of_intensity(near) if speaking.any() else None
    # Traits of the character: of its voice's reference, of the take before, or drawn.
    given = (acting.voice and acting.voice.traits) or (acting.after and acting.after.traits)
    if given:
        traits = Traits(**given)
    else:
        seeds = Seeds.of(speech.waveform, prepared.style, acting.seed)
        traits = replace(Traits.of(seeds.character()), own=float(prepared.style != ""))
    ways = choose_ways(acting.variant, traits, acting.seed, state)
    side = np.full(len(weights), ways.side)
    voice = VoiceTracks(
        intensities.scale, opening, intensities.held, phones, weights, kept.back, kept.share,
        ways.of(weights), side, intensities.felt,
    )  # fmt: skip
    moved = _moved(prepared, weights * intensities.applied[:, None], traits)
    values = neutral.copy() if emotional is neutral else emotional
    habits = habit_factors(network.controls, rules.expressions, ways.habits)
    return Measured(
        prepared, neutral, values, voice.columns(), intensities, traits, habits, moved, words
    )


def _ruled(read: Sequence[Measured], model: str = "") -> list[Performance]:
    """Draw the motion of recordings, and apply the rules to all of them at once."""
    # Motion, drawn for all recordings at once.
    takes = [moved for each in read if (moved := each.moved) is not None]
    idle = next((each.prepared.rules.idle for each in read if each.moved is not None), None)
    planned = iter(plan_motions(takes, idle) if idle is not None else ())
    motions = [None if each.moved is None else next(planned) for each in read]
    clips = []
    for each, motion in zip(read, motions, strict=True):
        gates = shown_columns(
            each.prepared.speech.mouth, each.intensities.share, motion and motion.tracks
        )
        given = each.prepared.gain, each.prepared.acting.rules
        clips.append(Unruled(each.neutral, each.shown, each.voice, gates, *given))
    # The rules, in their order: `deitalk.postprocess.curve_pass`.
    controls = read[0].prepared.network.controls
    outside = apply_rules(read[0].prepared.network.curve_pass(), clips)
    for each, clip in zip(read, clips, strict=True):
        show_habits(clip.shown, clip.neutral, controls, each.habits)
    return [_performance(*one, model) for one in zip(read, motions, clips, outside, strict=True)]


def _performance(
    read: Measured, motion: Motion | None, ruled: Unruled, clipped: int, model: str
) -> Performance:
    """What follows the rules: breaths, the takes beside, edits by hand."""
    prepared, intensities, words, moved = read.prepared, read.intensities, read.words, read.moved
    speech, rules, acting, clock = prepared.speech, prepared.rules, prepared.acting, prepared.clock
    controls = prepared.network.controls
    head = None if motion is None or not motion.head.any() else motion.head
    if moved is not None and rules.idle and moved.character.life.times(rules.idle).head > 0:
        key = moved.character.seeds.key("head")
        draw_breaths(controls, ruled.neutral, ruled.shown, moved.voice, key, ruled.gain)
    clock.lap("expression")
    join(controls, ruled.shown, head, acting)
    shown_curves = _curves(controls, ruled.shown, prepared.weights, intensities.applied, head)
    neutral_curves = _curves(controls, ruled.neutral)
    recording, with_edits = prepared.recording, None
    if words is not None and not words.fits:
        recording = recording.noted(words.line)
    if clipped and (ruled.gain != 1).any():
        recording = recording.noted(f"gain: with it {clipped} values were clamped to their ranges")
    if acting.edit:
        given = (shown_curves, neutral_curves), controls, rules.keep_contacts
        with_edits = edited(acting.edit, *given, speech, words)
        shown_curves, neutral_curves = with_edits.readings
        recording = recording.noted(*with_edits.notes)
        clock.lap("edits")
    return Performance(
        shown_curves,
        neutral_curves,
        intensities.saliency,
        intensities.predicted,
        recording,
        clipped,
        clock.laps,
        acting,
        model,
        words,
        prepared.suggestion,
        asdict(read.traits),
        prepared.marks,
        with_edits,
    )


def apply_rules(rules: CurveRules, clips: Sequence[Unruled]) -> list[int]:
    """Finish both readings of whole recordings in place, block by block, side by side.

    Returns
    -------
    list of int
        Values of the shown curves of each that were outside of their range.
    """
    outside, state = np.zeros(len(clips)), rules.first(len(clips))
    rest, size = rules.before[-1], clips[0].neutral.shape[1]  # a face at rest follows the last
    after = rest[:size], rest[size : 2 * size], rest[2 * size :], np.zeros(1, np.float32)
    gain = np.stack([clip.gain for clip in clips])
    flags = np.array([clip.ruled for clip in clips], np.float32)
    gates = [np.pad(clip.gates, ((rules.ahead, 0), (0, 0))) for clip in clips]  # as they come out
    columns = [
        (clip.neutral, clip.shown, clip.voice, gate)
        for clip, gate in zip(clips, gates, strict=True)
    ]
    total = max(len(clip.neutral) for clip in clips) + rules.ahead
    for start in range(0, total, BLOCK_FRAMES):
        stop = min(start + BLOCK_FRAMES, total)
        neutral, shown, voice, gate = (
            np.stack([_rows(values, start, stop, fill) for values in each])
            for *each, fill in zip(*columns, after, strict=True)
        )
        curves, plain, counts, state = rules(neutral, shown, voice, gate, gain, flags, state)
        begin = start - rules.ahead
        for place, clip in enumerate(clips):
            first, last = max(begin, 0), min(stop - rules.ahead, len(clip.neutral))
            if first < last:
                done, known = slice(first, last), slice(first - begin, last - begin)
                clip.shown[done], clip.neutral[done] = curves[place, known], plain[place, known]
                outside[place] += counts[place, known].sum()
    return [round(float(count)) for count in outside]


def _rows(values: Float32, start: int, stop: int, after: Float32) -> Float32:
    """Rows of an array [shape=(T, N)]; others follow its last one."""
    rows = values[start:stop]
    missing = stop - start - len(rows)
    if not missing:
        return rows
    return np.concatenate((rows, np.broadcast_to(after, (missing, values.shape[1]))))


def join(controls: ControlSet, values: Float32, head: Float32 | None, acting: Acting) -> None:
    """Have curves [shape=(T, C)] and a head [shape=(T, 6)] begin and end at the takes beside.

    Both are changed in place.
    """
    most = len(values) // 2 if acting.into is not None else None
    if acting.after is not None:
        lead(values, head, controls, acting.after, most=most)
    if acting.into is not None:
        lead(values, head, controls, acting.into, last=True, most=most)


def _moved(prepared: Prepared, shown: Float32, traits: Traits) -> Moved | None:
    """What moves above the mouth for the emotion that is shown [shape=(T, 9)], if anything."""
    speech, acting, idle = prepared.speech, prepared.acting, prepared.rules.idle
    life, other = acting.motion, acting.listen_to
    is_still = not (acting.listen or other or speech.activity.any())
    if idle is None or life is None or is_still:
        return None
    emotions = shown.sum(axis=0)
    emotion = int(emotions[1:].argmax()) + 1 if emotions[1:].any() else 0
    seeds = Seeds.of(speech.waveform, prepared.style, acting.seed, emotion)
    voice = with_accents(measure_voice(speech.activity, speech.prosody), prepared.marks)
    heard = felt = None
    if other is not None:
        heard, felt = other.voice(speech.n_frames), other.felt(speech.n_frames)
    return Moved(voice, shown, Character(seeds, life, traits), heard, felt)


def _curves(
    controls: ControlSet,
    values: Float32,
    emotion: Float32 | None = None,
    intensity: Float32 | None = None,
    head: Float32 | None = None,
) -> RigCurves:
    values.setflags(write=False)  # not copied: an hour is 80 MB
    return RigCurves(
        values,
        controls.names,
        fps=float(FRAME_RATE),
        control_set=controls.id,
        emotion=emotion,
        intensity=intensity,
        head=head,
    )


def _with_note_on(
    name: str, curve: IntensityCurve | EmotionTrack | None, recording: Recording
) -> Recording:
    """The recording, with a note if a curve was made for a longer one."""
    if curve is None or curve.times[-1] <= recording.duration + CURVE_OVERHANG_SECONDS:
        return recording
    note = (
        f"the {name} has keys until {curve.times[-1]:.1f} s, the recording lasts "
        f"{recording.duration:.1f} s: what comes after is not used"
    )
    return recording.noted(note)


def _extended(recording: Recording, seconds: float) -> Recording:
    """The recording with so much silence after it, which is not the floor of its noise."""
    silence = np.zeros(max(round(seconds * recording.sample_rate), 0), np.float32)
    if not len(silence):
        return recording
    longer = replace(recording, waveform=np.concatenate([recording.waveform, silence]))
    more = longer.n_frames - recording.n_frames
    vars(longer)["activity"] = np.pad(recording.activity, (0, more))
    return longer


class _Clock:
    """Seconds between laps."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = perf_counter()

    def lap(self, name: str) -> None:
        now = perf_counter()
        self.laps[name] = now - self._last
        self._last = now
