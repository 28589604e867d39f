"""State of feeling of a voice and its display: what strength and prosody change, and how much."""

import numpy as np
import pytest

from deitalk.audio.frames import runs
from deitalk.audio.prosody import measure_prosody
from deitalk.audio.voice_activity import speech_activity
from deitalk.config.rules import VoiceIntensity
from deitalk.emotions import LABELS
from deitalk.postprocess.feeling import (
    MOST,
    NAMED_DB,
    NAMED_MOST,
    NAMED_SLOPE,
    Phrases,
    felt_intensity,
    intensity_of,
    state_of,
    voice_intensity,
)
from tests.deitalk.audio.test_prosody import voice

RULE = VoiceIntensity()
USUAL = MOST / (1 + np.exp(0.1 * 0.5))
"""Intensity of a voice of the usual strength, half of the most at 0.5 dB."""


def corrected(waveform: np.ndarray, network: np.ndarray, strength: float = 0.0) -> np.ndarray:
    prosody = measure_prosody(waveform, len(network))
    return voice_intensity(network, prosody, speech_activity(waveform) > 0, strength)


def louder(factor: float = 3.0) -> np.ndarray:
    """Six seconds, the second half louder."""
    waveform = voice(seconds=6)
    waveform[3 * 16_000 :] *= factor
    return waveform


@pytest.mark.parametrize("decibels", [-10.0, -3.0, 0.0, 0.5, 10.0, 20.0])
def test_mean_of_a_take_is_that_of_its_strength(decibels):
    """A tenth of the logarithm of odds a decibel, whatever moves in the take."""
    expected = MOST / (1 + np.exp(-0.1 * (decibels - 0.5)))
    for waveform in (voice(), louder()):
        frames = len(waveform) * 30 // 16_000
        rising = np.linspace(0.3, 0.9, frames).astype(np.float32)
        intensity = corrected(waveform, rising, decibels)
        assert intensity[speech_activity(waveform) > 0].mean() == pytest.approx(expected, abs=0.02)


def test_strength_has_no_bound():
    """A former law bounded it: three quarters of shouts were above nine tenths of the bound."""
    steps = np.diff(intensity_of(state_of(np.arange(-20.0, 31.0, 5.0), RULE)))
    assert (steps > 0.02).all()
    loud, shout = intensity_of(state_of(np.array([7.0, 15.0]), RULE))
    assert shout / loud > 1.2


@pytest.mark.parametrize("label", LABELS)
def test_named_emotion_has_steps_and_a_bound_of_its_own(label):
    """Stronger voices stay stronger, and none reaches the bound."""
    place, strengths = LABELS.index(label), np.arange(-20.0, 31.0)
    decibels, most, slope = NAMED_DB[place], NAMED_MOST[place], NAMED_SLOPE[place]
    state = state_of(strengths, RULE)
    felt = felt_intensity(intensity_of(state), np.eye(len(LABELS))[[place] * len(state)], RULE)
    odds = slope * state + RULE.per_decibel * decibels
    np.testing.assert_allclose(felt, most / (1 + np.exp(-odds)), rtol=1e-5)
    assert (np.diff(felt) > 0).all() and felt.max() < most


@pytest.mark.parametrize("label", LABELS[1:])
def test_a_plain_reading_is_moderate_and_a_stronger_phrase_is_seen_to_be(label):
    """5 dB between two phrases, as actors have them, are a sixth more of any emotion; held smiles
    of one actor at two strengths differ by a quarter."""
    weights = np.eye(len(LABELS))[[LABELS.index(label)] * 3]
    voice = intensity_of(state_of(np.array([-2.0, 3.0, 8.0]), RULE))
    plain, normal, strong = felt_intensity(voice, weights, RULE)
    assert 0.5 < plain < 0.8 and normal > 1.15 * plain and strong > 1.15 * normal


def test_half_an_emotion_is_raised_less():
    voice, weights = np.full(2, USUAL), np.zeros((2, len(LABELS)))
    weights[:, LABELS.index("happy")] = 0.5, 1.0
    half, whole = felt_intensity(voice, weights, RULE)
    assert USUAL < half < whole


def test_strength_is_that_around_each_frame():
    flat, rising = np.full(90, 0.5, np.float32), np.linspace(-6, 6, 90, dtype=np.float32)
    change = corrected(voice(), flat, rising) - corrected(voice(), flat)
    assert change[12] < -0.05 and change[72] > 0.05


def test_mean_of_the_network_over_a_take_is_not_used():
    """The same standard deviation more of liveliness everywhere: z = 0 is 0.575, 1 is 0.817."""
    usual, more = corrected(voice(), np.full(90, 0.575)), corrected(voice(), np.full(90, 0.8172))
    np.testing.assert_allclose(usual[10:75], more[10:75], atol=1e-4)
    rising = np.linspace(0.3, 0.8, 90)
    assert np.ptp(corrected(voice(), rising)[10:75]) > np.ptp(usual[10:75]) + 0.04


