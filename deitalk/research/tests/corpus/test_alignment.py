import itertools

import numpy as np
import pytest
import soundfile

from deitalk.errors import MissingError
from deitalk.postprocess.phones import PHONES, VOWELS
from deitalk.research.corpus import alignment
from deitalk.research.corpus.aligned_recordings import aligned_utterances
from deitalk.research.corpus.alignment import align, align_scored, text_words
from deitalk.research.corpus.engines import espeak, flite
from deitalk.research.corpus.recordings import Recording
from deitalk.research.corpus.utterance import SAMPLE_RATE, Phone

TEXT = "My brother bought a big apple, and Papa moved the piano."


@pytest.fixture(autouse=True)
def _needs_pocketsphinx():
    if reason := alignment.missing():
        pytest.skip(reason)


@pytest.fixture(scope="module")
def spoken():
    if reason := flite.missing():
        pytest.skip(reason)
    return flite.synthesise(TEXT, voice="slt")


@pytest.fixture(scope="module")
def aligned(spoken):
    return align(spoken.waveform, spoken.text)


def _named(phones, names):
    return [p for p in phones if p.name in names]


def test_words_of_a_text_are_lower_case_without_punctuation():
    assert text_words("Don’t -- it's 1,000 or 3.5, O'Neill's & co!") == [
        "don't", "it's", "1000", "or", "3.5", "o'neill's", "and", "co",
    ]  # fmt: skip
    assert text_words("end.Next,word ...") == ["end", "next", "word"]
    assert text_words("?!") == []


def test_known_times_are_recovered(spoken, aligned):
    """Bilabials within 30 ms, half of the consonants within 15 ms of flite's times."""
    truth = [p for p in spoken.phones if p.name != "SIL"]
    guess = [p for p in aligned if p.name != "SIL"]
    lips = ("P", "B", "M")
    pairs = list(zip(_named(truth, lips), _named(guess, lips), strict=True))
    assert len(pairs) == 9
    for known, aligned in pairs:
        assert aligned.name == known.name
        assert aligned.start == pytest.approx(known.start, abs=0.03)
    consonants = [[p for p in phones if p.name not in VOWELS] for phones in (truth, guess)]
    assert [p.name for p in consonants[0]] == [p.name for p in consonants[1]]
    errors = [abs(a.start - b.start) for a, b in zip(*consonants, strict=True)]
    assert np.median(errors) < 0.015


def test_phones_are_contiguous_and_cover_the_recording(spoken, aligned):
    found = aligned
    assert found[0].start == 0
    assert found[-1].end == pytest.approx(len(spoken.waveform) / SAMPLE_RATE)
    assert all(a.end == b.start for a, b in itertools.pairwise(found))
    assert {p.name for p in found} <= set(PHONES)


