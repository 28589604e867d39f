import numpy as np
import pytest
import soundfile

from deitalk.errors import AudioError, ConfigError, DataError
from deitalk.research.corpus.recordings import Recording, read_waveform, recordings


def _sound(path, rate=16_000, seconds=0.5, channels=1, hz=440):
    path.parent.mkdir(parents=True, exist_ok=True)
    t = np.arange(int(rate * seconds)) / rate
    wave = 0.5 * np.sin(2 * np.pi * hz * t)
    soundfile.write(path, np.stack([wave] * channels, 1), rate)
    return path


def test_librispeech_layout_is_read(tmp_path):
    chapter = tmp_path / "1272" / "128104"
    audio = _sound(chapter / "1272-128104-0000.flac")
    (chapter / "1272-128104.trans.txt").write_text("1272-128104-0000 MISTER QUILTER IS\n")
    assert recordings(tmp_path) == [Recording(audio, "MISTER QUILTER IS", "librispeech:1272")]


def test_tsv_layout_with_age_and_phones_is_read(tmp_path):
    audio = _sound(tmp_path / "speechocean" / "1.wav")
    (tmp_path / "speechocean.tsv").write_text(
        "path\tspeaker\tgender\tage\ttext\tphones\n"
        "speechocean/1.wav\t0001\tm\t6\tWE CALL\tW_B IY0_E | K_B AO0_I L_E\n"
    )
    (found,) = recordings(tmp_path)
    assert found == Recording(
        audio, "WE CALL", "speechocean:0001", ("W", "IY", "K", "AO", "L"), age=6
    )


def test_clips_layout_skips_rows_without_transcript(tmp_path):
    audio = _sound(tmp_path / "a.wav")
    (tmp_path / "clips.csv").write_text(
        'clip,audio,transcript,speaker,age\nc1,a.wav,"Well, hello.",Ann,41\nc2,a.wav,,Ann,41\n'
    )
    assert recordings(tmp_path, layout="clips") == [
        Recording(audio, "Well, hello.", f"{tmp_path.name}:Ann", age=41)
    ]


def test_development_data_is_read(shared):
    found = recordings(shared / "data" / "speech")
    assert len(found) == 1313 + 2500
    assert len({r.speaker for r in found}) == 20 + 250


def test_stereo_44100_becomes_mono_16000_with_the_same_tone(tmp_path):
    waveform = read_waveform(_sound(tmp_path / "a.wav", rate=44_100, channels=2, hz=1000))
    assert waveform.dtype == np.float32
    assert len(waveform) == 8000
    spectrum = np.abs(np.fft.rfft(waveform))
    assert np.argmax(spectrum) * 16_000 / 8000 == pytest.approx(1000, abs=2)
    assert np.abs(waveform[1000:-1000]).max() == pytest.approx(0.5, abs=0.01)


def test_unreadable_audio_is_named(tmp_path):
    broken = tmp_path / "broken.wav"
    broken.write_bytes(b"not audio at all")
    for path in (broken, tmp_path / "absent.wav", _sound(tmp_path / "empty.wav", seconds=0)):
        with pytest.raises(AudioError, match=path.name.replace(".", r"\.")):
            read_waveform(path)


def test_recordings_longer_than_ten_minutes_are_refused(tmp_path):
    path = tmp_path / "long.wav"
    soundfile.write(path, np.zeros(601 * 4000, np.float32), 4000)
    with pytest.raises(AudioError, match=r"long\.wav"):
        read_waveform(path)


def test_bad_folders_are_refused_with_the_missing_part(tmp_path):
    with pytest.raises(DataError, match="is not a folder"):
        recordings(tmp_path / "absent")
    with pytest.raises(DataError, match=r"has no recordings with transcripts; it needs clips\.csv"):
        recordings(tmp_path)
    with pytest.raises(ConfigError, match="layout='kaldi' must be one of clips, tsv, librispeech"):
        recordings(tmp_path, layout="kaldi")


def test_tables_with_missing_columns_or_files_are_refused(tmp_path):
    table = tmp_path / "clips.csv"
    table.write_text("clip,file\nc1,a.wav\n")
    with pytest.raises(DataError, match=r"clips\.csv lacks the column\(s\) audio, transcript"):
        recordings(tmp_path)
    table.write_text("audio,transcript\nb.wav,Hello\n")
    with pytest.raises(DataError, match=r"names .*b\.wav, which does not exist"):
        recordings(tmp_path)
