"""Layers of edits in `animate`: kept by takes, on another reading of the line by words or phones."""

import json
from dataclasses import replace
from difflib import SequenceMatcher
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import soundfile
import soxr

from deitalk import animate
from deitalk.acting import Acting
from deitalk.audio.frames import runs
from deitalk.audio.load import load_audio
from deitalk.data.edited import changes_of_take
from deitalk.pipeline import layer_sounds as module
from deitalk.pipeline.layer_sounds import heard_phones, with_recording
from deitalk.pipeline.layers import follow_recording, unused_notes
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.words.align import FittedWord, WordFit, align_words
from deitalk.pipeline.words.transcript import Transcript
from rig import read_curves, write_curves
from rig.curves.layer_files import read_layers
from rig.curves.layers import Edit, Layer, Sound
from rig.errors import ControlError
from tests.errors import one_line

SAMPLE = Path(__file__).parents[3] / "docs" / "samples" / "promise.flac"
BROW = "CTRL_L_brow_raiseOut.ty"
BUMP = Edit(BROW, ((2.0, 0, 0, 0), (2.25, 0.6, 0, 0), (2.5, 0, 0, 0)), "offset", (2.0, 2.5))
MODEL = "default"


def sample():
    return load_audio(SAMPLE).waveform[: 5 * 16_000]


@pytest.fixture(scope="module")
def plain():
    return animate(sample(), "happy", model=MODEL, sample_rate=16_000)


@pytest.fixture(scope="module")
def take(tmp_path_factory):
    acted = animate(sample(), "happy", model=MODEL, sample_rate=16_000, edit=Layer((BUMP,), "up"))
    return acted.save(tmp_path_factory.mktemp("take") / "take")


def test_an_edit_changes_the_curves_and_the_neutral_reading(plain, take):
    change = read_curves(take / "curves.json").values - plain.curves.values
    assert np.flatnonzero(np.abs(change).max(axis=0) > 1e-5).tolist() == [plain.curves.index(BROW)]
    assert change[67, plain.curves.index(BROW)] == pytest.approx(0.6, abs=0.01)
    assert not np.abs(change[:60]).max() > 1e-5
    neutral = read_curves(take / "neutral.npz").values - plain.neutral.values
    assert neutral[67].max() == pytest.approx(0.6, abs=0.01)


def test_a_take_keeps_its_layers_and_gives_itself_again(take):
    about = json.loads((take / "take.json").read_text())
    assert "layer-001.edit.json" in about["files"]
    (layer,) = read_layers(take)
    assert layer.name == "up" and layer.sound is not None and layer.phones
    (again,) = Acting.of(**about["settings"]).edit
    assert again == layer
    for edit in (take, str(take), layer, [layer.text], about["settings"]["edit"]):
        acted = animate(sample(), "happy", model=MODEL, sample_rate=16_000, edit=edit)
        assert np.abs(acted.curves.values - read_curves(take / "curves.json").values).max() < 1e-5
        assert acted.recording.warnings == ()


def test_a_take_that_is_written_over_loses_the_layers_it_no_longer_has(take, plain, tmp_path):
    folder = animate(
        sample(), model=MODEL, sample_rate=16_000, edit=[Layer((BUMP,)), Layer(())]
    ).save(tmp_path / "t")
    assert len(list(folder.glob("*.edit.json"))) == 2
    plain.save(folder, force=True)
    assert not list(folder.glob("*.edit.json"))


def test_another_seed_has_the_edit_at_the_same_frames(take, plain):
    def made(**more):
        return animate(sample(), "happy", model=MODEL, sample_rate=16_000, seed=5, **more)

    change = made(edit=take).curves.values - made().curves.values
    was = read_curves(take / "curves.json").values - plain.curves.values
    assert np.abs(change - was).max() < 0.01


def faster(share):
    return soxr.resample(sample(), 16_000, 16_000 / share).astype(np.float32)


@pytest.mark.parametrize(
    ("other", "place"),
    [
        (lambda: np.concatenate((np.zeros(9_600, np.float32), sample())), lambda t: t + 0.6),
        (lambda: sample()[8_000:], lambda t: t - 0.5),
        (lambda: faster(1.12), lambda t: t / 1.12),
        (lambda: faster(0.9), lambda t: t / 0.9),
    ],
)
def test_on_another_recording_an_edit_follows_the_phones(take, other, place):
    (layer,), (note,) = follow_recording(read_layers(take), Speech.of(other()))
    assert "follows its phones" in note
    found = np.array(layer.edits[0].span) - [place(time) for time in BUMP.span]
    assert np.abs(found).max() <= 2 / 30


