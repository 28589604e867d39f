import functools
import itertools
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from deitalk.emotions import EMOTIONS
from deitalk.errors import ConfigError, DataError, MissingError
from deitalk.pipeline.words import espeak as library
from deitalk.postprocess.phones import BILABIALS, PHONES
from deitalk.research.corpus import synthesis as sources
from deitalk.research.corpus.engines import (
    ENGINES,
    available_engines,
    espeak,
    festival,
    flite,
)
from deitalk.research.corpus.synthesis import STYLE, synthetic_utterances
from deitalk.research.corpus.utterance import SAMPLE_RATE


@pytest.fixture(params=ENGINES)
def engine(request, monkeypatch):
    if reason := available_engines()[request.param]:
        pytest.skip(reason)
    monkeypatch.setattr(sources, "FESTIVAL_BATCH", 5)
    return request.param


WHICH = """
from deitalk.research.corpus.engines.espeak_library import Synthesiser
found = Synthesiser()
print(found._library._name, found.data_folder(), found.has_voice("en-us+f1"))
"""


def espeak_in_a_new_process(prelude: str = "") -> str:
    done = subprocess.run(
        [sys.executable, "-c", prelude + WHICH], capture_output=True, text=True, timeout=300
    )
    return done.stdout + done.stderr


def test_espeak_of_the_package_is_preferred_to_the_system():
    pytest.importorskip("espeakng_loader")
    library, data, has_voice = espeak_in_a_new_process().split()
    assert Path(library).parent == Path(data).parent == package_of("espeakng_loader")
    assert has_voice == "True"


def test_espeak_of_the_system_is_used_without_the_package():
    output = espeak_in_a_new_process("import sys; sys.modules['espeakng_loader'] = None\n")
    if "MissingError" in output:
        assert output.strip().endswith("pip install espeakng-loader")
    else:
        assert output.startswith("libespeak-ng.so.1")


def test_espeak_works_with_a_long_data_path(tmp_path):
    package = package_of("espeakng_loader")
    folder = tmp_path.joinpath(*["long" * 20] * 3)
    folder.mkdir(parents=True)
    (folder / "espeak-ng-data").symlink_to(package / "espeak-ng-data")
    elsewhere = f"import espeakng_loader; espeakng_loader.get_data_path = lambda: {str(folder)!r}"
    output = espeak_in_a_new_process(f"{elsewhere} + '/espeak-ng-data'\n")
    assert output.endswith("True\n"), output


def package_of(name: str) -> Path:
    return Path(find_spec(name).origin).parent


@pytest.fixture
def needs_espeak():
    if reason := espeak.missing():
        pytest.skip(reason)


@pytest.fixture
def needs_flite():
    if reason := flite.missing():
        pytest.skip(reason)


def _some(engine, seconds, seed=1):
    return list(synthetic_utterances(engine, seconds, np.random.default_rng(seed)))


@functools.cache
def _spoken(engine):
    return _some(engine, 20)


def test_utterances_are_labelled_from_end_to_end(engine):
    utterances = _spoken(engine)
    assert sum(u.duration_seconds for u in utterances) >= 20
    for u in utterances:
        assert u.waveform.dtype == np.float32
        assert 0.05 < np.abs(u.waveform).max() <= 1
        assert u.phones[0].start == 0
        assert u.phones[-1].end == pytest.approx(len(u.waveform) / SAMPLE_RATE)
        assert all(a.end == b.start for a, b in itertools.pairwise(u.phones))
        assert all(p.end > p.start and p.name in PHONES for p in u.phones)
        assert u.engine == engine
        assert u.speaker.startswith(f"{engine}:")
        assert u.style in EMOTIONS


def test_silences_are_quiet_and_vowels_are_not(engine):
    """The labels are in time: a shift of 100 ms would reduce the difference."""
    loud, quiet = [], []
    for u in _spoken(engine):
        for p in u.phones:
            middle = u.waveform[int(p.start * SAMPLE_RATE) : int(p.end * SAMPLE_RATE)]
            if p.name in ("AA", "AO", "EH", "AE"):
                loud.append(np.sqrt(np.mean(middle**2)))
            if p.name == "SIL" and p.end - p.start > 0.1:
                quiet.append(np.sqrt(np.mean(middle**2)))
    assert np.median(loud) > 10 * np.median(quiet)


