"""Voice activity at 30 Hz and the level of speech, from the whole clip.

Letters: K frequency bands.
"""

import numpy as np
import numpy.typing as npt

from deitalk.array_functions import (
    FAR,
    Array,
    as_index,
    in_order,
    library,
    like,
    neighbours,
    padded,
    percentile,
    scalar,
    single,
)
from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE, frame_count, runs
from deitalk.audio.held_sound import BEFORE, held_sound, steady_frames
from deitalk.audio.prosody import measure_windows
from deitalk.config.rules import HoldPose
from rig.arrays import Float32, Int64

WINDOW = 1024  # samples, 64 ms, centred on the frame's time
BAND_EDGES_HZ = (100, 200, 320, 460, 640, 860, 1130, 1460, 1870, 2370, 2980, 3720, 4640, 5760, 7200)
TOP_BANDS = 4  # of the 14; speech rises above the noise in a few bands
SILENCE_DB = -85.0  # per band, dBFS: fainter sound is no speech
DIGITAL_DB = -100.0  # of every band: zeros, or the dither of 16 bits; no room is so quiet
DIGITAL_FRAMES = 3  # of them count as a pause: all of a floor until there is .9 s of other sound
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
HANN = np.hanning(WINDOW + 1)[:-1]
_EDGES = np.ceil(np.array(BAND_EDGES_HZ) * WINDOW / SAMPLE_RATE)
_NUMBER = np.arange(_EDGES[-1])[:, None]
BINS = ((_NUMBER >= _EDGES[:-1]) & (_NUMBER < _EDGES[1:])) * 2 / (WINDOW * np.square(HANN).sum())
"""Share of the power of each bin in the mean square of each band [shape=(461, 14)]."""


def speech_activity(waveform: npt.ArrayLike) -> Float32:
    """Frames with speech: 1, all others 0.

    The power in 14 bands is compared with a noise floor of its own, the lowest tenth of the
    12 s around, without digital silence, which says nothing of the room: it is between joined
    takes, and at the ends of files. A frame is speech where its four strongest bands rise above
    the floor, with hysteresis, bridged stop closures and clicks removed. In noise longer gaps are
    bridged: a mouth that stays shut during a masked syllable is more visible than one that may
    move in a short pause. Above -85 dBFS per band the result does not depend on the level, so
    whispered and quiet recordings work.

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
    levels = band_levels(samples)
    # Of all steady sounds that are long enough, whether they have a pitch.
    rule, tones = HoldPose(), np.zeros(len(levels))
    for start, stop in runs(steady_frames(levels, rule)):
        for first in range(start, stop if stop - start >= rule.frames else start, 2048):
            frames = np.arange(first, min(first + 2048, stop))
            tones[frames] = measure_windows(_windows(samples, frames).astype(np.float64)).tone
    return np.asarray(active_frames(levels, tones, len(samples)), np.float32)


def active_frames(levels: Array, tones: Array, n_samples: int) -> Array:
    """Frames with speech [shape=(T,)] of a whole recording, as `speech_activity` describes.

    Parameters
    ----------
    levels : array or Tensor [shape=(T, K)]
        From `levels_of_power`.
    tones : array or Tensor [shape=(T,)]
        `deitalk.audio.prosody.Prosody.tone`; it matters where the levels are steady.
    n_samples : int
        S.
    """
    xp, rule = library(levels), HoldPose()
    held = held_sound(levels, tones, rule).sounding
    held = held | _frames_before(held, BEFORE + rule.frames)
    floor = _noise_floor(levels, held)
    above = in_order(audible(levels) - floor, axis=1)[:, -TOP_BANDS:].mean(1)
    excess = xp.where(held, xp.clip(above, OPEN_DB, None), above)
    # Runs of `keeps` that hold at least one frame of `opens`.
    opens, keeps = excess >= OPEN_DB, excess >= KEEP_DB
    opened, ended = neighbours(opens), neighbours(~keeps)
    speech = keeps & ((opened[0] > ended[0]) | (opened[1] < ended[1]))
    # Frames without speech that are no pause.
    longest = longest_gap(percentile(excess, 95, not_digital(levels, excess == excess)))
    last, following = neighbours(speech)
    speech = speech | ((following - last - 1 <= longest) & (last >= 0) & (following < FAR))
    # A single frame is a click, but in a clip that is very short.
    beside = padded(speech, 1, 1)
    is_short = scalar(n_samples, levels) < SHORT_SECONDS * SAMPLE_RATE
    return speech & (beside[:-2] | beside[2:] | is_short)


def longest_gap(loudest: Array) -> Array:
    """Longest gap that is no pause, frames, of how far the loudest speech is above the noise, dB.

    In noise longer gaps are bridged.
    """
    xp = library(loudest)
    share = xp.clip((loudest - NOISY_DB) / (CLEAN_DB - NOISY_DB), 0, 1)
    return xp.round(LONGEST_DROWNED + share * (LONGEST_CLOSURE - LONGEST_DROWNED))


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
    found = []
    for start in range(0, len(active), 2048):
        frames = active[start : start + 2048]
        spectrum = np.fft.rfft(_windows(samples, frames) * window)
        power = np.abs(spectrum[:, first : first + n_bands * LIKENESS_BINS]) ** 2 + 1e-14
        bands = power.reshape(len(frames), n_bands, LIKENESS_BINS)
        flatness = np.exp(np.log(bands).mean(axis=2)) / bands.mean(axis=2)
        found.append(flatness.mean(axis=1))
    if not found:
        return 0.0
    flat = np.concatenate(found)
    return float(percentile(flat, 10, np.isfinite(flat)))


def band_levels(waveform: Float32) -> Float32:
    """Power per band of every frame of a recording [shape=(T, K)], dB re full scale."""
    n_frames = frame_count(len(waveform))
    levels = np.empty((n_frames, len(BAND_EDGES_HZ) - 1), np.float32)
    for first in range(0, n_frames, 2048):
        frames = np.arange(first, min(first + 2048, n_frames))
        levels[frames] = window_levels(_windows(waveform, frames))
    return levels


def window_levels(windows: Array) -> Array:
    """Power per band (n, K) in dB re full scale of `WINDOW` samples each (n, WINDOW)."""
    spectra = library(windows).fft.rfft(windows * like(HANN.astype(np.float32), windows))
    return single(levels_of_power(spectra.real**2 + spectra.imag**2))


def levels_of_power(power: Array) -> Array:
    """Power per band (n, K) in dB re full scale, of that of spectra (n, at least 461).

    Arrays or tensors; the spectra are of `WINDOW` samples times `HANN`.
    """
    bands = power[:, : len(BINS)] @ like(BINS.astype(np.float32), power)
    xp = library(power)
    return 10 * xp.log10(xp.clip(bands, 10 ** (DIGITAL_DB / 10), None))


def audible(levels: Array) -> Array:
    """Levels of which none is below `SILENCE_DB`."""
    return library(levels).clip(levels, SILENCE_DB, None)


def not_digital(levels: Array, used: Array, axis: int = 0) -> Array:
    """Frames of those `used` (T, ...) whose bands (T, ..., K) are no digital silence.

    The first `DIGITAL_FRAMES` of that along the axis of time stay, as a pause.
    """
    is_digital = used & (library(levels).amax(levels, axis=-1) <= DIGITAL_DB)
    return used & ((as_index(is_digital).cumsum(axis) <= DIGITAL_FRAMES) | ~is_digital)


def _windows(samples: Float32, frames: Int64) -> Float32:
    """The `WINDOW` samples around every frame's time (n, WINDOW), zeros outside the clip."""
    starts = frames * SAMPLE_RATE // FRAME_RATE - WINDOW // 2
    low, high = int(starts[0]), int(starts[-1]) + WINDOW
    piece = samples[max(low, 0) : min(high, len(samples))]
    piece = np.pad(piece, (max(-low, 0), max(high - len(samples), 0)))
    windows: Float32 = np.lib.stride_tricks.sliding_window_view(piece, WINDOW)[starts - low]
    return windows


