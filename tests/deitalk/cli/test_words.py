"""`deitalk animate --words`: files, notes, errors."""

import json
from dataclasses import replace

import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

from deitalk.cli import app
from deitalk.errors import DataError
from deitalk.pipeline.words import pronounced as words_espeak
from deitalk.research.corpus.engines import espeak
from rig import read_curves, write_curves


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    path = tmp_path_factory.mktemp("words") / "a.wav"
    soundfile.write(path, espeak.synthesise("Bob may bring my map.").waveform, 16_000)
    return path


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_fit_and_misfit_are_one_line(line, tmp_path):
    (tmp_path / "said.txt").write_text("Bob may bring my map.")
    done = run("animate", line, "-o", tmp_path / "a/", "--words", tmp_path / "said.txt")
    assert done.exit_code == 0 and "the words fit the sound (score" in done.output
    about = json.loads((tmp_path / "a" / "take.json").read_text())
    assert about["settings"]["words"] == "Bob may bring my map." and not about["source"]["warnings"]
    done = run("animate", line, "-o", tmp_path / "b/", "--words", "See, see, two necessary cars.")
    assert done.exit_code == 0 and "the words do not fit the sound" in done.output
    about = json.loads((tmp_path / "b" / "take.json").read_text())
    assert about["source"]["warnings"][-1].startswith("the words do not fit the sound")


def test_a_subtitle_is_read(line, tmp_path):
    (tmp_path / "said.srt").write_text("1\n00:00:00,200 --> 00:00:01,500\nBob may bring my map.\n")
    done = run("animate", line, "-o", tmp_path / "a.npz", "--words", tmp_path / "said.srt")
    assert done.exit_code == 0 and "the words fit the sound (score" in done.output


def test_errors_come_before_any_work(line, tmp_path, monkeypatch):
    def error(*options):
        done = run("animate", line, "-o", tmp_path / "c.json", *options)
        assert done.exit_code == 1
        return str(done.exception)

    assert "'xx' is no voice of espeak-ng" in error("--words", "a", "--language", "xx")
    assert "'w.csv': a file of words is" in error("--words", "w.csv")
    assert "w.srt" in error("--words", "w.srt")
    monkeypatch.setattr(
        words_espeak, "missing", lambda: "espeak: absent; pip install espeakng-loader"
    )
    assert "pip install espeakng-loader" in error("--words", "a")


def test_a_language_without_words_is_named(line, tmp_path):
    done = run("animate", line, "-o", tmp_path / "c.json", "--language", "de")
    assert done.exit_code == 0 and "language de is of words: none are given" in done.output
    for option in (("--language", "de"), ("--audio", line)):
        done = run("validate", tmp_path / "c.json", *option)
        assert done.exit_code == 1 and "are of --words" in str(done.exception)


def test_validate_marks_the_closure_that_curves_miss(line, tmp_path):
    assert run("animate", line, "-o", tmp_path / "a/", "--life", "off").exit_code == 0
    said = "Bob may bring my map."
    assert run("animate", line, "-o", tmp_path / "b.npz", "--words", said).exit_code == 0
    good = run("validate", tmp_path / "b.npz", "--words", said, "--audio", line)
    assert "the words fit the sound" in good.stdout and "do not meet" not in good.stdout
    curves = read_curves(tmp_path / "b.npz")
    values = curves.values.copy()
    values[-25:, [i for i, name in enumerate(curves.names) if "lipsTogether" in name]] = 0
    write_curves(tmp_path / "a" / "curves.csv", replace(curves, values=values))
    bad = run("validate", tmp_path / "a", "--words", said, "--json")
    found = [row["text"] for row in json.loads(bad.stdout)["findings"]]
    missed = [text for text in found if "do not meet" in text]
    assert missed and "p of 'map'" in missed[-1] and "(0.00 of 0.9)" in missed[-1]
    with pytest.raises(DataError, match="no recording to compare the words with"):
        raise run("validate", tmp_path / "b.npz", "--words", said).exception


def test_mesh_meets_words_and_tells_a_misfit(line, tmp_path, monkeypatch):
    monkeypatch.setattr(np, "savez_compressed", np.savez)  # for time
    said = ("--words", "Bob may bring my map.")
    assert run("animate", line, "--vertices", "-o", tmp_path / "b.npz", *said).exit_code == 0
    other = ("--words", "See, see, two necessary cars.")
    wrong = run("animate", line, "--vertices", "-o", tmp_path / "c.npz", *other)
    assert wrong.exit_code == 0 and "the words do not fit the sound" in wrong.output
    met, plain = (np.load(tmp_path / f"{name}.npz")["vertices"] for name in "bc")
    assert plain.shape == met.shape and np.abs(plain - met).max() > 0.01
    refused = run("animate", line, "--vertices", "-o", tmp_path / "d.npz", "--model", "sdfa", *said)
    assert "words: a mesh model takes" in str(refused.exception)
