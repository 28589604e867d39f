"""Scores of voice activity by hand; detectors on signals of known activity."""

import builtins
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile

from deitalk.audio.load import load_audio
from deitalk.audio.noise import named_noises, synthetic_music
from deitalk.errors import DataError, MissingError
from deitalk.evaluation.voice_activity.comparison import (
    CLEAN,
    Example,
    choose_setting,
    compare,
    condition_scores,
    condition_table,
    level_scores,
    level_table,
    read_examples,
    run,
)
from deitalk.evaluation.voice_activity.detectors import Detector, Setting, decide, make_detector
from deitalk.evaluation.voice_activity.scores import Counts, label_frames, score_activity

RATE = 16_000
SAMPLE = Path(__file__).resolve().parents[3] / "docs/samples/promise.flac"
PHONES = [(0, 1, "SIL"), (1, 1.5, "AA"), (1.5, 1.6, "SIL"), (1.6, 2, "M"), (2, 3, "SIL")]
"""Speech from 1 s to 2 s with a closure of 0.1 s in it: frames 30 to 60 of 90."""


def activity(*spans, n_frames=90):
    active = np.zeros(n_frames)
    for start, stop in spans:
        active[start:stop] = 1
    return active


@pytest.fixture
def labels():
    return label_frames(PHONES, 90)


def test_labels_leave_out_50_ms_at_each_edge(labels):
    assert np.flatnonzero(labels.speech).tolist() == list(range(32, 59))  # 1.067 s to 1.933 s
    pause = [*range(29), *range(62, 90)]  # up to 0.933 s, from 2.067 s
    assert np.flatnonzero(labels.pause).tolist() == pause


def test_labels_count_a_short_closure_as_speech_and_a_long_one_as_pause():
    long = [(0, 1, "SIL"), (1, 1.5, "AA"), (1.5, 1.9, "SIL"), (1.9, 2.4, "M"), (2.4, 3, "SIL")]
    labels = label_frames(long, 90)
    assert labels.pause[47:55].all()  # 1.567 s to 1.8 s
    assert labels.onsets == (1, 1.9)
    short = [(0, 0.1, "SIL"), (0.1, 1, "AA")]  # too short: neither pause nor speech
    assert label_frames(short, 30).onsets == ()
    assert not label_frames(short, 30).speech[:4].any()


def test_labels_join_silences_that_touch():
    parts = [(0, 1, "AA"), (1, 1.15, "SIL"), (1.15, 1.3, "SIL"), (1.3, 2, "AA")]
    assert label_frames(parts, 60).onsets == (1.3,)


def test_settled_pause_is_where_the_mouth_gate_of_perfect_activity_is_shut(labels):
    counts = score_activity(activity((30, 60)), labels)
    assert counts.settled == 26 + 22  # 0.1 s before speech and 0.2 s after it left out
    assert counts.open == 0
    wider = score_activity(activity((26, 60)), labels)
    assert wider.open == 3  # the mouth opens at frames 23 to 25, by 0.15, 0.5 and 0.85


def test_perfect_activity_has_no_error(labels):
    counts = score_activity(activity((30, 60)), labels)
    assert counts == Counts(speech=27, hits=27, pause=57, settled=48, onsets=1)
    assert (counts.hit_rate, counts.false_alarm_rate, counts.balanced_accuracy) == (1, 0, 1)
    assert counts.suitability == 1


def test_wrong_frames_are_counted(labels):
    counts = score_activity(activity((0, 10), (40, 50)), labels)
    assert (counts.hits, counts.alarms) == (10, 10)
    assert counts.balanced_accuracy == pytest.approx((10 / 27 + 47 / 57) / 2)
    assert counts.missed == 1
    assert counts.shut == 5 + 4  # the gate passes 0.1 from frame 37 to 54: 32-36 and 55-58 are shut
    assert counts.suitability == pytest.approx((10 / 27 + 47 / 57 + 0) / 3)


@pytest.mark.parametrize(("first", "missed"), [(30, 0), (32, 0), (33, 1), (45, 1)])
def test_onset_is_missed_without_activity_in_its_first_100_ms(labels, first, missed):
    assert score_activity(activity((first, 60)), labels).missed == missed


def test_no_activity_shuts_the_mouth_in_all_speech(labels):
    counts = score_activity(activity(), labels)
    assert (counts.shut, counts.hits, counts.alarms, counts.open) == (27, 0, 0, 0)


def test_score_rejects_another_length(labels):
    with pytest.raises(DataError, match="89 frames and the labels 90"):
        score_activity(activity(n_frames=89), labels)


def test_counts_add_up_and_nothing_gives_nan(labels):
    one = score_activity(activity((30, 60)), labels)
    none = score_activity(activity(), labels)
    assert (one + none).hit_rate == 0.5
    assert np.isnan(Counts().hit_rate)
    assert np.isnan(Counts().suitability)
    assert Counts(speech=4, hits=3).suitability == 0.75  # the rates that are known


