"""The review video: its input, the panel, synchronisation, refused inputs."""

import sys
from fractions import Fraction

import av
import numpy as np
import pytest
from typer.testing import CliRunner

from deitalk.audio.load import load_audio
from deitalk.cli import app
from deitalk.errors import MissingError
from deitalk.preview import mp4, page, video
from deitalk.preview.needs import check_needs
from deitalk.preview.source import PreviewError, PreviewSource, load_source
from deitalk.preview.video import PANEL_HEIGHT, draw_frames, render_video
from rig import RigCurves, default_controls, write_curves
from rig.curves import snap_fps
from rig.curves.rig_curves import NTSC
from rig.errors import TargetError
from rig.face.render import VIEWS
from tests.media import write_sound

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


def test_take_folder_gives_curves_audio_and_neutral(tmp_path):
    curves = make_curves(30)
    write_curves(tmp_path / "curves.json", curves)
    write_curves(tmp_path / "neutral.npz", make_curves(30))
    write_wav(tmp_path / "audio.wav", 1.0)
    source = load_source(tmp_path)
    assert source.audio_seconds == pytest.approx(1.0)
    assert source.neutral is not None
    assert np.allclose(source.curves.values, curves.values, atol=1e-5)


def test_recording_longer_than_the_curves_is_refused(tmp_path):
    write_curves(tmp_path / "c.csv", make_curves(30))
    write_wav(tmp_path / "long.wav", 1.5)
    with pytest.raises(PreviewError, match=r"1\.50 s but the curves end at 1\.00 s"):
        load_source(tmp_path / "c.csv", tmp_path / "long.wav")


def test_recording_keeps_its_rate_and_may_be_an_m4a(tmp_path):
    write_curves(tmp_path / "c.csv", make_curves(30))
    tone = 0.5 * np.sin(np.arange(44100) * 0.05)
    write_sound(tmp_path / "a.m4a", np.stack([tone, tone], 1), 44100)
    source = load_source(tmp_path / "c.csv", tmp_path / "a.m4a")
    assert source.sample_rate == 44100
    assert source.audio_seconds == pytest.approx(1.0, abs=0.03)
    assert np.abs(source.samples).max() == pytest.approx(0.5, abs=0.05)


def test_unknown_control_is_refused(tmp_path):
    path = tmp_path / "c.json"
    write_curves(path, make_curves(3))
    path.write_text(path.read_text().replace("CTRL_C_jaw.ty", "CTRL_C_jay.ty"))
    with pytest.raises(ValueError, match=r"CTRL_C_jay\.ty"):
        load_source(path)


def small(monkeypatch) -> None:
    monkeypatch.setattr(video, "FACE_HEIGHT", 96)
    monkeypatch.setattr(video, "FACE_WIDTH", 120)
    monkeypatch.setattr(video, "WIDTH", 400)


def test_jaw_frames_differ_in_the_mouth(monkeypatch):
    small(monkeypatch)
    source = make_source(3)
    frames = list(draw_frames(source))
    assert frames[0].shape == (96 + PANEL_HEIGHT, 400, 3)
    change = np.abs(frames[0].astype(int) - frames[2].astype(int)).sum(2)
    assert (change[30:80, 120:] > 60).mean() > 0.05


def flat_frames(source, **_):
    """Frames whose brightness encodes their number, for tests of time."""
    for k in range(len(source.curves)):
        size = (video.FACE_HEIGHT + PANEL_HEIGHT, video.WIDTH, 3)
        yield np.full(size, 20 + 10 * k, np.uint8)


def brightness(path) -> list[tuple[Fraction, float]]:
    """Time and mean brightness of every picture of a video."""
    with av.open(str(path)) as container:
        return [
            (frame.pts * frame.time_base, float(frame.to_ndarray(format="rgb24").mean()))
            for frame in container.decode(video=0)
        ]


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_can_be_the_second(view):
    (picture,) = draw_frames(make_source(1), second_view=view)
    right = picture[:-PANEL_HEIGHT, video.FACE_WIDTH :]
    assert right.std() > 5


@pytest.mark.parametrize("fps", [30.0, 25.0, NTSC, 23.976, 59.94])
def test_picture_i_is_at_i_over_fps_and_sound_starts_with_picture_0(tmp_path, monkeypatch, fps):
    small(monkeypatch)
    monkeypatch.setattr(video, "draw_frames", flat_frames)
    source = make_source(15)
    curves = RigCurves(source.curves.values, source.curves.names, snap_fps(fps))
    click = np.zeros(round(15 / fps * RATE), np.float32)
    click[[0, 4000]] = 0.9
    out = render_video(PreviewSource("t", curves, click, RATE), tmp_path / "v.mp4")
    rate = Fraction(snap_fps(fps)).limit_denominator(1001)
    shown = brightness(out)
    assert [time for time, _ in shown] == [k / rate for k in range(15)]
    assert np.abs([level - 20 - 10 * k for k, (_, level) in enumerate(shown)]).max() < 4
    played = load_audio(out).waveform
    assert np.abs(played[3000:5000]).argmax() + 3000 == pytest.approx(4000, abs=1)
    assert np.abs(played[:200]).argmax() <= 1
    with av.open(str(out)) as container:
        assert {stream.codec_context.name for stream in container.streams} == {"h264", "aac"}
        assert [stream.start_time for stream in container.streams] == [0, 0]
        assert container.streams.video[0].codec_context.pix_fmt == "yuv420p"
    content = out.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # playable before it is fully loaded


