"""Alignment: the best path by brute force, times and fits of made evidence, real sound."""

from itertools import pairwise, product

import numpy as np
import pytest

from deitalk import animate
from deitalk.errors import DeitalkError
from deitalk.pipeline.words.align import fit_words
from deitalk.pipeline.words.evidence import RATE, PhoneEvidence
from deitalk.pipeline.words.pronounced import Word
from deitalk.pipeline.words.transcript import Transcript
from deitalk.pipeline.words.viterbi import best_path
from deitalk.postprocess.phones import PHONES
from deitalk.research.corpus.engines import espeak

FLAT = np.full(len(PHONES), 1 / len(PHONES), np.float32)


def evidence(*phones, chance=0.9):
    """Logarithms for so many rows of each (phone, rows)."""
    rows = [np.full(len(PHONES), (1 - chance) / 43) for _, n in phones for _ in range(n)]
    names = [PHONES.index(name) for name, n in phones for _ in range(n)]
    for row, name in zip(rows, names, strict=True):
        row[name] = chance
    return np.log(np.array(rows)).astype(np.float32)


def transcript(*words):
    return Transcript(tuple(words), "")


@pytest.mark.parametrize("seed", range(4))
def test_path_is_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    found = rng.normal(size=(6, 3)).astype(np.float32)
    states, optional = np.array([0, 1, 2, 0, 1, 0]), np.array([1, 0, 0, 1, 0, 1], bool)
    path, score = best_path(found, states, optional)

    def allowed(steps):
        return (
            steps[0] in (0, 1)
            and steps[-1] in (4, 5)
            and all(b - a in (0, 1) or (b - a == 2 and optional[a + 1]) for a, b in pairwise(steps))
        )

    totals = {
        s: found[range(6), states[list(s)]].sum() for s in product(range(6), repeat=6) if allowed(s)
    }
    assert tuple(path) == max(totals, key=totals.get)
    assert score == pytest.approx(max(totals.values()))


def test_path_stays_in_its_band(monkeypatch):
    """A band of three states follows a chain of forty."""
    monkeypatch.setattr("deitalk.pipeline.words.viterbi.BAND", 3)
    states = np.arange(40) % 10 + 1
    found = np.full((80, 11), -5.0, np.float32)
    found[np.arange(80), np.repeat(states, 2)] = 0
    path, score = best_path(found, states, np.zeros(40, bool))
    assert score == 0 and path.tolist() == np.repeat(np.arange(40), 2).tolist()


def test_phones_have_the_times_of_the_sound():
    found = fit_words(
        evidence(("SIL", 12), ("M", 6), ("AY", 9), ("SIL", 3), ("B", 2), ("AY", 8), ("SIL", 20)),
        transcript(Word("my", ("M", "AY")), Word("buy", ("B", "AY"))),
        FLAT,
    )
    assert [(p.name, round(p.start * RATE), round(p.end * RATE)) for p in found.phones] == [
        ("SIL", 0, 12), ("M", 12, 18), ("AY", 18, 27), ("SIL", 27, 30), ("B", 30, 32),
        ("AY", 32, 40), ("SIL", 40, 60),
    ]  # fmt: skip
    assert found.fits and found.fit == 0 and found.line == "the words fit the sound (score 0.00)"
    assert [(w.text, w.start, w.end) for w in found.words] == [
        ("my", 0.2, 0.45),
        ("buy", 0.5, 40 / 60),
    ]


def test_a_word_that_is_not_there_is_reported_and_not_used():
    sound = evidence(("S", 20), ("IY", 20), ("T", 20), ("AA", 10), ("N", 20), ("UW", 20))
    words = (Word("see", ("S", "IY")), Word("top", ("P", "AA")), Word("new", ("N", "UW")))
    found = fit_words(sound, transcript(*words), FLAT)
    assert found.is_used and not found.fits
    assert "P" not in [p.name for p in found.known]
    assert {"S", "N", "UW"} <= {p.name for p in found.known}
    assert found.line.endswith("1 of 3 do not and are not used: top")


