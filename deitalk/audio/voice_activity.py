"""Voice activity at 30 Hz and the level of speech, from the whole clip. numpy only.

Letters: K frequency bands.
"""

import numpy as np
import numpy.typing as npt

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count, runs
from deitalk.audio.held_sound import BEFORE, held_sound, steady_frames
from deitalk.audio.prosody import measure_windows, tonality
from deitalk.config.rules import HoldPose
from rig.arrays import Bool, Float32, Int64

WINDOW = 1024  # samples, 64 ms, centred on the frame's time
BAND_EDGES_HZ = (100, 200, 320, 460, 640, 860, 1130, 1460, 1870, 2370, 2980, 3720, 4640, 5760, 7200)
TOP_BANDS = 4  # of the 14; speech rises above the noise in a few bands
SILENCE_DB = -85.0  # per band, dBFS: dither
SPEECH_RANGE_DB = 45.0  # below the loudest speech; quieter sound is breath and reverberation
FLOOR_SECONDS = 12.0  # time in which the noise may change
FLOOR_PERCENTILE = 10.0
SHORT_SECONDS = 0.35  # too short to hold both speech and noise
SHORT_FLOOR_DB = -60.0
OPEN_DB, KEEP_DB = 9.0, 5.0  # hysteresis, excess over the noise floor
LIKENESS_HZ = (200, 4000)  # where a voice has harmonics
LIKENESS_BINS = 30  # 470 Hz: narrow enough that the colour of noise does not matter
LONGEST_CLOSURE = 6  # frames; a gap up to 0.2 s is a stop consonant, not a pause
LONGEST_DROWNED = 15  # frames; in noise a weak syllable beside the consonant is missed as well
NOISY_DB, CLEAN_DB = 25.0, 40.0  # excess of the loudest speech, between the two in proportion
SHORTEST_SPEECH = 2  # frames; a single one is a click


def speech_activity(waveform: npt.ArrayLike) -> Float32:
    """Frames with speech: 1, all others 0.

    The power in 14 bands is compared with a noise floor of its own, the lowest tenth of the
    12 s around; a frame is speech where its four strongest bands rise above it, with
    hysteresis, bridged stop closures and clicks removed. In noise longer gaps are bridged: a mouth
    that stays shut during a masked syllable is more visible than one that may move in a short
    pause. Above -85 dBFS per band the result does not depend on the level, so whispered and quiet
    recordings work.

    Parameters
    ----------
    waveform : array (S,)
        16 kHz.

    Returns
    -------
    ndarray (T,) float32
        T = ceil(30 · S / 16000). All 0 for silence and steady noise.

    Notes
    -----
    A clip under 0.35 s is too short to show its noise floor: it counts as speech wherever it is
    louder than -60 dBFS in a band.
    """
    samples = np.asarray(waveform, dtype=np.float32)
    if len(samples) == 0:
        return np.zeros(0, np.float32)
    # Power per band (T, K) in dB re full scale, not below `SILENCE_DB`.
    levels = band_levels(samples)
    held = _held_frames(samples, levels)
    excess = np.sort(levels - _noise_floor(levels, held), axis=1)[:, -TOP_BANDS:].mean(axis=1)
    excess[held] = np.maximum(excess[held], OPEN_DB)
    # Runs of `keeps` that hold at least one frame of `opens`.
    opens = excess >= OPEN_DB
    keeps = excess >= KEEP_DB
    speech = np.zeros_like(keeps)
    for start, stop in runs(keeps):
        speech[start:stop] = opens[start:stop].any()
    # Frames without speech that are no pause, by how far the loudest speech is above the noise.
    loudest = np.percentile(excess, 95)
    gap = np.interp(loudest, [NOISY_DB, CLEAN_DB], [LONGEST_DROWNED, LONGEST_CLOSURE])
    speech = ~_without_short(~speech, round(float(gap)), keep_ends=True)
    if len(samples) >= SHORT_SECONDS * SAMPLE_RATE:
        speech = _without_short(speech, SHORTEST_SPEECH - 1)
    return speech.astype(np.float32)


