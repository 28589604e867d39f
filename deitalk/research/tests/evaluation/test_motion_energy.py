"""Motion energy by region: hand-worked values, the table and the picture."""

import json
from dataclasses import replace

import numpy as np
import pytest

from deitalk.research.evaluation.motion_energy import HEAD, main, motion_energy, spreads
from rig import rest_curves, write_curves


@pytest.fixture
def curves():
    """A left brow that rises by .3 in a frame, and a head that turns 3 degrees in the next."""
    still = rest_curves(4)
    values, head = still.values.copy(), np.zeros((4, 6), np.float32)
    values[1:, still.names.index("CTRL_L_brow_down.ty")] += 0.3
    head[2:, 0] = 3.0
    return replace(still, values=values, head=head)


def test_energy_is_the_change_per_second_of_a_region(curves):
    energy = motion_energy(curves)
    n_brows = sum("_brow_" in name for name in curves.names)
    assert energy["brows"] == pytest.approx([0.3 * 30 / n_brows**0.5, 0, 0], rel=1e-5)
    assert energy[HEAD] == pytest.approx([0, 90, 0])
    assert not energy["mouth"].any() and not energy["gaze"].any()
    assert spreads(curves)["brows"] == pytest.approx(0.3 * np.sqrt(3) / 4, rel=1e-5)


def test_command_compares_files_and_draws(curves, tmp_path, capsys):
    write_curves(tmp_path / "a.npz", curves)
    write_curves(tmp_path / "b.csv", curves)
    files = [str(tmp_path / name) for name in ("a.npz", "b.csv")]
    options = ["-o", str(tmp_path / "energy.png"), "--json", str(tmp_path / "energy.json")]
    assert main([*files, *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split("|")[1:4] == [" region ", " a ", " b "]
    assert any(line.startswith("| brows | 1.061 (0.130) | 1.061 (0.130)") for line in lines)
    found = json.loads((tmp_path / "energy.json").read_text())["takes"]
    assert found["b"]["brows"] == pytest.approx([1.061, 0.130], abs=1e-3)
    assert main([]) == 1 and "no curves" in capsys.readouterr().err
    assert (tmp_path / "energy.png").read_bytes().startswith(b"\x89PNG")
    assert main([files[0], "--start", "5"]) == 1 and "fewer than two" in capsys.readouterr().err
