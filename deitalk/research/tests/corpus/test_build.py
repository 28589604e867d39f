"""Building a corpus: repeatable to the byte, resumable, its labels in time with its sound."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deitalk.data.clips import read_clips, read_intensity, read_phones
from deitalk.errors import DataError
from deitalk.postprocess.phones import BILABIALS
from deitalk.research.corpus.build import (
    COLUMNS,
    Shard,
    _write,
    build,
    recorded_shards,
    synthetic_shards,
)
from deitalk.research.corpus.engines import available_engines
from deitalk.research.corpus.performance import (
    CURVE_RATE,
    _pad,
    loudness_stress,
    perform,
    speech_span,
    split_of,
)
from deitalk.research.corpus.recordings import Recording
from deitalk.research.corpus.utterance import Phone, Utterance
from rig import default_controls, read_curves

RATE = 16_000
espeak = pytest.mark.skipif(
    available_engines()["espeak"] is not None, reason="espeak-ng is not installed"
)


def utterance(speaker: str = "test:anna", engine: str = "espeak") -> Utterance:
    """A tone for every phone except the closures, which are silent."""
    names = "HH AA M AA T UW P IY".split()
    t = np.arange(RATE // 5) / RATE
    loud = (0.1 * np.sin(2 * np.pi * 150 * t) + 0.05 * np.sin(2 * np.pi * 1800 * t)).astype(
        np.float32
    )
    pieces = [loud * (0.02 if name in ("M", "T", "P") else 1) for name in names]
    phones = tuple(Phone(i * 0.2, (i + 1) * 0.2, name) for i, name in enumerate(names))
    return Utterance(np.concatenate(pieces), phones, "hamatupi", "happy", speaker, engine, "en")


def speaker_of(split: str) -> str:
    return next(f"someone:{i}" for i in range(99) if split_of(f"someone:{i}") == split)


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@espeak
def test_builds_are_equal_to_the_byte_and_only_a_lost_shard_is_remade(tmp_path):
    shards = [Shard("espeak-000", "espeak", 3.0, 1), Shard("espeak-001", "espeak", 3.0, 2)]
    first, second = tmp_path / "first", tmp_path / "second"
    seconds: list[float] = []
    frame = build(first, shards, workers=2, progress=seconds.append)
    build(second, shards, workers=1)
    assert digests(first) == digests(second)
    assert len(seconds) == 2 and min(seconds) > 3

    before = {path: path.stat().st_mtime_ns for path in first.glob("audio/*")}
    (first / "shards" / "espeak-001.csv").unlink()
    build(first, shards, workers=1)
    assert digests(first) == digests(second)
    for path, stamp in before.items():
        remade = path.stat().st_mtime_ns != stamp
        assert remade == path.name.startswith("espeak-001"), path

    clips = read_clips(first)
    assert len(clips) == len(frame) and tuple(frame.columns) == (*COLUMNS, "split", "age")
    assert len({clip.audio for clip in clips}) == len(clips) / 2, "two emotions a recording"
    for clip in clips:
        assert read_phones(clip.phones)[0][2] == "SIL"


@espeak
def test_a_folder_begun_with_another_seed_is_refused(tmp_path):
    shards = [Shard("espeak-000", "espeak", 1.0, 1)]
    build(tmp_path, shards, workers=1)
    with pytest.raises(DataError, match=r"espeak-000 was begun with another seed"):
        build(tmp_path, [replace(shards[0], seed=2)], workers=1)


def test_shards_without_a_clip_are_refused(tmp_path):
    pytest.importorskip("pocketsphinx", reason="alignment needs pocketsphinx")
    shard = Shard("recording-000", "recording", 0.0, 1)
    with pytest.raises(DataError, match="no clip was made"):
        build(tmp_path, [shard], workers=1)
    assert tuple(pd.read_csv(tmp_path / "shards" / "recording-000.csv").columns) == COLUMNS


def test_speaker_splits_are_fixed():
    known = {"librispeech:1272": "", "espeak:en-us+f3": "", "speechocean:0001": ""}
    for speaker in known:
        assert split_of(speaker) == split_of(speaker)
    counts = pd.Series([split_of(f"reader:{i}") for i in range(4000)]).value_counts(normalize=True)
    assert counts["train"] == pytest.approx(0.7, abs=0.03)
    assert counts["validation"] == pytest.approx(0.2, abs=0.03)
    assert {split_of(f"flite:{voice}") for voice in ("slt", "rms", "awb")} == {"train"}


def test_hours_are_shared_among_available_engines():
    shards = synthetic_shards(2.0, 7, ("espeak", "flite"))
    total = {e: sum(s.seconds for s in shards if s.engine == e) for e in ("espeak", "flite")}
    assert sum(total.values()) == pytest.approx(7200)
    assert total["espeak"] / total["flite"] == pytest.approx(0.35 / 0.45)
    assert len({s.seed for s in shards}) == len(shards) == len({s.name for s in shards})
    assert synthetic_shards(2.0, 7, ("espeak", "flite")) == shards
    assert synthetic_shards(2.0, 8, ("espeak",))[0].seed != shards[0].seed


def test_ages_are_added_to_a_built_folder(tmp_path):
    found = [Recording(Path("1.wav"), "hello", "a:1"), Recording(Path("2.wav"), "hello", "a:2")]
    shard = Shard("recording-000", "recording", 0.0, 1, tuple(found))
    (tmp_path / "shards").mkdir()
    row = dict.fromkeys(COLUMNS, "x")
    rows = [row | {"clip": f"c{i}", "speaker": f"a:{i}"} for i in (1, 2)]
    table = tmp_path / "shards" / "recording-000.csv"
    pd.DataFrame(rows).to_csv(table, index=False)
    (tmp_path / "shards" / "plan.json").write_text("{}")
    build(tmp_path, [shard], workers=1)
    before = table.read_bytes(), (tmp_path / "shards" / "plan.json").read_bytes()
    aged = replace(shard, recordings=(found[0], replace(found[1], age=7)))
    assert aged.fingerprint == shard.fingerprint
    build(tmp_path, [aged], workers=1)
    written = pd.read_csv(tmp_path / "clips.csv", dtype=str, keep_default_na=False)
    assert written["age"].tolist() == ["", "7"]
    assert before == (table.read_bytes(), (tmp_path / "shards" / "plan.json").read_bytes())


def test_every_recording_is_in_one_shard():
    found = [Recording(Path(f"{i}.wav"), "hello", f"a:{i}") for i in range(7)]
    shards = recorded_shards(found, 0, None, size=3)
    assert [len(s.recordings) for s in shards] == [3, 3, 1]
    assert [r for s in shards for r in s.recordings] == found
    moved = recorded_shards([replace(r, path=Path("else") / r.path) for r in found], 0, None, 3)
    assert [s.fingerprint for s in moved] == [s.fingerprint for s in shards]


def test_padding_shifts_phones_and_sound_equally(rng):
    plain = utterance()
    padded = _pad(plain, rng)
    lead = padded.phones[0].end
    assert padded.phones[0].name == padded.phones[-1].name == "SIL"
    assert padded.phones[-1].end == pytest.approx(padded.duration_seconds, abs=1 / RATE)
    for old, new in zip(plain.phones, padded.phones[1:-1], strict=True):
        assert new.start == pytest.approx(old.start + lead) and new.name == old.name
    inner = padded.waveform[int(lead * RATE) + 400 :][:1000]
    np.testing.assert_array_equal(inner, plain.waveform[400:1400])
    assert plain.waveform[5] != 0, "the source is not changed"


def quietest(waveform: np.ndarray, phone: Phone) -> float:
    piece = waveform[round((phone.start + 0.02) * RATE) : round((phone.end - 0.02) * RATE)]
    return float(np.abs(piece).mean())


@pytest.mark.parametrize("seed", range(4))
def test_phones_curves_and_sound_of_a_performance_agree_in_time(seed):
    take = perform(utterance(), np.random.default_rng(seed))
    assert len(take.channels) == len(take.intensity)
    assert len(take.channels) == int(np.ceil(len(take.waveform) * CURVE_RATE / RATE - 1e-9))
    assert all(
        a.end == pytest.approx(b.start) for a, b in zip(take.phones, take.phones[1:], strict=False)
    )
    assert take.intensity[0] == 0 and take.intensity[-1] == 0
    assert 0.2 < take.intensity.max() <= 1
    shut = {phone.name: quietest(take.waveform, phone) for phone in take.phones[1:-1]}
    assert max(shut["M"], shut["P"]) < 0.2 * min(shut["AA"], shut["UW"], shut["IY"])
    last = take.phones[-2]  # /i/ after a silent /p/: its first sound is at its label
    before = round((last.start - 0.08) * RATE)
    level = np.convolve(np.abs(take.waveform[before:][:2560]), np.ones(107) / 107, "same")
    onset = (before + np.flatnonzero(level > 0.4 * level.max())[0]) / RATE
    assert onset == pytest.approx(last.start, abs=0.004)
    for phone in take.phones:
        if phone.name in BILABIALS:
            assert take.channels[round((phone.start + phone.end) / 2 * CURVE_RATE), 1] > 0.9


def test_recordings_of_evaluation_splits_keep_their_prosody():
    for split, kept in (("validation", True), ("test", True), ("train", False)):
        plain = utterance(speaker_of(split), "recording")
        ratios, levels = [], []
        for seed in range(6):
            rng = np.random.default_rng(seed)
            padded = _pad(plain, np.random.default_rng(seed))
            take = perform(plain, rng)
            ratios.append(len(take.waveform) / len(padded.waveform))
            if kept:
                error = (
                    take.waveform[: len(padded.waveform)] - padded.waveform[: len(take.waveform)]
                )
                levels.append(np.abs(error).max())
        moved = np.ptp(ratios) > 1e-3
        assert moved != kept, split
        assert not levels or max(levels) < 0.002


def test_stress_follows_the_level_of_the_vowels():
    plain = utterance()
    quiet = plain.waveform.copy()
    quiet[round(0.2 * RATE) : round(0.4 * RATE)] *= 0.6
    stress = loudness_stress(quiet, plain.phones)
    assert stress[1] == pytest.approx(1 + 0.04 * 20 * np.log10(0.6), abs=0.05)
    assert stress[1] < stress[3] and stress[2] == 1, "consonants are not stressed"


def test_speech_span_excludes_silence():
    padded = _pad(utterance(), np.random.default_rng(0))
    assert speech_span(padded.phones) == (padded.phones[0].end, padded.phones[-1].start)
    assert speech_span((Phone(0, 1, "SIL"),)) is None


def test_one_recording_is_written_in_two_emotions(tmp_path):
    for folder in ("audio", "curves", "phones", "intensity"):
        (tmp_path / folder).mkdir()
    take = perform(utterance(), np.random.default_rng(0))
    rows = _write(tmp_path, "clip", take, np.random.default_rng(0))
    assert [row["voice"] for row in rows] == ["happy", "happy"]
    assert rows[0]["emotion"] == "happy" != rows[1]["emotion"]
    assert tuple(rows[0]) == COLUMNS
    curves = [read_curves(tmp_path / row["curves"]) for row in rows]
    assert curves[0].fps == CURVE_RATE and curves[0].names == default_controls().names
    assert np.abs(curves[0].values - curves[1].values).max() > 0.2, "the faces differ"
    np.testing.assert_allclose(curves[0].values * 1024 % 1, 0, atol=1e-6)
    times = np.arange(len(take.intensity)) / CURVE_RATE
    written = read_intensity(tmp_path / rows[0]["intensity"], times)
    np.testing.assert_allclose(written, take.intensity, atol=0.02)
    starts = [row[0] for row in read_phones(tmp_path / rows[0]["phones"])]
    np.testing.assert_allclose(starts, [p.start for p in take.phones], atol=1e-4)