def test_decide_bridges_closures_drops_single_frames_and_widens():
    evidence = activity((10, 20), (26, 30), (40, 41), (60, 70), (77, 80)) * 0.6
    bridged = activity((10, 30), (60, 70), (77, 80))  # gap of 6 bridged, of 7 kept
    np.testing.assert_array_equal(decide(evidence, Setting(threshold=0.5)), bridged > 0)
    assert not decide(evidence, Setting(threshold=0.7)).any()
    wide = decide(evidence, Setting(widen=2))
    np.testing.assert_array_equal(wide, activity((8, 32), (58, 72), (75, 82)) > 0)


def test_decide_bridges_nothing_at_the_ends_of_a_clip():
    assert decide(activity((3, 10), n_frames=12), Setting()).sum() == 7


def test_activity_of_deitalk_is_unchanged(rng):
    t = np.arange(3 * RATE) / RATE
    tone = np.sin(2 * np.pi * 300 * t) * (np.sin(2 * np.pi * 0.8 * t) > 0) * 0.1
    waveform = (tone + rng.normal(0, 1e-4, len(t))).astype(np.float32)
    detector = make_detector("ours")
    evidence = detector.evidence(waveform, 0)
    assert 0 < evidence.mean() < 1
    np.testing.assert_array_equal(decide(evidence, detector.settings[0]), evidence > 0.5)


