"""The review video: reading what is shown, the panel, exact sync, and clear refusals."""

import json
import shutil
import subprocess

import numpy as np
import pytest

from deitalk.errors import MissingError
from deitalk.preview import video
from deitalk.preview.panel import Panel
from deitalk.preview.source import PreviewError, PreviewSource, load_source
from deitalk.preview.video import FACE_HEIGHT, PANEL_HEIGHT, WIDTH, draw_frames, render_video
from rig import RigCurves, default_controls, write_curves
from rig.errors import ExistsError, TargetError

CONTROLS = default_controls()
RATE = 16000


def make_curves(n_frames: int = 12, **tracks) -> RigCurves:
    values = np.repeat(CONTROLS.rest[None], n_frames, 0)
    values[:, CONTROLS.index("CTRL_C_jaw.ty")] = np.linspace(0, 1, n_frames)
    return RigCurves(values, CONTROLS.names, 30.0, **tracks)


def make_source(n_frames: int = 12, seconds: float | None = None) -> PreviewSource:
    emotion = np.zeros((n_frames, 5), np.float32)
    emotion[:, 2] = 1
    curves = make_curves(n_frames, emotion=emotion, intensity=np.linspace(0, 1, n_frames))
    count = round((n_frames / 30 if seconds is None else seconds) * RATE)
    tone = 0.5 * np.sin(np.arange(count) * 0.05).astype(np.float32)
    return PreviewSource("test", curves, tone, RATE)


def write_wav(path, seconds: float) -> None:
    import soundfile

    soundfile.write(path, np.zeros(round(seconds * RATE), np.float32), RATE)


def test_take_folder_brings_curves_audio_and_neutral(tmp_path):
    curves = make_curves(30)
    write_curves(tmp_path / "curves.json", curves)
    write_curves(tmp_path / "neutral.npz", make_curves(30))
    write_wav(tmp_path / "audio.wav", 1.0)
    source = load_source(tmp_path)
    assert source.audio_seconds == pytest.approx(1.0)
    assert source.neutral is not None
    assert np.allclose(source.curves.values, curves.values, atol=1e-5)


def test_curves_without_recording_are_silent(tmp_path):
    write_curves(tmp_path / "c.csv", make_curves(4))
    source = load_source(tmp_path / "c.csv")
    assert source.curves.names == CONTROLS.names
    assert source.sample_rate == 0 and source.audio_seconds == 0


def test_missing_source_is_named(tmp_path):
    with pytest.raises(PreviewError, match="nothing_here"):
        load_source(tmp_path / "nothing_here")


def test_folder_that_is_no_take_is_refused(tmp_path):
    with pytest.raises(PreviewError, match=r"curves\.json"):
        load_source(tmp_path)


def test_missing_recording_is_named(tmp_path):
    write_curves(tmp_path / "c.csv", make_curves(4))
    with pytest.raises(PreviewError, match=r"gone\.wav"):
        load_source(tmp_path / "c.csv", tmp_path / "gone.wav")


def test_recording_longer_than_the_curves_is_refused(tmp_path):
    write_curves(tmp_path / "c.csv", make_curves(30))
    write_wav(tmp_path / "long.wav", 1.5)
    with pytest.raises(PreviewError, match=r"1\.50 s but the curves end at 1\.00 s"):
        load_source(tmp_path / "c.csv", tmp_path / "long.wav")


def test_broken_recording_is_refused(tmp_path):
    write_curves(tmp_path / "c.csv", make_curves(4))
    (tmp_path / "x.wav").write_bytes(b"not sound")
    with pytest.raises(PreviewError, match="cannot be read"):
        load_source(tmp_path / "c.csv", tmp_path / "x.wav")


def test_unknown_control_is_refused(tmp_path):
    path = tmp_path / "c.json"
    write_curves(path, make_curves(3))
    path.write_text(path.read_text().replace("CTRL_C_jaw.ty", "CTRL_C_jay.ty"))
    with pytest.raises(ValueError, match=r"CTRL_C_jay\.ty"):
        load_source(path)


