"""Dominance functions and contacts in the articulation of phrases."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deitalk.postprocess.phones import BILABIALS, LABIODENTALS, PHONES, VOWELS
from deitalk.research.corpus.articulation import (
    BITE,
    CHANNELS,
    DIPHTHONGS,
    FUNNEL,
    HISS,
    JAW,
    LOWER,
    OUT,
    PURSE,
    STRETCH,
    TIP,
    TOGETHER,
    UPPER,
    articulate,
    targets,
)
from deitalk.research.corpus.utterance import Phone


def phones_of(names: str, seconds: float = 0.09, silence: float = 0.5) -> list[Phone]:
    """Phones of equal length, with silence before and after."""
    phones, now = [Phone(0.0, silence, "SIL")], silence
    for name in names.split():
        phones.append(Phone(now, now + seconds, name))
        now += seconds
    return [*phones, Phone(now, now + silence, "SIL")]


def channels_of(
    names: str, seconds: float = 0.09, fps: float = 30.0
) -> tuple[np.ndarray, list[Phone]]:
    phones = phones_of(names, seconds)
    return articulate(phones, int(np.ceil(phones[-1].end * fps)), fps), phones


def longest_run(mask: np.ndarray) -> int:
    best = run = 0
    for value in mask:
        run = run + 1 if value else 0
        best = max(best, run)
    return best


def test_every_phone_has_targets_or_is_a_diphthong_of_phones_that_have():
    for name in PHONES:
        assert name in targets() or name in DIPHTHONGS, name
    assert set(targets()) & set(DIPHTHONGS) == {"OW"}, "OW glides from its own row to UW"
    assert set(targets()) <= set(PHONES)
    for first, second, share in DIPHTHONGS.values():
        assert {first, second} <= set(targets()) and 0 < share < 1


def test_targets_are_shares_and_only_lip_phones_shut_the_lips():
    for name, target in targets().items():
        assert target.shape == (len(CHANNELS),) and (target >= 0).all() and (target <= 1).all()
        assert (target[TOGETHER] == 1) == (name in BILABIALS), name
        assert (target[BITE] >= 0.9) == (name in LABIODENTALS), name
    assert targets()["AA"][JAW] > targets()["IY"][JAW]
    assert targets()["UW"][PURSE] > 0.5 > targets()["IY"][PURSE]
    assert targets()["TH"][OUT] == 1 and targets()["L"][TIP] > 0.9 and targets()["S"][HISS] == 1


@pytest.mark.parametrize("name", sorted(BILABIALS))
@pytest.mark.parametrize("seconds", [0.04, 0.08])
@pytest.mark.parametrize("offset", [0.0, 0.009, 0.02])
def test_a_bilabial_is_a_contact_of_two_frames_with_a_shut_jaw(name, seconds, offset):
    begin = 0.5 + offset
    phones = [
        Phone(0.0, 0.3, "SIL"),
        Phone(0.3, begin, "AA"),
        Phone(begin, begin + seconds, name),
        Phone(begin + seconds, 0.9, "AA"),
    ]
    channels = articulate(phones, 27, 30.0)
    shut = channels[:, TOGETHER] >= 0.9
    assert longest_run(shut) >= 2
    assert channels[shut, JAW].max() <= 0.2 + 1e-9
    assert channels[shut][:, [UPPER, LOWER]].max() < 0.1
    away = np.abs(np.arange(27) / 30 - begin) > 0.2
    assert channels[away, TOGETHER].max() < 0.1, "vowels leave the lips open"


@pytest.mark.parametrize("name", sorted(LABIODENTALS))
def test_labiodental_is_a_bite_with_open_lips(name):
    channels, _ = channels_of(f"AA {name} AA", 0.07)
    bitten = channels[:, BITE] >= 0.9
    assert longest_run(bitten) >= 2
    assert channels[bitten, TOGETHER].max() < 0.1 and channels[bitten, JAW].max() <= 0.3


@pytest.mark.parametrize("pair", ["M F", "V M", "P F", "F B", "V P", "M V"])
@pytest.mark.parametrize("seconds", [0.04, 0.07])
def test_neighbouring_contacts_of_two_kinds_are_both_kept(pair, seconds):
    # "comfort", "of my": both contacts must be present.
    channels, _ = channels_of(f"AH {pair} AH", seconds)
    assert longest_run(channels[:, TOGETHER] >= 0.9) >= 2
    assert longest_run(channels[:, BITE] >= 0.9) >= 1
    assert not ((channels[:, TOGETHER] > 0.6) & (channels[:, BITE] > 0.6)).any()


def test_silence_is_exactly_rest():
    assert not articulate([Phone(0.0, 2.0, "SIL")], 60, 30.0).any()
    assert not articulate([], 10, 30.0).any()
    channels, phones = channels_of("B AA T", silence := 0.09)
    times = np.arange(len(channels)) / 30
    assert channels[times > phones[-1].start + 0.4].max() < 0.02
    assert silence and channels[0].max() < 0.02


def test_rounding_begins_in_the_consonants_before_a_rounded_vowel():
    rounded, phones = channels_of("S T UW", 0.08, fps=100)
    spread, _ = channels_of("S T IY", 0.08, fps=100)
    vowel = phones[3].start
    early = round((vowel - 0.1) * 100)
    lips = rounded[:, [FUNNEL, PURSE]].sum(axis=1)
    assert lips[early] > 0.25 * lips.max(), "the lips round 100 ms before /u/ sounds"
    assert lips[early] > 10 * spread[early, [FUNNEL, PURSE]].sum()
    reached = np.flatnonzero(lips > 0.1 * lips.max())[0] / 100
    assert 0.1 <= vowel - reached <= 0.35, "anticipation of about 200 ms"
    assert spread[round(vowel * 100) + 4, STRETCH] > 0.4


def test_a_closure_begins_later_than_rounding():
    shut, phones = channels_of("AA AA M AA", 0.1, fps=100)
    onset = np.flatnonzero(shut[:, TOGETHER] > 0.1)[0] / 100
    assert 0.0 < phones[3].start - onset < 0.12


def test_a_diphthong_moves_from_its_first_target_to_its_second():
    channels, phones = channels_of("AY", 0.3, fps=100)
    start, end = phones[1].start, phones[1].end
    early, late = (channels[round((start + share * (end - start)) * 100)] for share in (0.3, 0.9))
    assert early[JAW] > 0.7 and late[JAW] < 0.4
    assert late[STRETCH] > 0.5 > early[STRETCH]


def test_stress_opens_only_the_jaw():
    phones = phones_of("T AA T")
    plain = articulate(phones, 40, 30.0)
    loud = articulate(phones, 40, 30.0, np.array([1, 1, 1.2, 1, 1]))
    assert loud[:, JAW].max() > 1.1 * plain[:, JAW].max()
    others = [i for i in range(len(CHANNELS)) if i != JAW]
    np.testing.assert_array_equal(plain[:, others], loud[:, others])


def test_frame_times_follow_the_frame_rate():
    fast, _ = channels_of("M AA F UW S", fps=120.0)
    slow, _ = channels_of("M AA F UW S", fps=30.0)
    np.testing.assert_allclose(fast[::4][: len(slow)], slow, atol=1e-12)


phone_strings = st.lists(
    st.tuples(st.sampled_from(PHONES), st.floats(0.0, 0.4)), min_size=1, max_size=30
)


@settings(max_examples=60, deadline=None)
@given(phone_strings)
def test_any_string_of_phones_stays_in_range_and_keeps_its_bilabials(drawn):
    phones, now = [], 0.2
    for name, seconds in drawn:
        phones.append(Phone(now, now + seconds, name))
        now += seconds
    channels = articulate(phones, int(now * 60) + 30, 60.0)
    assert np.isfinite(channels).all() and channels.min() >= 0 and channels.max() <= 1
    for i, phone in enumerate(phones):
        if phone.name in BILABIALS and phone.end - phone.start >= 0.04:
            near = {p.name for p in phones[max(i - 3, 0) : i + 4]} & LABIODENTALS
            first, last = int((phone.start - 0.06) * 60), int((phone.end + 0.06) * 60) + 2
            held = longest_run(channels[max(first, 0) : last, TOGETHER] >= 0.9)
            assert held >= (3 if near else 4), "two frames at 30 per second are four at 60"


def test_vowels_open_more_than_the_stops_between_them():
    channels, phones = channels_of("T AA T AA T", 0.12, fps=100)
    jaw = [channels[round((p.start + p.end) * 50), JAW] for p in phones[1:-1]]
    assert min(jaw[1], jaw[3]) > 1.3 * max(jaw[0], jaw[2], jaw[4])
    assert VOWELS.isdisjoint(BILABIALS | LABIODENTALS)