def test_same_seed_gives_the_same_bytes(engine):
    first, second = _spoken(engine), _some(engine, 20)
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        assert a.waveform.tobytes() == b.waveform.tobytes()
        assert (a.phones, a.text, a.speaker) == (b.phones, b.text, b.speaker)
    others = _some(engine, 6, seed=2)
    assert [u.text for u in others] != [u.text for u in first[: len(others)]]


def test_utterance_does_not_depend_on_earlier_ones(needs_espeak):
    alone = espeak.synthesise("My papa bought a map.", voice="en-us", variant="f2")
    espeak.synthesise("Something else!", voice="en-us", variant="whisper", pitch=90)
    again = espeak.synthesise("My papa bought a map.", voice="en-us", variant="f2")
    assert alone.waveform.tobytes() == again.waveform.tobytes()


def test_styles_are_the_five_emotions_and_neutral_has_unit_factors():
    assert tuple(STYLE) == EMOTIONS
    assert vars(STYLE["neutral"]) == {"rate": 1, "pitch": 1, "pitch_range": 1, "volume": 1}


def test_rate_changes_the_duration(needs_espeak, needs_flite):
    text = "My brother moved the piano."
    slow, fast = (espeak.synthesise(text, rate=rate).duration_seconds for rate in (100, 200))
    assert slow > 1.5 * fast
    slow, fast = (flite.synthesise(text, stretch=s).duration_seconds for s in (1.4, 0.7))
    assert slow == pytest.approx(2 * fast, rel=0.05)


def test_ssml_rate_is_applied(needs_espeak):
    plain = espeak.synthesise("Oh no.")
    held = espeak.synthesise('<speak>Oh <prosody rate="35%">no.</prosody></speak>', ssml=True)
    assert held.duration_seconds > plain.duration_seconds + 0.1
    assert [p.name for p in held.phones if p.name != "SIL"] == ["OW", "N", "OW"]


def test_voiceless_closures_are_silent(needs_espeak):
    """The engine's event is at the burst; with closures the first half of each P, T, K is silent."""
    spoken = espeak.synthesise("A puppy took a packet to papa at the top of a cup.")
    levels = []
    for before, p in itertools.pairwise(spoken.phones):
        if p.name in ("P", "T", "K") and before.name != "SIL":
            first = int(p.start * SAMPLE_RATE)
            closure = spoken.waveform[first + 80 : first + int((p.end - p.start) * SAMPLE_RATE / 3)]
            levels.append(np.abs(closure).max())
    assert len(levels) >= 8
    assert np.mean(np.array(levels) < 0.01) >= 0.8


def _vowel_gap_burst():
    """1 kHz hops of 2 ms: 100 ms tone, 60 ms silence, 40 ms burst; the event is at the burst."""
    waveform = np.r_[np.full(100, 0.5), np.zeros(60), np.full(40, 0.3)]
    return waveform, 1000


def test_closure_moves_back_over_the_silent_run():
    waveform, rate = _vowel_gap_burst()
    segments = [(0.0, 0.160, "AA"), (0.160, 0.2, "P")]
    fixed = espeak.with_closures(waveform, rate, segments)
    assert fixed == [(0.0, pytest.approx(0.100), "AA"), (pytest.approx(0.100), 0.2, "P")]


def test_closure_keeps_other_phones_and_pauses():
    waveform, rate = _vowel_gap_burst()
    fricative = [(0.0, 0.160, "AA"), (0.160, 0.2, "F")]
    assert espeak.with_closures(waveform, rate, fricative) == fricative
    after_pause = [(0.0, 0.1, "AA"), (0.1, 0.160, "SIL"), (0.160, 0.2, "P")]
    fixed = espeak.with_closures(waveform, rate, after_pause, longest_after_pause_seconds=0.04)
    assert fixed[2] == (pytest.approx(0.12), 0.2, "P")
    assert fixed[1] == (0.1, pytest.approx(0.12), "SIL")


def test_fused_events_are_divided():
    waveform = np.full(1000, 0.1)
    segments = espeak.event_segments(waveform, 1000, [(0, "p"), (100, "ɛɹ"), (500, "")], "en")
    assert segments == [
        (0.0, 0.1, "P"),
        (0.1, pytest.approx(0.36), "EH"),
        (pytest.approx(0.36), 1.0, "R"),  # an unnamed event with sound lengthens the phone before
    ]


