"""Pictures of videos: upright, small enough, 30 a second, on the clock of the sound."""

from fractions import Fraction

import av
import numpy as np
import pytest

from deitalk.errors import DataError
from deitalk.research.video import pictures
from deitalk.research.video.pictures import read_pictures
from rig import limits
from tests.media import write_sound


def write_video(path, *, fps=30, n=6, size=(96, 64), sound_at=None):
    """A video whose pictures are red above and brighten; sound from `sound_at` on."""
    pictures = [np.full((size[1], size[0], 3), 20 * k, np.uint8) for k in range(n)]
    for picture in pictures:
        picture[: size[1] // 2, :, 0] = 255
    return encode(path, pictures, fps=fps, sound_at=sound_at)


def encode(path, pictures, *, fps=30, sound_at=None):
    """A video of some pictures, with a second of silence from `sound_at` on."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=fps)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 4_000_000
        sound = container.add_stream("pcm_s16le", rate=16_000, layout="mono") if sound_at else None
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
        if sound is not None:
            silence = np.zeros((1, 16_000), np.float32)
            frame = av.AudioFrame.from_ndarray(silence, format="flt", layout="mono")
            frame.sample_rate, frame.time_base = 16_000, Fraction(1, 16_000)
            frame.pts = round(sound_at * 16_000)
            container.mux(sound.encode(frame))
            container.mux(sound.encode(None))
    return path


def turned(path, matrix):
    """The display matrix of a video's track replaced, as phones write it."""
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    data[at : at + 36] = b"".join(int(v).to_bytes(4, "big", signed=True) for v in matrix)
    path.write_bytes(data)
    return path


ONE, UNIT = 1 << 16, 1 << 30


def test_fast_videos_are_read_at_30_pictures_a_second(tmp_path):
    found = list(read_pictures(write_video(tmp_path / "a.mp4", fps=60, n=12)))
    np.testing.assert_allclose([s for s, _, _ in found], np.arange(6) / 30, atol=1e-3)
    assert found[-1][2] == pytest.approx(11 / 12, abs=0.1)


def test_phone_held_upright_gives_an_upright_picture(tmp_path):
    quarter = (0, ONE, 0, -ONE, 0, 0, 0, 0, UNIT)  # show it turned by 90 degrees clockwise
    path = turned(write_video(tmp_path / "a.mp4"), quarter)
    picture = next(read_pictures(path))[1]
    assert picture.shape == (96, 64, 3)
    assert picture[:, 40:, 0].mean() > 150 > picture[:, :24, 0].mean()  # the top is at the right


def test_large_pictures_are_scaled_down(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "LONG_SIDE", 48)
    assert next(read_pictures(write_video(tmp_path / "a.mp4")))[1].shape == (32, 48, 3)


def test_times_are_those_of_the_sound(tmp_path):
    path = write_video(tmp_path / "a.mkv", n=12, sound_at=0.2)
    first = next(read_pictures(path))[0]
    assert first == pytest.approx(0.0, abs=0.02)  # pictures before the sound are left out
    assert len(list(read_pictures(path))) == pytest.approx(6, abs=1)


def test_sound_is_no_video_and_text_neither(tmp_path):
    sound = write_sound(tmp_path / "a.mp4", np.zeros((16_000, 1)), 16_000)
    with pytest.raises(DataError, match="has no video track"):
        next(read_pictures(sound))
    (tmp_path / "b.mp4").write_text("no video at all" * 100)
    with pytest.raises(DataError, match="cannot be decoded as a video"):
        next(read_pictures(tmp_path / "b.mp4"))


def test_too_large_a_file_or_picture_is_refused(tmp_path, monkeypatch):
    path = write_video(tmp_path / "a.mp4")
    monkeypatch.setattr(limits, "VIDEO_PIXELS", 96 * 64 - 1)
    with pytest.raises(DataError, match="96 x 64 pixels; at most 6143"):
        next(read_pictures(path))
    monkeypatch.setattr(limits, "VIDEO_BYTES", 10)
    with pytest.raises(DataError, match="larger than 10 bytes"):
        next(read_pictures(path))