def test_sound_of_an_odd_rate_keeps_its_time(tmp_path, monkeypatch):
    small(monkeypatch)
    monkeypatch.setattr(video, "draw_frames", flat_frames)
    click = np.zeros(5000, np.float32)
    click[4000] = 0.9
    odd = PreviewSource("t", make_curves(15), click, 10007)
    played = load_audio(render_video(odd, tmp_path / "v.mp4"))
    assert played.source_rate == 48000
    assert np.abs(played.waveform).argmax() / 16000 == pytest.approx(4000 / 10007, abs=2e-4)


HERE = [name for name, _ in mp4.ENCODERS if name in av.codecs_available]


@pytest.mark.parametrize("name", HERE)
def test_every_encoder_of_this_installation_keeps_the_pictures_in_time(tmp_path, name):
    options = dict(mp4.ENCODERS)[name]
    frames = (np.full((96, 128, 3), 20 + 10 * k, np.uint8) for k in range(15))
    mp4.write_mp4(
        tmp_path / "v.mp4", frames, fps=NTSC, size=(128, 96), samples=np.zeros(0, np.float32),
        sample_rate=0, encoder=mp4.Encoder(name, options),
    )  # fmt: skip
    times, levels = zip(*brightness(tmp_path / "v.mp4"), strict=True)
    assert times == tuple(Fraction(1001 * k, 30000) for k in range(15))
    assert np.abs(np.array(levels) - 20 - 10 * np.arange(15)).max() < 6


def test_without_h264_the_encoder_is_mpeg4_with_a_note(monkeypatch):
    monkeypatch.setattr(av, "codecs_available", {"mpeg4", "aac"})
    found = mp4.find_encoder()
    assert found.name == "mpeg4"
    assert "no H.264 encoder" in found.note
    assert mp4.Encoder("libx264", {}).note is None


def test_missing_encoder_is_one_line_before_the_source_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(av, "codecs_available", {"aac"})
    with pytest.raises(MissingError, match=r"pip install .* av"):
        render_video(tmp_path / "not there", tmp_path / "v.mp4")


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("p.html", MissingError, "has no preview page"),
        ("p.avi", PreviewError, "use .mp4 or .html"),
    ],
)
def test_requirements_of_a_preview_are_reported(tmp_path, monkeypatch, name, error, message):
    monkeypatch.setattr(page, "BUNDLE", tmp_path / "none.html")
    with pytest.raises(error, match=message):
        check_needs([tmp_path / "fine.mp4", tmp_path / name])


def test_commands_check_for_the_page_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(page, "BUNDLE", tmp_path / "none.html")
    monkeypatch.setattr("deitalk.audio.load.open_sound", None)  # no sound is read
    monkeypatch.setattr("deitalk.preview.speech_warnings.find_warnings", None)
    speech, take = "docs/samples/promise.flac", str(tmp_path / "take")
    curves = tmp_path / "curves.csv"
    write_curves(curves, RigCurves(np.zeros((3, 185), np.float32), default_controls().names))
    for command in (["animate", speech, "--preview", "-o", take], ["preview", str(curves)]):
        done = CliRunner().invoke(app, command)
        assert isinstance(done.exception, MissingError), done.output
        assert "has no preview page" in str(done.exception)


@pytest.mark.parametrize("command", ["animate"])
def test_commands_check_for_matplotlib_before_any_work(tmp_path, monkeypatch, command):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr("deitalk.audio.load.open_sound", None)
    speech = "docs/samples/promise.flac"
    done = CliRunner().invoke(app, [command, speech, "-o", str(tmp_path / "a.png")])
    assert isinstance(done.exception, MissingError), done.output
    assert "pip install matplotlib" in str(done.exception)


def test_failing_encoder_leaves_no_file(tmp_path, monkeypatch):
    def too_small(source, **_):
        yield np.zeros((3, 3, 3), np.uint8)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(video, "draw_frames", too_small)
    with pytest.raises(TargetError, match="no space left on the disk; free some"):
        render_video(make_source(5), tmp_path / "v.mp4")
    assert list(tmp_path.iterdir()) == []


def test_video_has_bt709_colours_and_a_keyframe_every_half_second(tmp_path):
    red = np.zeros((64, 96, 3), np.uint8)
    red[..., 0] = 255
    mp4.write_mp4(
        tmp_path / "red.mp4",
        iter([red] * 40),
        fps=30,
        size=(96, 64),
        samples=np.zeros(0, np.float32),
        sample_rate=0,
    )
    with av.open(str(tmp_path / "red.mp4")) as container:
        track = container.streams.video[0].codec_context
        assert (track.colorspace, track.color_primaries, track.color_trc) == (1, 1, 1)
        assert track.color_range == 1
        frames = list(container.decode(video=0))
    assert [k for k, frame in enumerate(frames) if frame.key_frame] == [0, 15, 30]
    luma = frames[0].to_ndarray(format="yuv420p")[10, 10]
    assert luma == pytest.approx(16 + 219 * 0.2126, abs=2)  # BT.601 would give 81