SAID = (
    "Maybe you believe me. But mother, Bob promised everybody a piece of that perfect apple pie! "
    "Well, what a wonderful evening this could become."
)
VOICES = ((None, 165, 50), ("f3", 140, 70), ("m3", 190, 35))


@pytest.fixture(scope="module")
def readings():
    """One line by three voices, with the exact times of its phones."""
    from deitalk.research.corpus.engines import espeak

    if espeak.missing():
        pytest.skip("needs espeak-ng")
    return [
        espeak.synthesise(SAID, variant=name, rate=rate, pitch=pitch)
        for name, rate, pitch in VOICES
    ]


def times_of_words(reading, transcript):
    """Start and end of each word by the phones of the voice; None where it says others."""
    phones = [phone for phone in reading.phones if phone.name != "SIL"]
    chain = [(k, name) for k, word in enumerate(transcript.words) for name in word.phones]
    names = [phone.name for phone in phones]
    blocks = SequenceMatcher(None, [name for _, name in chain], names, autojunk=False)
    place = {b.a + n: b.b + n for b in blocks.get_matching_blocks() for n in range(b.size)}
    found = {}
    for k in range(len(transcript.words)):
        at = [n for n, (word, _) in enumerate(chain) if word == k]
        if at[0] in place and at[-1] in place:
            found[k] = (phones[place[at[0]]].start, phones[place[at[-1]]].end)
    return found


@pytest.mark.parametrize("by", ["words", "phones"])
def test_edits_stay_at_their_words_on_another_reading_of_the_line(readings, by):
    """An edit of each word, of each reading on each other: within two frames of the word there."""
    transcript, off = Transcript.of(SAID), []
    speech = [Speech.of(reading.waveform) for reading in readings]
    known = [align_words(one, transcript) if by == "words" else None for one in speech]
    said = [times_of_words(reading, transcript) for reading in readings]
    assert min(map(len, said)) >= 20
    for a, b in permutations(range(len(VOICES)), 2):
        both = [k for k in said[a] if k in said[b]]
        edits = tuple(Edit(BROW, ((s, 0.3, 0, 0), (e, 0, 0, 0)), "offset", (s, e))
                      for s, e in (said[a][k] for k in both))  # fmt: skip
        (layer,) = with_recording([Layer(edits)], speech[a], known[a])
        (moved,), (note,) = follow_recording([layer], speech[b], known[b])
        assert f"follows its {by}" in note and len(moved.edits) == len(both)
        wanted = np.array([said[b][k] for k in both])
        spans = np.array([edit.span for edit in moved.edits])
        off += np.abs(np.round(30 * spans) - np.round(30 * wanted)).ravel().tolist()
    assert max(off) <= 2 and np.mean(off) < 0.5


NOSE = "CTRL_L_nose.ty"


@pytest.mark.parametrize("by", ["words", "phones"])
@pytest.mark.parametrize(("old", "new"), [(1, 2), (2, 1)], ids=["quicker", "slower"])
def test_another_seed_and_reading_have_the_edits_at_the_same_words(
    readings, by, old, new, tmp_path
):
    """A take is edited at every third word, and made again of another voice with another seed."""
    said = [times_of_words(reading, Transcript.of(SAID)) for reading in readings]
    places = sorted(said[old].keys() & said[new].keys())[1::3]
    spoken = {"words": SAID} if by == "words" else {}

    def made(k, **more):
        return animate(readings[k].waveform, sample_rate=16_000, **spoken, **more)

    take = made(old, seed=3).save(tmp_path / "take")
    base = read_curves(take / "curves.json")
    values = base.values.copy()
    for k in places:
        first, last = (round(30 * second) for second in said[old][k])
        values[first : last + 1, base.index(NOSE)] = 0.9
    write_curves(tmp_path / "edited.csv", replace(base, values=values))
    layer = changes_of_take(tmp_path / "edited.csv", take).layer
    change = made(new, seed=9, edit=layer).curves[NOSE] - made(new, seed=9).curves[NOSE]
    found = runs(change > 0.3)
    wanted = [[round(30 * second) for second in said[new][k]] for k in places]
    assert len(places) >= 6 and len(found) == len(places)
    assert np.abs(found - [0, 1] - wanted).max() <= 2


