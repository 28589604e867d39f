"""Warnings about recordings without speech, or with very quiet or voiceless speech."""

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.prosody import rms_db
from deitalk.audio.voice_activity import (
    SHORT_SECONDS,
    active_level_db,
    noise_likeness,
    speech_activity,
)
from rig.arrays import Float32

SILENT_PEAK = 10 ** (-90 / 20)  # half a step of 16 bits is -96 dBFS
FAINT_DB = -60.0  # speech is recorded at -45 to -12 dBFS
NOISE_LIKENESS = 0.5  # speakers: at most 0.43 of 150 recordings; noise that comes and goes: 0.54


def describe(waveform: Float32, activity: Float32 | None = None) -> tuple[str, ...]:
    """Warnings about a recording without usable speech.

    Parameters
    ----------
    waveform : array (S,) float32
        16 kHz, without DC; full scale is 1.
    activity : array (T,), optional
        From `speech_activity`, if it is known already.

    Returns
    -------
    tuple of str
        Empty for speech of a usual level. A clip under 0.35 s is only tested for silence.
    """
    if max(waveform.max(), -waveform.min()) < SILENT_PEAK:
        return ("silence: no sample is above -90 dBFS, so the face stays at rest",)
    if len(waveform) < SHORT_SECONDS * SAMPLE_RATE:
        return ()
    activity = speech_activity(waveform) if activity is None else activity
    if not activity.any():
        level = rms_db(waveform)
        kind = "sound too quiet to distinguish from noise" if level < FAINT_DB else "steady sound"
        return (f"no speech found, only {kind} ({level:.0f} dBFS), so the mouth stays shut",)
    notes = []
    if noise_likeness(waveform, activity) > NOISE_LIKENESS:
        notes.append("no voice found: its varying sound is noise, or whispering")
    level = active_level_db(waveform, activity)
    if level < FAINT_DB:
        notes.append(f"very quiet ({level:.0f} dBFS): it is amplified, and its noise with it")
    return tuple(notes)