def _noise_floor(levels: Array, held: Array) -> Array:
    """Level per band (T, K) above which there is more than noise, in dB.

    Frames of a `held` sound (T,) are no noise. The lowest tenth of `FLOOR_SECONDS` is measured
    every two seconds and at the last frame; between them it passes by straight lines.
    """
    xp, n_frames = library(levels), levels.shape[0]
    half = round(FLOOR_SECONDS * FRAME_RATE / 2)
    hop, quiet = half // 3, SHORT_FLOOR_DB - OPEN_DB
    centres = xp.clip(xp.arange((n_frames + hop - 1) // hop + 1) * hop, None, n_frames - 1)
    places = centres + xp.arange(-half, half)[:, None]  # (2 half, N)
    inside = xp.clip(places, 0, n_frames - 1)
    rows = audible(levels)[inside]  # (2 half, N, K)
    used = not_digital(levels[inside], (places == inside) & ~held[inside])
    found = percentile(rows, FLOOR_PERCENTILE, xp.broadcast_to(used[:, :, None], rows.shape))
    lowest = xp.where(as_index(used).sum(0)[:, None] > 0, found, xp.full_like(found, quiet))
    frames = xp.arange(n_frames)
    before = frames // hop
    first, second = centres[before], centres[before + 1]
    share = ((frames - first) / xp.clip(second - first, 1, None))[:, None]
    floor = lowest[before] + share * (lowest[before + 1] - lowest[before])
    highest = xp.amax(audible(levels), axis=1)
    loudest = percentile(highest, 98, not_digital(levels, highest == highest))
    floor = xp.maximum(floor, loudest - SPEECH_RANGE_DB)
    is_short = scalar(n_frames, levels) < SHORT_SECONDS * FRAME_RATE
    return xp.where(is_short, xp.full_like(floor, quiet), floor)


def _frames_before(flags: Array, count: int) -> Array:
    """The `count` frames before each run of flags (T,)."""
    starts = flags & ~padded(flags, 1, 0)[:-1]
    return neighbours(starts)[1] - library(flags).arange(flags.shape[0]) <= count