def active_level_db(waveform: npt.ArrayLike, activity: npt.ArrayLike | None = None) -> float:
    """Level of the speech in a recording, pauses left out.

    Parameters
    ----------
    waveform : array (S,)
        16 kHz.
    activity : array (T,), optional
        From `speech_activity`, if it is known already.

    Returns
    -------
    float
        RMS over the speaking frames in dB re full scale; ``-inf`` without speech.
    """
    samples = np.asarray(waveform, dtype=np.float32)
    active = np.asarray(speech_activity(samples) if activity is None else activity) > 0.5
    energy, count = 0.0, 0
    for start, stop in runs(active) * SAMPLE_RATE // FRAME_RATE:
        piece = samples[start:stop]
        energy, count = energy + float(piece @ piece), count + len(piece)
    return 10 * float(np.log10(energy / count)) if energy > 0 else -np.inf


def normalise_level(
    waveform: npt.ArrayLike, target_db: float = -23.0, activity: npt.ArrayLike | None = None
) -> Float32:
    """Scale a recording so that its speech without pauses has a given level.

    Parameters
    ----------
    waveform : array (S,)
        16 kHz.
    target_db : float
        RMS of the speech afterwards, dB re full scale. Peaks may pass ±1; nothing is clipped.
    activity : array (T,), optional
        From `speech_activity`, if it is known already.

    Returns
    -------
    ndarray (S,) float32
        A copy; unscaled if there is no speech.
    """
    samples = np.asarray(waveform, dtype=np.float32)
    return samples * np.float32(level_gain(samples, target_db, activity))


def level_gain(
    waveform: npt.ArrayLike, target_db: float = -23.0, activity: npt.ArrayLike | None = None
) -> float:
    """Factor of `normalise_level`, whose parameters these are; 1 if there is no speech."""
    level = active_level_db(np.asarray(waveform, dtype=np.float32), activity)
    return float(10 ** ((target_db - level) / 20)) if np.isfinite(level) else 1.0


def noise_likeness(waveform: npt.ArrayLike, activity: npt.ArrayLike) -> float:
    """Spectral flatness of the most voiced tenth of the active frames.

    Per frame the spectral flatness (geometric over arithmetic mean of the power) of eight narrow
    bands between 200 and 4000 Hz, averaged. A voice has harmonics, and a low value; noise of any
    colour has exp(-0.577) = 0.56 on average.

    Parameters
    ----------
    waveform : array (S,)
        16 kHz.
    activity : array (T,)
        From `speech_activity`.

    Returns
    -------
    float
        The lowest tenth of the active frames, 0 … 1; 0 where nothing is active.
    """
    samples = np.asarray(waveform, dtype=np.float32)
    active = np.flatnonzero(np.asarray(activity) > 0.5)
    window = np.hanning(WINDOW + 1)[:-1].astype(np.float32)
    first = LIKENESS_HZ[0] * WINDOW // SAMPLE_RATE
    n_bands = (LIKENESS_HZ[1] - LIKENESS_HZ[0]) * WINDOW // SAMPLE_RATE // LIKENESS_BINS
    found = [np.zeros(1)]
    for start in range(0, len(active), 2048):
        frames = active[start : start + 2048]
        spectrum = np.fft.rfft(_windows(samples, frames) * window)
        power = np.abs(spectrum[:, first : first + n_bands * LIKENESS_BINS]) ** 2 + 1e-14
        bands = power.reshape(len(frames), n_bands, LIKENESS_BINS)
        flatness = np.exp(np.log(bands).mean(axis=2)) / bands.mean(axis=2)
        found.append(flatness.mean(axis=1))
    return float(np.percentile(np.concatenate(found)[1:], 10)) if len(active) else 0.0


def band_levels(waveform: Float32) -> Float32:
    """Power per band of every frame of a recording [shape=(T, K)], dB re full scale."""
    n_frames = frame_count(len(waveform))
    levels = np.empty((n_frames, len(BAND_EDGES_HZ) - 1), np.float32)
    for first in range(0, n_frames, 2048):
        frames = np.arange(first, min(first + 2048, n_frames))
        levels[frames] = window_levels(_windows(waveform, frames))
    return levels