def words(*rows):
    return WordFit(tuple(FittedWord(text, a, b, -0.1) for text, a, b in rows), (), -0.1)


def test_words_that_both_know_go_before_phones(take):
    (layer,) = read_layers(take)
    known = replace(
        layer, words=(("My", 1.0, 1.4), ("big", 1.4, 2.0), ("promise", 2.0, 2.5), ("is", 2.5, 3.0))
    )
    new = words(("my", 0.5, 1.0), ("big", 1.0, 1.2), ("Promise", 1.2, 2.2), ("was", 2.2, 2.4))
    sound = Speech.of(sample()[::-1].copy())
    (moved,), (note,) = follow_recording([known], sound, new)
    assert "follows its words" in note and moved.edits[0].span == pytest.approx((1.2, 2.2))
    without = words(("my", 0.5, 1.0), ("big", 1.0, 1.2), ("is", 1.2, 2.4))
    (moved,), (note,) = follow_recording([known], sound, without)
    assert moved.edits == () and f"not said here: {BROW} at 2.00 s" in note


def test_a_sound_of_something_else_keeps_the_times_and_says_so(take):
    noise = np.random.default_rng(0).normal(0, 0.1, 48_000).astype(np.float32)
    (layer,), (note,) = follow_recording(read_layers(take), Speech.of(noise))
    assert layer.edits[0] == BUMP and "its times are kept" in note


UNUSED = {
    "after the end": (((7.0, 0, 0, 0), (9.0, 1, 0, 0)), "reach beyond the recording"),
    "over the end": (((4.0, 0, 0, 0), (9.0, 1, 0, 0)), "reach beyond the recording"),
    "to the end": (((4.0, 0, 0, 0), (5.1, 1, 0, 0)), ""),
}


@pytest.mark.parametrize("case", UNUSED)
def test_what_lies_outside_of_the_recording_is_said(plain, case):
    keys, said = UNUSED[case]
    layer = Layer((Edit(BROW, keys, "offset", (keys[0][0], keys[-1][0])),))
    assert said in " | ".join(unused_notes([layer], plain.curves))
    assert said or not list(unused_notes([layer], plain.curves))


def test_layers_without_edits_are_named(plain):
    (note,) = unused_notes([Layer((), "fixes")], plain.curves)
    assert note.endswith("hold no edits: fixes")


def test_a_layer_without_a_sound_keeps_its_times(take):
    layer = Layer((BUMP,))
    assert follow_recording([layer], Speech.of(sample())) == ((layer,), ())


def test_without_torch_a_layer_knows_its_levels_alone(monkeypatch):
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    speech = Speech.of(sample())
    (layer,) = with_recording([Layer((BUMP,))], speech)
    assert layer.phones == () and layer.sound == Sound.of(speech.waveform, 16_000)
    (kept,), (note,) = follow_recording([layer], Speech.of(sample()[8_000:]))
    assert kept == layer and "knows no words or phones" in note


def test_words_are_named_in_the_edits_of_a_take():
    fit = words(("Well", 1.0, 1.9), ("what", 1.9, 2.2), ("a", 2.2, 2.3), ("wonder", 2.6, 3.0))
    (layer,) = with_recording([Layer((BUMP,))], Speech.of(sample()), fit)
    assert layer.edits[0].words == "what a" and layer.words[1] == ("what", 1.9, 2.2)


def test_silence_has_no_phones():
    assert heard_phones(Speech.of(np.zeros(16_000, np.float32))) == ()


def test_a_target_that_the_model_lacks_is_refused_before_the_network(tmp_path):
    soundfile.write(tmp_path / "a.wav", sample(), 16_000)
    with one_line(ControlError, "CTRL_C_jaws.ty"):
        animate(tmp_path / "a.wav", edit=Layer((replace(BUMP, target="CTRL_C_jaws.ty"),)))


def test_edits_of_a_head_that_does_not_move_are_said():
    edit = replace(BUMP, target="head.yaw")
    acted = animate(sample(), model=MODEL, sample_rate=16_000, life="off", edit=Layer((edit,)))
    assert any("edits of head.yaw are not used" in note for note in acted.recording.warnings)
