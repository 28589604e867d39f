"""Range and speed of heads against measured ones, on a made folder and the real one."""

import csv
import json

import numpy as np
import pytest
import soundfile

from deitalk.errors import DataError
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.words.align import FittedWord, WordFit
from deitalk.postprocess.known_phones import KnownPhone
from deitalk.research.corpus.engines import espeak
from deitalk.research.evaluation.head import TOLERANCE, as_markdown, evaluate_head, main, ratios
from deitalk.research.evaluation.nods import find_nods, measure_nods
from deitalk.research.evaluation.stress import stress_track, stressed_times, stressed_vowel
from tests.conftest import SHARED

SECONDS = 2.0


def turn(times):
    """Yaw of 3 degrees and pitch of 1 at 1 Hz, roll of 2 at half that."""
    return np.stack([3 * np.sin(2 * np.pi * times), np.cos(2 * np.pi * times),
                     2 * np.sin(np.pi * times)], axis=1)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("heads")
    with (folder / "clips.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["clip", "speaker"])
        for number in range(4):
            name = f"c{number}"
            writer.writerow([name, "anna"])
            times = (np.arange(int(SECONDS * 25)) + 0.5) / 25
            np.savez(folder / f"{name}.npz", pose=turn(times).astype(np.float16))
            time = np.arange(int(SECONDS * 16_000)) / 16_000
            sound = 0.2 * np.sin(2 * np.pi * 150 * time) * (0.6 + 0.4 * np.sin(2 * np.pi * time))
            soundfile.write(folder / f"{name}.wav", sound, 16_000)
    (folder / "columns.json").write_text(json.dumps({"columns": []}))
    return folder


@pytest.mark.parametrize("gain", [1.0, 2.0])
def test_ratios_are_those_of_the_motion(folder, gain):
    def mover(voice, drawing):
        return gain * turn(np.arange(voice.n_frames) / 30)

    report = evaluate_head(folder, mover=mover)
    np.testing.assert_allclose(ratios(report), gain, rtol=0.08)
    np.testing.assert_allclose(report["measured range"][0], 2 * 2.7, rtol=0.1)
    assert report["measured correlation"][0] == pytest.approx(report["correlation"][0], abs=0.1)
    assert "| range of yaw, ° |" in as_markdown(report)


def test_nods_are_found_where_the_head_is_lowest():
    """Dips of 1, 2 and .1 degrees at 2, 4 and 5 s, with a rise to 3 between the first two."""
    times = np.arange(0, 8, 0.04)
    marks = [(0, 0), (2, -1), (3, 3), (4, 1), (4.6, 1.4), (5, 1.3), (8, 3)]
    pitch = np.interp(times, *np.transpose(marks))
    found, depths = find_nods(pitch, 25)
    np.testing.assert_allclose(found, [2, 4], atol=0.1)
    np.testing.assert_allclose(depths, [1, 2], atol=0.25)  # the tips are smoothed


def test_even_nods_have_no_spread_and_uneven_ones_have():
    times = np.arange(0, 8, 0.04)
    even = np.cos(2 * np.pi * times)
    rate, depth, *spreads = measure_nods([even, even], 25)
    assert rate == pytest.approx(1, abs=0.13) and depth == pytest.approx(1.9, abs=0.1)
    assert max(spreads) < 0.05
    uneven = even * np.exp(np.sin(2 * np.pi * times / 5))
    assert measure_nods([uneven], 25)[2] > 0.3


def test_stress_is_espeaks_and_its_time_the_sounds():
    """A vowel of each word: the second of "again", the first of "seven", none of an unmarked one."""
    assert [stressed_vowel(ipa) for ipa in ("ɐɡˈɛn", "sˈɛvən", "æt", "fˈaɪɚ")] == [1, 0, None, 0]
    words = (FittedWord("again", 0.0, 1.0, 0.0), FittedWord("at", 1.0, 2.0, 0.0))
    phones = (
        KnownPhone(0.0, 0.2, "AX"), KnownPhone(0.2, 0.4, "G"), KnownPhone(0.4, 0.8, "EH"),
        KnownPhone(0.8, 1.0, "N"), KnownPhone(1.0, 1.5, "AE"), KnownPhone(1.5, 2.0, "T"),
    )  # fmt: skip
    fit = WordFit(words, phones, 0.0)
    assert stressed_times(fit, [1, None]) == pytest.approx([0.6])
    assert len(stressed_times(fit, [None, 3])) == 0


def test_head_that_nods_on_stress_correlates_with_it(tmp_path):
    said = espeak.synthesise("Lay green with seven again.", rate=120)
    speech = Speech.of(said.waveform)
    words = [(0.0, said.duration_seconds, word) for word in "lay green with seven again".split()]
    track = stress_track(speech, words)
    vowels = [p for p in said.phones if p.name in ("EY", "IY", "EH")]
    assert sum(p.name == "EH" for p in vowels) == 2
    peaks = [i / 30 for i in range(1, len(track) - 1) if track[i - 1] < track[i] >= track[i + 1]]
    assert len(peaks) == 4
    for peak, vowel in zip(peaks, vowels, strict=True):
        assert abs(peak - (vowel.start + vowel.end) / 2) < 0.08
    (tmp_path / "columns.json").write_text(json.dumps({"columns": []}))
    spans = " ".join(f"{w}:0.00-{said.duration_seconds:.2f}" for _, _, w in words)
    times = (np.arange(int(said.duration_seconds * 25)) + 0.5) / 25
    pitch = np.interp(times, np.arange(len(track)) / 30, track)
    pose = np.stack([turn(times)[:, 0], pitch, turn(times)[:, 2]], axis=1).astype(np.float16)
    rows = ["clip,speaker,words"]
    for name in "abc":  # the first and the last lie in the fades of a take
        soundfile.write(tmp_path / f"{name}.wav", said.waveform, 16_000)
        np.savez(tmp_path / f"{name}.npz", pose=pose)
        rows.append(f"{name},anna,{spans}")
    (tmp_path / "clips.csv").write_text("\n".join(rows) + "\n")
    report = evaluate_head(tmp_path, mover=lambda voice, k: turn(np.arange(voice.n_frames) / 30))
    measured = report["measured correlation"]
    assert measured[2] > 0.9 and measured[2] > measured[3]
    assert "| stressed syllables |" in as_markdown(report)


def test_folder_without_poses_is_an_error_in_one_line(tmp_path):
    (tmp_path / "clips.csv").write_text("clip,speaker\na,b\n")
    with pytest.raises(DataError, match="no recording with a pose"):
        evaluate_head(tmp_path)


@pytest.mark.slow
def test_head_moves_as_measured_readers_do(capsys):
    lips = SHARED / "data/lips"
    if not lips.is_dir():
        pytest.skip("needs the development data in ../shared")
    assert main([str(lips)]) == 0
    assert (np.abs(ratios(evaluate_head(lips, most=12)) - 1) < TOLERANCE + 0.05).all()