def _held_frames(samples: Float32, levels: Float32) -> Bool:
    """Frames of sounds that a voice holds, their beginnings too [shape=(T,)]."""
    rule, tones = HoldPose(), np.zeros(len(levels))
    for start, stop in runs(steady_frames(levels, rule)):
        if stop - start >= rule.frames:
            for first in range(start, stop, 2048):
                frames = np.arange(first, min(first + 2048, stop))
                measured = measure_windows(_windows(samples, frames).astype(np.float64))
                tones[frames] = tonality(measured[3], measured[4])
    held = held_sound(levels, tones, rule).sounding
    for start, _ in runs(held):
        held[max(start - BEFORE - rule.frames, 0) : start] = True
    return held


def window_levels(windows: Float32) -> Float32:
    """Power per band (n, K) in dB re full scale of `WINDOW` samples each (n, WINDOW)."""
    window = np.hanning(WINDOW + 1)[:-1].astype(np.float32)
    scale = 2 / (WINDOW * float((window**2).sum()))  # bins of one band then sum to mean square
    bins = np.ceil(np.array(BAND_EDGES_HZ) * WINDOW / SAMPLE_RATE).astype(int)
    spectra = np.fft.rfft(windows * window)
    power = (np.square(spectra.real) + np.square(spectra.imag)) * scale
    bands = np.add.reduceat(power[:, : bins[-1]], bins[:-1], axis=1)
    levels: Float32 = 10 * np.log10(np.maximum(bands, 10 ** (SILENCE_DB / 10)))
    return levels.astype(np.float32)


def _windows(samples: Float32, frames: Int64) -> Float32:
    """The `WINDOW` samples around every frame's time (n, WINDOW), zeros outside the clip."""
    starts = frames * SAMPLE_RATE // FRAME_RATE - WINDOW // 2
    low, high = int(starts[0]), int(starts[-1]) + WINDOW
    piece = samples[max(low, 0) : min(high, len(samples))]
    piece = np.pad(piece, (max(-low, 0), max(high - len(samples), 0)))
    windows: Float32 = np.lib.stride_tricks.sliding_window_view(piece, WINDOW)[starts - low]
    return windows


def _noise_floor(levels: Float32, held: Bool) -> Float32:
    """Level per band (T, K) above which there is more than noise, in dB.

    Frames of a `held` sound (T,) are no noise.
    """
    n_frames = len(levels)
    if n_frames < SHORT_SECONDS * FRAME_RATE:
        return np.full_like(levels, SHORT_FLOOR_DB - OPEN_DB)
    half = round(FLOOR_SECONDS * FRAME_RATE / 2)
    centres = np.unique(np.append(np.arange(0, n_frames, half // 3), n_frames - 1))
    known = np.where(held[:, None], np.float32(np.nan), levels)
    lowest = [known[max(0, c - half) : c + half] for c in centres]
    lowest = [
        np.nanpercentile(rows, FLOOR_PERCENTILE, axis=0)
        if np.isfinite(rows).any()
        else np.full(rows.shape[1], SHORT_FLOOR_DB - OPEN_DB)
        for rows in lowest
    ]
    floor = np.empty_like(levels)
    for band, values in enumerate(np.array(lowest).T):
        floor[:, band] = np.interp(np.arange(n_frames), centres, values)
    loudest = np.percentile(levels.max(axis=1), 98)
    floor = np.maximum(floor, np.float32(loudest - SPEECH_RANGE_DB))
    return floor


def _without_short(mask: Bool, longest: int, *, keep_ends: bool = False) -> Bool:
    """`mask` without its runs of up to `longest` frames, those at the clip's ends aside."""
    result = mask.copy()
    for start, stop in runs(mask):
        at_end = keep_ends and (start == 0 or stop == len(mask))
        if stop - start <= longest and not at_end:
            result[start:stop] = False
    return result