def test_playhead_moves_with_time_and_frames_differ():
    source = make_source(20)
    panel = Panel(source, (400, 160))
    columns = []
    for frame in (0, 10, 19):
        white = (panel.at(frame) >= 250).all(2).all(0)
        assert white.sum() == 2
        columns.append(int(np.flatnonzero(white)[0]))
    assert columns[1] - columns[0] == pytest.approx((400 - 108 - 12) / 2, abs=1)
    assert columns[0] < columns[1] < columns[2]


def test_time_code_counts_frames():
    panel = Panel(make_source(20), (400, 160))
    assert panel.time_code(15).startswith("00:00.500  frame 15")


def test_jaw_frames_differ_in_the_mouth(monkeypatch):
    monkeypatch.setattr(video, "FACE_HEIGHT", 96)
    monkeypatch.setattr(video, "FACE_WIDTH", 120)
    monkeypatch.setattr(video, "WIDTH", 400)
    source = make_source(3)
    frames = list(draw_frames(source, backend="software"))
    assert frames[0].shape == (96 + PANEL_HEIGHT, 400, 3)
    change = np.abs(frames[0].astype(int) - frames[2].astype(int)).sum(2)
    assert (change[30:80, 120:] > 60).mean() > 0.05


def needs_ffmpeg():
    if shutil.which("ffmpeg") is None:
        pytest.skip("needs ffmpeg")


def flat_frames(source, **_):
    """Frames whose brightness is their number, to look at time only."""
    for k in range(len(source.curves)):
        yield np.full((FACE_HEIGHT + PANEL_HEIGHT, WIDTH, 3), 20 + 10 * k, np.uint8)


def test_video_has_every_frame_once_and_sound_from_the_start(tmp_path, monkeypatch):
    needs_ffmpeg()
    monkeypatch.setattr(video, "draw_frames", flat_frames)
    out = render_video(make_source(15), tmp_path / "v.mp4")
    probe = subprocess.run(
        ["ffprobe", "-v", "error", "-show_streams", "-of", "json", str(out)],
        capture_output=True, check=True,
    )  # fmt: skip
    streams = {s["codec_type"]: s for s in json.loads(probe.stdout)["streams"]}
    assert int(streams["video"]["nb_frames"]) == 15
    assert float(streams["video"]["start_time"]) == 0
    assert float(streams["audio"]["start_time"]) == 0
    assert float(streams["audio"]["duration"]) == pytest.approx(0.5, abs=0.03)
    raw = subprocess.run(
        ["ffmpeg", "-v", "error", "-i", str(out), "-f", "rawvideo", "-pix_fmt", "rgb24", "-vf",
         "scale=2:2", "-"], capture_output=True, check=True,
    ).stdout  # fmt: skip
    level = np.frombuffer(raw, np.uint8).reshape(15, 12).mean(1)
    assert np.abs(level - (20 + 10 * np.arange(15))).max() < 4  # frame i is picture i


def test_video_refuses_to_overwrite(tmp_path):
    path = tmp_path / "v.mp4"
    path.write_bytes(b"mine")
    with pytest.raises(ExistsError, match="exists"):
        render_video(make_source(), path)
    assert path.read_bytes() == b"mine"


@pytest.mark.parametrize(("name", "message"), [("v.avi", "avi"), ("no/v.mp4", "is not a folder")])
def test_bad_targets_are_refused(tmp_path, name, message):
    with pytest.raises((PreviewError, TargetError), match=message):
        render_video(make_source(), tmp_path / name)


def test_unknown_view_is_refused(tmp_path):
    with pytest.raises(PreviewError, match="three_quarter"):
        render_video(make_source(), tmp_path / "v.mp4", second_view="inside")


def test_missing_ffmpeg_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(video.shutil, "which", lambda name: None)
    with pytest.raises(MissingError, match="apt install ffmpeg"):
        render_video(make_source(), tmp_path / "v.mp4")


def test_failing_ffmpeg_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(video, "find_ffmpeg", lambda: shutil.which("false") or "false")
    monkeypatch.setattr(video, "draw_frames", flat_frames)
    with pytest.raises(PreviewError, match="ffmpeg failed"):
        render_video(make_source(5), tmp_path / "v.mp4")
    assert list(tmp_path.iterdir()) == []