@pytest.mark.parametrize(("name", "package"), [("silero", "onnxruntime"), ("webrtc", "webrtcvad")])
def test_detector_rejects_a_missing_package(monkeypatch, name, package):
    real = builtins.__import__

    def absent(module, *rest, **options):
        if module == package:
            raise ImportError(module)
        return real(module, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(MissingError, match="pip install") as caught:
        make_detector(name)
    assert "\n" not in str(caught.value)


def test_detector_rejects_an_unknown_name():
    with pytest.raises(DataError, match="'energy' is unknown; known are ours, silero, webrtc"):
        make_detector("energy")


@pytest.mark.parametrize(("name", "package"), [("silero", "onnxruntime"), ("webrtc", "webrtcvad")])
@pytest.mark.parametrize("n_samples", [1, 159, 512, 16_001, 40_000])
def test_other_detectors_give_one_value_per_frame(name, package, n_samples, rng):
    pytest.importorskip(package)
    if name == "silero":
        pytest.importorskip("silero_vad")
    detector = make_detector(name)
    evidence = detector.evidence(rng.normal(0, 0.01, n_samples).astype(np.float32), 3)
    assert evidence.shape == (-(-30 * n_samples // RATE),)
    assert evidence.dtype == np.float32
    assert (evidence >= 0).all()
    assert (evidence <= 1).all()


@pytest.mark.parametrize("name", ["ours", "silero", "webrtc"])
def test_detectors_find_recorded_speech_where_it_is(name):
    """A recording between two seconds of near silence: the evidence coincides with it."""
    if name != "ours":
        pytest.importorskip("onnxruntime" if name == "silero" else "webrtcvad")
    if name == "silero":
        pytest.importorskip("silero_vad")
    speech = load_audio(SAMPLE).waveform[: 4 * RATE]
    speech = speech[np.argmax(np.abs(speech) > 0.02) :]
    floor = np.random.default_rng(0).normal(0, 1e-4, 2 * RATE).astype(np.float32)
    waveform = np.concatenate([floor, speech, floor])
    active = decide(make_detector(name).evidence(waveform, 2), Setting(2, 0.5))
    assert abs(int(active.argmax()) - 60) <= 3
    assert active[63 : 60 + len(speech) * 30 // RATE - 12].mean() > 0.8
    assert not active[195:].any()


def loud(waveform, mode):
    """A detector for tests: frames with a sample above 0.05."""
    n_frames = -(-30 * len(waveform) // RATE)
    edges = np.arange(n_frames) * RATE // 30
    return (np.maximum.reduceat(np.abs(waveform), edges) > 0.05).astype(np.float32)


@pytest.fixture
def example(labels, rng):
    waveform = np.zeros(3 * RATE, np.float32)
    waveform[RATE : 2 * RATE] = 0.2 * np.sign(rng.standard_normal(RATE))
    return Example(waveform, labels, "test")


def test_mixture_has_the_given_ratio_over_labelled_speech(example, rng):
    hiss = rng.standard_normal(5 * RATE).astype(np.float32)
    for snr_db in (20, 0):
        noise = example.mixed(("hiss", snr_db), {"hiss": hiss}, 1) - example.waveform
        ratio = 10 * np.log10(0.04 / np.square(noise).mean())
        assert ratio == pytest.approx(snr_db, abs=0.01)


def test_operating_point_is_the_best_on_the_examples(example):
    def graded(waveform, mode):
        return (0.2 + 0.4 * loud(waveform, mode)).astype(np.float32)

    settings = tuple(Setting(threshold=t) for t in (0.1, 0.5, 0.9))
    detector = Detector("graded", graded, settings)
    quiet = {"clean": np.ones(RATE, np.float32)}
    assert choose_setting(detector, [example], [CLEAN], quiet) == Setting(threshold=0.5)


def test_comparison_pools_by_condition_and_prints_tables(example):
    """Noise at 0 dB passes the threshold of `loud` everywhere, noise at 20 dB nowhere."""
    noises = {"clean": np.ones(RATE, np.float32), "hum": np.ones(RATE, np.float32)}
    conditions = [CLEAN, ("hum", 20), ("hum", 0)]
    detectors = {Detector("loud", loud): Setting()}
    results = compare(detectors, [example, example], conditions, noises)
    assert results["loud", ("hum", 0), "test"].alarms == 2 * 57
    assert results["loud", ("hum", 20), "test"].alarms == 0
    assert results["loud", CLEAN, "test"].audio_seconds == 6
    table = level_table(level_scores(results, music=()))
    assert "| noise 0 dB | loud | 100.0% | 100.0% | 50.0% | 0.0% | 0.0% | 100.0% |" in table
    assert "| clean | loud | 100.0% | 0.0% | 100.0% | 0.0% | 0.0% | 0.0% |" in table
    assert "| music 0 dB | loud |" in level_table(level_scores(results, music=("hum",)))
    rows = condition_table(condition_scores(results)).splitlines()
    assert rows[2:] == [
        "| clean | 100.0% |", "| hum 20 dB | 100.0% |", "| hum 0 dB | 50.0% |",
        "| all conditions, test | 83.3% |",
    ]  # fmt: skip


def write_dataset(folder, splits):
    """One recording per split, each with two rows as written by `corpus build`."""
    rows = ["clip,audio,curves,emotion,speaker,split,phones"]
    (folder / "curves.npz").write_bytes(b"")
    for i, split in enumerate(splits):
        t = np.arange(3 * RATE) / RATE
        tone = np.where((t >= 1) & (t < 2), 0.2 * np.sin(2 * np.pi * 300 * t), 0)
        soundfile.write(folder / f"{i}.flac", tone, RATE)
        lines = [f"{start},{end},{name}" for start, end, name in PHONES]
        (folder / f"{i}.csv").write_text("\n".join(["start,end,phone", *lines]) + "\n")
        for emotion in ("neutral", "happy"):
            row = (f"{i}{emotion}", f"{i}.flac", "curves.npz", emotion, f"tone:{i}", split)
            rows.append(",".join((*row, f"{i}.csv")))
    (folder / "clips.csv").write_text("\n".join(rows) + "\n")


def test_examples_are_read_once_per_recording_by_split(tmp_path):
    write_dataset(tmp_path, ["train", "test", "validation", "test"])
    examples = read_examples(tmp_path, ("validation", "test"), 10)
    assert [example.group for example in examples] == ["tone"] * 3
    assert examples[0].labels.onsets == (1.0,)
    assert len(read_examples(tmp_path, ("validation", "test"), 2)) == 2


def test_examples_reject_a_dataset_without_the_split(tmp_path):
    write_dataset(tmp_path, ["train"])
    with pytest.raises(DataError, match="no clip of validation or test has phones"):
        run(tmp_path, "pink", "pink", ["ours"], 5)


def test_command_prints_the_tables(tmp_path):
    write_dataset(tmp_path, ["train", "test"])
    command = [sys.executable, "-m", "deitalk.evaluation.voice_activity", str(tmp_path)]
    done = subprocess.run(
        [*command, "--noise", "pink", "--music", "pink", "--detectors", "ours"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.stderr == ""
    assert "| clean | ours | 100.0% | 0.0% | 100.0% |" in done.stdout
    assert "scored on 1 clips, 3 s" in done.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--noise", "absent", "--detectors", "ours"], "absent: neither a folder"),
        (["--noise", "pink", "--detectors", "x"], "detector 'x' is unknown"),
        (["--noise", "pink", "--clips", "0"], "--clips 0: must be at least 1"),
    ],
)
def test_command_rejects_wrong_arguments_in_one_line(tmp_path, options, words, capsys):
    from deitalk.evaluation.voice_activity.__main__ import main

    write_dataset(tmp_path, ["train", "test"])
    with pytest.raises(SystemExit) as caught:
        main([str(tmp_path), *options])
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_synthetic_music_is_seeded_at_unit_power_with_beats():
    music = synthetic_music(4, seed=3)
    assert np.sqrt(np.square(music).mean()) == pytest.approx(1, abs=1e-3)
    np.testing.assert_array_equal(music, synthetic_music(4, seed=3))
    assert np.abs(music - synthetic_music(4, seed=4)).max() > 0.1
    power = np.square(music[: 4 * RATE]).reshape(-1, RATE // 50).mean(axis=1)
    rise = np.maximum(np.diff(power), 0)
    spectrum = np.abs(np.fft.rfft(rise - rise.mean()))
    tempo = 60 * np.fft.rfftfreq(len(rise), 1 / 50)[1:][spectrum[1:].argmax()]
    assert tempo > 80


def test_named_noises_name_files_and_words(tmp_path):
    soundfile.write(tmp_path / "fan.wav", np.full(RATE, 0.1), RATE)
    assert list(named_noises(str(tmp_path))) == ["fan"]
    assert len(named_noises("synthetic")["synthetic"]) == 30 * RATE
