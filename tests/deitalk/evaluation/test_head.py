"""Range and speed of heads against measured ones, on a made folder and the real one."""

import csv
import json

import numpy as np
import pytest
import soundfile

from deitalk.errors import DataError
from deitalk.evaluation.people.head import TOLERANCE, as_markdown, evaluate_head, main, ratios
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