def test_wrong_words_are_not_used_at_all():
    sound = evidence(("S", 20), ("IY", 20), ("T", 20))
    found = fit_words(sound, transcript(Word("bomb", ("B", "AA", "M"))), FLAT)
    assert not found.is_used and found.known == ()
    assert "do not fit the sound" in found.line


def test_more_phones_than_rows_are_no_path():
    found = fit_words(evidence(("S", 3)), transcript(Word("a", ("AA",) * 9)), FLAT)
    assert found.words == () and not found.is_used and "(too many)" in found.line


@pytest.mark.parametrize("n_samples", [1, 160, 266, 267, 400])
def test_words_of_a_recording_shorter_than_a_spectrum_do_not_fit(n_samples, rng):
    sound = 0.1 * rng.standard_normal(n_samples)
    made = animate(sound, words="phones: M AY | P R AA", sample_rate=16_000)
    assert any("(too many)" in note for note in made.recording.warnings)


def test_given_times_choose_between_two_places():
    sound = evidence(("M", 10), ("AA", 40), ("M", 10), ("AA", 40))
    late = Word("ma", ("M", "AA"), 0.8, 1.6)
    for word, start in ((Word("ma", ("M", "AA"), 0.0, 0.8), 0.0), (late, 50 / 60)):
        found = fit_words(
            sound, transcript(Word("a", ("AA",)), word) if start else transcript(word), FLAT
        )
        assert found.words[-1].start == pytest.approx(start) and found.is_bounded
    away = Word("ma", ("M", "AA"), 30.0, 31.0)
    assert not fit_words(sound, transcript(away), FLAT).is_bounded


def test_evidence_is_a_softmax_of_rows_and_those_beside(rng, monkeypatch):
    """The same by hand, at once and in pieces; the ends repeat."""
    features = rng.normal(size=(10, 2)).astype(np.float32)
    weight = rng.normal(size=(len(PHONES), 6)).astype(np.float32)
    zeros = np.zeros(len(PHONES))
    found = PhoneEvidence(
        {"mean": [1, 2], "spread": [2, 4], "weight": weight, "bias": zeros, "prior": zeros}
    )
    scaled = (features - [1, 2]) / [2, 4]
    rows = np.pad(scaled, ((3, 3), (0, 0)), mode="edge")
    score = np.hstack([rows[:-6], rows[3:-3], rows[6:]]) @ weight.T
    expected = score - np.log(np.exp(score).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(found.log_probabilities(features), expected, atol=1e-5)
    monkeypatch.setattr("deitalk.pipeline.words.evidence.PIECE", 3)
    np.testing.assert_allclose(found.log_probabilities(features), expected, atol=1e-5)


@pytest.fixture(scope="module")
def line():
    return espeak.synthesise("Bob may bring my map.", voice="en-us")


def test_words_close_the_lips_of_a_spoken_line(line):
    plain = animate(line.waveform, sample_rate=16_000, life="off")
    known = animate(line.waveform, sample_rate=16_000, life="off", words=line.text)
    assert plain.words is None and known.words.fits
    names = [p.name for p in known.words.phones if p.name in "PBM"]
    assert names == [p.name for p in line.phones if p.name in "PBM"]
    lips = known.curves["CTRL_L_mouth_lipsTogetherD.ty"]
    for found, true in zip(
        [p for p in known.words.phones if p.name in "PBM"],
        [p for p in line.phones if p.name in "PBM"],
        strict=True,
    ):
        assert abs(found.start + found.end - true.start - true.end) / 2 < 0.08
        middle = round((found.start + found.end) * 15)
        assert lips[max(middle - 1, 0) : middle + 2].max() > 0.95
    assert known.acting.settings["words"] == line.text


def test_wrong_words_leave_the_curves_and_a_note(line):
    plain = animate(line.waveform, sample_rate=16_000, life="off")
    wrong = animate(
        line.waveform, sample_rate=16_000, life="off", words="Seven years since the ship sank"
    )
    np.testing.assert_array_equal(wrong.curves.values, plain.curves.values)
    assert wrong.recording.warnings[-1].startswith("the words do not fit the sound")


def test_words_without_rules_are_refused(line):
    with pytest.raises(DeitalkError, match="rules"):
        animate(line.waveform, sample_rate=16_000, rules=False, words="Bob")