def test_shifted_speech_shifts_its_phones(spoken, aligned):
    quarter = np.zeros(SAMPLE_RATE // 4, np.float32)
    before = _named(aligned, ("P", "B"))
    after = _named(align(np.r_[quarter, spoken.waveform], spoken.text), ("P", "B"))
    shifts = [b.start - a.start for a, b in zip(before, after, strict=True)]
    assert shifts == pytest.approx([0.25] * len(shifts), abs=0.021)


def test_alignment_is_independent_of_earlier_recordings(spoken, aligned):
    align(np.random.default_rng(0).normal(0, 0.1, 20_000), "some noise")
    assert align(spoken.waveform, spoken.text) == aligned


def test_words_outside_the_dictionary_and_figures_are_aligned():
    if reason := espeak.missing():
        pytest.skip(reason)
    spoken = espeak.synthesise("The Zorbleps paid 58 blinkets.", voice="en-us")
    noise = np.random.default_rng(0).normal(0, 1e-3, len(spoken.waveform))
    found = align(spoken.waveform + noise, spoken.text)
    assert [p.name for p in _named(found, ("P", "B", "F"))] == ["B", "P", "P", "F", "F", "B"]


def test_words_are_spelled_without_espeak(monkeypatch):
    monkeypatch.setattr(espeak, "missing", lambda: "espeak: not here")
    alignment.pronunciation.cache_clear()
    assert alignment.pronunciation("quizmop") == tuple("K W IH Z M AA P".split())
    assert alignment.pronunciation("25") == tuple("T UW F AY V".split())
    assert alignment.pronunciation("ü") == ("AH",)
    assert alignment.reduced("about", ["AH", "B", "AW", "T"]) == ["AH", "B", "AW", "T"]
    alignment.pronunciation.cache_clear()


def test_reduced_vowels_follow_espeak():
    if reason := espeak.missing():
        pytest.skip(reason)
    assert alignment.reduced("about", ["AH", "B", "AW", "T"])[0] == "AX"
    assert alignment.reduced("butter", ["B", "AH", "T", "ER"])[1] == "AH"


def test_wrong_words_are_refused(spoken, monkeypatch):
    wrong = align_scored(spoken.waveform, "Fifty happy wolves sang through the quiet school hall.")
    assert wrong.reason is not None
    assert align_scored(spoken.waveform, spoken.text).reason is None
    monkeypatch.setattr(alignment, "align_scored", lambda *given: wrong)
    assert align(spoken.waveform, spoken.text) is None


def test_reasons_name_the_fault(spoken):
    assert "has no words" in align_scored(spoken.waveform, " ... ").reason
    assert "shorter than 0.1 s" in align_scored(np.zeros(100), "hello").reason
    short = [Phone(i * 0.03, (i + 1) * 0.03, "T") for i in range(9)]
    long = [Phone(0.27 + i * 0.1, 0.37 + i * 0.1, "AA") for i in range(30)]
    assert "9 phones in a row" in alignment.reason_against([*short, *long], -10)
    assert "82% of the phones last the minimum" in alignment.reason_against(
        [*short, *long[:2]], -10
    )
    assert "score -50.0 is below" in alignment.reason_against(long, -50)
    assert alignment.reason_against(long, -10) is None
    assert alignment.reason_against([Phone(0, 1, "SIL")], 0) == "no speech was found"


@pytest.fixture
def folder(tmp_path, spoken):
    soundfile.write(tmp_path / "good.wav", spoken.waveform, SAMPLE_RATE)
    soundfile.write(tmp_path / "wrong.wav", spoken.waveform, SAMPLE_RATE)
    (tmp_path / "broken.wav").write_bytes(b"nothing")
    return [
        Recording(tmp_path / "good.wav", TEXT, "me:1"),
        Recording(tmp_path / "wrong.wav", "Quiet wolves sang in fifty schools again.", "me:1"),
        Recording(tmp_path / "broken.wav", TEXT, "me:2"),
    ]


def test_bad_recordings_are_dropped_with_reasons(folder, tmp_path):
    reasons = []
    cache = tmp_path / "cache"
    report = lambda done, total, recording, reason: reasons.append((done, total, reason))  # noqa: E731
    (first,) = aligned_utterances(folder, workers=1, cache=cache, progress=report)
    assert [(done, total) for done, total, _ in reasons] == [(1, 3), (2, 3), (3, 3)]
    assert reasons[0][2] is None
    assert "does not fit the words" in reasons[1][2] or "minimum" in reasons[1][2]
    assert "not audio that can be read" in reasons[2][2]
    assert (first.engine, first.style, first.language) == ("recording", "neutral", "en")
    assert first.text == TEXT


def test_cache_gives_the_same_phones_without_the_aligner(folder, tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    (first,) = aligned_utterances(folder[:1], workers=1, cache=cache)
    monkeypatch.setattr(alignment, "_search", lambda *a: pytest.fail("aligned again"))
    (again,) = aligned_utterances(folder[:1], workers=1, cache=cache)
    assert [p.name for p in again.phones] == [p.name for p in first.phones]
    assert [p.end for p in again.phones] == pytest.approx([p.end for p in first.phones], abs=1e-5)


def test_damaged_cache_is_made_again(folder, tmp_path):
    cache = tmp_path / "cache"
    (first,) = aligned_utterances(folder[:1], workers=1, cache=cache)
    (entry,) = cache.glob("*.json")
    entry.write_text('{"phones": [[0, 1')
    (again,) = aligned_utterances(folder[:1], workers=1, cache=cache)
    assert len(again.phones) == len(first.phones)


def test_two_workers_give_the_same_as_one(folder):
    one = list(aligned_utterances(folder, workers=1))
    two = list(aligned_utterances(folder, workers=2))
    assert [u.phones for u in one] == [u.phones for u in two]


def test_missing_pocketsphinx_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pocketsphinx", None)
    with pytest.raises(MissingError, match=r"pip install 'deitalk\[align\]'"):
        align(np.zeros(16_000), "hello")