def test_flite_listing_of_two_utterances_is_continuous():
    listing = "pau:0.2 hh:0.3 ax:0.4 \npau:0.1 b:0.25\n"
    assert flite.parse_durations(listing) == [
        (0.0, 0.2, "SIL"),
        (0.2, 0.3, "HH"),
        (0.3, 0.4, "AX"),
        (0.4, 0.5, "SIL"),
        (0.5, 0.65, "B"),
    ]


def test_festival_labels_are_parsed():
    assert festival.parse_labels("#\n0.165 100 pau\n0.255 100 hh\n") == [
        (0.0, 0.165, "SIL"),
        (0.165, 0.255, "HH"),
    ]


def test_festival_batch_accepts_quotes_and_empty_texts():
    if "slt" not in festival.voices():
        pytest.skip("needs the festival voice slt; apt-get install festival festvox-us-slt-hts")
    jobs = [festival.Job('He said "bob \\ up" (twice).'), festival.Job("..."), festival.Job("Bob.")]
    first, second, third = festival.synthesise_batch(jobs)
    assert second is None
    assert sum(p.name in BILABIALS for p in first.phones) == 3
    assert [p.name for p in third.phones if p.name != "SIL"] == ["B", "AA", "B"]


def test_every_foreign_voice_has_bilabials(needs_espeak):
    output = {}
    for u in _some("espeak", 240):
        names = {p.name for p in u.phones}
        output.setdefault(u.language, set()).update(names)
    assert len(output) >= 6
    assert all(names & BILABIALS for names in output.values())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"voice": "klingonese"}, "voice='klingonese' is not an espeak-ng voice"),
        ({"variant": "nobody"}, "variant='nobody' is not installed; .* f1, f2"),
        ({"rate": 20}, "rate=20 must lie between 80 and 450"),
        ({"pitch": 130}, "pitch=130 must lie between 0 and 100"),
    ],
)
def test_espeak_errors_name_the_fault(needs_espeak, arguments, message):
    with pytest.raises(ConfigError, match=message):
        espeak.synthesise("Hello.", **arguments)


def test_espeak_refuses_text_without_speech(needs_espeak):
    with pytest.raises(DataError, match=r"text=' \. ' gives no speech in the espeak-ng voice"):
        espeak.synthesise(" . ")


def test_flite_refuses_text_without_speech(needs_flite):
    with pytest.raises(DataError, match="text='' "):
        flite.synthesise("")


def test_flite_and_festival_errors_name_the_fault(needs_flite):
    with pytest.raises(ConfigError, match="voice='bob' is not a flite voice; known: slt"):
        flite.synthesise("Hello.", voice="bob")
    with pytest.raises(ConfigError, match="stretch=9 must lie between"):
        flite.synthesise("Hello.", stretch=9)


def test_sources_refuse_unknown_engines_and_durations():
    with pytest.raises(ConfigError, match="engine='mbrola' must be one of espeak, flite, festival"):
        synthetic_utterances("mbrola", 10, np.random.default_rng(0))
    with pytest.raises(ConfigError, match="seconds=0 must be greater than 0"):
        synthetic_utterances("espeak", 0, np.random.default_rng(0))


def test_missing_espeak_names_its_package(monkeypatch):
    monkeypatch.setattr(library, "_packaged", list)
    monkeypatch.setattr(library, "SYSTEM_LIBRARY", "libnothing.so.9")
    with pytest.raises(MissingError, match="pip install espeakng-loader"):
        library.Library()


def test_missing_programs_name_their_package(monkeypatch):
    monkeypatch.setattr(flite.shutil, "which", lambda program: None)
    reasons = available_engines()
    assert "apt-get install flite" in reasons["flite"]
    assert "apt-get install festival festvox" in reasons["festival"]
    with pytest.raises(MissingError, match="apt-get install flite"):
        synthetic_utterances("flite", 10, np.random.default_rng(0))
    with pytest.raises(MissingError, match="apt-get install festival"):
        festival.synthesise_batch([festival.Job("Hello.")])