@pytest.mark.parametrize("strength", [0.0, 15.0])
def test_louder_half_is_displayed_no_further_than_between_takes(strength):
    """9.5 dB within a phrase change less than as much of the strength of two takes; a shouted take
    has its display as well."""
    intensity = corrected(louder(), np.full(180, 0.5, np.float32), strength)
    within = intensity[110:160].mean() - intensity[20:70].mean()
    low, high = intensity_of(state_of(strength + np.array([-9.5, 9.5]) / 2, RULE))
    assert 0.02 < within < high - low


def test_display_has_no_mean_in_any_phrase():
    """Its mean would change the order of the phrases, whose strength is known."""
    pause = np.zeros(16_000, np.float32)
    waveform = np.concatenate((voice(), pause, 4 * voice(), pause))
    network = np.linspace(0.2, 0.9, 240).astype(np.float32)
    intensity, speaking = corrected(waveform, network), speech_activity(waveform) > 0
    found = runs(Phrases(speaking).inside)
    assert len(found) == 2
    for start, stop in found:
        spoken = intensity[start:stop][speaking[start:stop]]
        assert np.log(spoken / (MOST - spoken)).mean() == pytest.approx(-0.05, abs=0.015)


def test_fast_changes_are_smoothed_and_the_mean_stays():
    tremble = (0.5 + 0.2 * (-1.0) ** np.arange(90)).astype(np.float32)
    steady = corrected(voice(), np.full(90, 0.5, np.float32))
    smoothed = corrected(voice(), tremble)
    assert np.abs(np.diff(smoothed - steady)[8:79]).max() < 0.01
    assert smoothed[8:80].mean() == pytest.approx(steady[8:80].mean(), abs=0.04)


def test_hiss_and_wrong_octaves_do_not_move_the_tone():
    """A frame of noise between voiced ones, bright and of any pitch, counts as the voice around."""
    prosody = measure_prosody(voice(), 90)
    hiss = prosody._replace(
        pitch=np.where(np.arange(90) % 10 == 5, prosody.pitch + 14, prosody.pitch),
        bright=np.where(np.arange(90) % 10 == 7, 1e3 * prosody.dark, prosody.bright),
    )
    on = np.ones(90, bool)
    flat = np.full(90, 0.5, np.float32)
    clean, other = (voice_intensity(flat, p, on) for p in (prosody, hiss))
    np.testing.assert_allclose(other, clean, atol=0.02)


def test_state_is_held_in_a_pause_and_passes_to_the_next_phrase():
    """A former law let it fall to the faintest in a third of a second."""
    pause = np.zeros(3 * 16_000, np.float32)
    waveform = np.concatenate((voice(), pause, voice()))
    strength = np.repeat([-5.0, 5.0], 135)
    intensity = corrected(waveform, np.full(270, 0.5, np.float32), strength)
    before, after = intensity_of(state_of(np.array([-5.0, 5.0]), RULE))
    spoken = np.flatnonzero(speech_activity(waveform) > 0)
    last, first = spoken[spoken < 135][-1], spoken[spoken > 135][0]
    assert intensity[last + 15] == pytest.approx(before, abs=0.06)
    assert intensity[first - 15] == pytest.approx(after, abs=0.06)
    assert (np.diff(intensity[last + 20 : first - 20]) > 0).all()
    assert np.abs(np.diff(intensity)).max() < 0.05, "no seam beside speech"


def test_intensity_around_speech_is_that_of_its_state():
    silence = np.zeros(32_000, np.float32)
    intensity = corrected(np.concatenate((silence, voice(), silence)), np.full(210, 0.9), 8.0)
    expected = intensity_of(state_of(np.array(8.0), RULE))
    np.testing.assert_allclose(intensity[[0, 30, 180, 209]], expected, rtol=1e-3)


def test_intensity_without_speech_is_the_usual_one():
    """So that a keyed emotion is shown in silence as it is in a usual voice."""
    silence, network = np.zeros(48_000, np.float32), np.zeros(90, np.float32)
    np.testing.assert_allclose(corrected(silence, network), np.full(90, USUAL), rtol=1e-5)


@pytest.mark.parametrize(
    ("speaking", "expected"),
    [
        ("", []),
        ("0000", []),
        ("0110", [[1, 3]]),
        ("11" + "0" * 8 + "11", [[0, 12]]),
        ("11" + "0" * 9 + "11", [[0, 2], [11, 13]]),
    ],
)
def test_phrases_are_parted_by_pauses_of_more_than_a_quarter_of_a_second(speaking, expected):
    flags = np.array([c == "1" for c in speaking], bool)
    assert runs(Phrases(flags).inside).tolist() == expected
