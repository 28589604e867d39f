"""The main path: speech and an emotion in, 185 curves out."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from deitalk.audio.arrays import Audio, recording_of
from deitalk.audio.load import Recording, frame_times
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import normalise_level, speech_activity
from deitalk.emotions import EmotionTrack, IntensityCurve
from deitalk.errors import CheckpointError
from deitalk.pipeline.arguments import (
    applied_curve,
    check_progress,
    emotion_text,
    emotion_track,
    intensity_factor,
    whole_seed,
)
from deitalk.pipeline.performance import Performance
from deitalk.postprocess.blinks import add_idle_motion
from deitalk.postprocess.curve_rules import Expression
from deitalk.postprocess.gates import expression_gate, mouth_gate
from deitalk.postprocess.voice_intensity import heard_intensity, vocal_effort_z
from rig import RigCurves
from rig.arrays import Float32
from rig.errors import quoted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from deitalk.models.curve_model import DEITalk

CURVE_OVERHANG_SECONDS = 0.5  # by which an intensity curve may outlast the recording, unremarked


def animate(
    audio: Audio,
    emotion: "str | Path | Mapping[str, float] | EmotionTrack" = "neutral",
    *,
    sample_rate: float | None = None,
    model: "str | Path | DEITalk" = "default",
    intensity: float = 1.0,
    intensity_curve: str | Path | IntensityCurve | None = None,
    idle: bool = True,
    seed: int = 0,
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
    model : str, Path or DEITalk
        Name of an embedded model, a model folder, or a loaded model.
    intensity : float, range 0 to 4
        Factor on the intensity heard in the voice; 0 is the neutral reading.
    intensity_curve : path or IntensityCurve, optional
        Intensity to apply instead of the one heard, as written in a take's ``intensity.csv``.
    idle : bool
        Add blinks and small motions of the gaze.
    seed : int
        Of the blinks.
    progress : callable
        Told the share of the network's work that is done, 0 to 1.

    Returns
    -------
    Performance

    Raises
    ------
    AudioError, EmotionError, CheckpointError
        One line each: the value, the rule and the way out.
    """
    clock = _Clock()
    intensity, seed = intensity_factor(intensity), whole_seed(seed)
    check_progress(progress)
    track, curve = emotion_track(emotion), applied_curve(intensity_curve)
    recording = _with_note_on(curve, recording_of(audio, sample_rate))
    clock.lap("audio")
    network = _network(model)
    clock.lap("model")
    activity = speech_activity(recording.waveform)
    shown = expression_gate(activity)
    times = frame_times(recording.n_frames)
    weights = track.at(times)
    neutral, emotional, saliency, heard = _read(network, recording, weights, activity, progress)
    clock.lap("network")
    prosody = measure_prosody(recording.waveform, recording.n_frames)
    strength = heard_intensity(heard, prosody, activity)
    predicted = strength * shown
    applied = predicted * np.float32(intensity) if curve is None else curve.at(times) * intensity
    effort = vocal_effort_z(prosody)
    values = _apply_rules(
        network, neutral, emotional, strength, heard, applied, shown, effort, activity
    )
    if idle and activity.any():
        for reading in (neutral, values):
            rng = np.random.default_rng(seed)
            add_idle_motion(reading, network.controls, fps=30, rng=rng)
    clipped = _clamp(values, network) + 0 * _clamp(neutral, network)
    clock.lap("expression")
    return Performance(
        _curves(network, values, weights, applied.astype(np.float32)),
        _curves(network, neutral),
        saliency,
        predicted,
        recording,
        clipped,
        clock.laps,
        _settings(emotion, intensity, intensity_curve, idle, seed),
        str(model) if isinstance(model, str | Path) else "",
    )


def _apply_rules(
    network: "DEITalk",
    neutral: Float32,
    emotional: Float32,
    strength: Float32,
    heard: Float32,
    applied: Float32,
    shown: Float32,
    effort: float,
    activity: Float32,
) -> Float32:
    """Apply the rules to both readings in place; return the blend of them [shape=(T, C)]."""
    rules = Expression(network.controls)
    for reading in (neutral,) if emotional is neutral else (neutral, emotional):
        rules.sharpen_contacts(reading)
        rules.scale_opening(reading, strength, heard, effort)
    values = rules.blend(neutral, emotional, applied, heard * shown)
    for reading in (neutral, values):
        rules.limit_contact_speed(reading)
        rules.apply_dead_zone(reading)
        rules.rest_in_silence(reading, mouth_gate(activity), shown)
    return values


def _settings(emotion: Any, intensity: float, curve: Any, idle: bool, seed: int) -> dict[str, Any]:
    """What was asked for, as a take says it."""
    name = Path(curve).name if isinstance(curve, str | Path) else None
    return {
        "emotion": emotion_text(emotion),
        "intensity": intensity,
        "intensity_curve": name if curve is None or name else "a curve in memory",
        "idle": idle,
        "seed": seed,
    }


def _curves(
    network: "DEITalk",
    values: Float32,
    emotion: Float32 | None = None,
    intensity: Float32 | None = None,
) -> RigCurves:
    controls = network.controls
    return RigCurves(
        values,
        controls.names,
        fps=30.0,
        emotion=emotion,
        intensity=intensity,
        control_set=controls.id,
    )


def _read(
    network: "DEITalk",
    recording: Recording,
    weights: Float32,
    activity: Float32,
    progress: Callable[[float], None],
) -> tuple[Float32, Float32, Float32, Float32]:
    """Neutral and emotional reading [shape=(T, C)], saliency and intensity [shape=(T,)]."""
    import torch

    n_frames = recording.n_frames
    device = next(network.parameters()).device
    waveform = torch.from_numpy(normalise_level(recording.waveform, activity=activity))
    analysis = network.analyse(waveform, n_frames, progress)
    del waveform  # an hour of it is 230 MB, and the curves are yet to come
    plain = torch.zeros(n_frames, weights.shape[1], device=device)
    plain[:, 0] = 1
    neutral = network.decode(analysis, plain).cpu().numpy()
    emotional = neutral
    if (weights[:, 0] < 1).any():
        emotional = network.decode(analysis, torch.from_numpy(weights).to(device)).cpu().numpy()
    if analysis.saliency is None or analysis.strength is None:
        return neutral, emotional, np.zeros(n_frames, np.float32), np.ones(n_frames, np.float32)
    return neutral, emotional, analysis.saliency.cpu().numpy(), analysis.strength.cpu().numpy()


def _network(model: "str | Path | DEITalk") -> "DEITalk":
    if isinstance(model, str | Path):
        from deitalk.models.checkpoint import load_model

        return load_model(model)
    if not hasattr(model, "analyse"):
        raise CheckpointError(
            f"model {quoted(model)} is a {type(model).__name__}; give a name, a folder, or what "
            "deitalk.load_model returns"
        )
    return model.eval()


def _with_note_on(curve: IntensityCurve | None, recording: Recording) -> Recording:
    """The recording, with a note if the intensity curve was made for a longer one."""
    if curve is None or curve.times[-1] <= recording.duration + CURVE_OVERHANG_SECONDS:
        return recording
    note = (
        f"the intensity curve lasts {curve.times[-1]:.1f} s, the recording "
        f"{recording.duration:.1f} s: what comes after is not used"
    )
    return replace(recording, warnings=(*recording.warnings, note))


def _clamp(values: Float32, network: "DEITalk") -> int:
    """Clamp to the controls' ranges in place; count the values that were more than 1 % outside."""
    low, high = network.controls.minimum, network.controls.maximum
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
