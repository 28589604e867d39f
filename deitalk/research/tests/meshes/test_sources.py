"""Sources of mesh sequences: VOCASET's layout, and a head that acts a dataset folder."""

import numpy as np
import pytest
import soundfile

from deitalk.errors import DataError
from deitalk.research.config import MeshDataConfig
from deitalk.research.meshes.packing import pack_vertices
from deitalk.research.meshes.sources import head_lips, head_templates, open_meshes
from deitalk.research.tests.training.test_mesh_segments import RATE, sheet
from rig import default_controls
from rig.face import build_head
from rig.mesh import write_ply, write_ply_sequence
from rig.mesh.deformation import mesh_solver
from tests.dataset import CLICKS, JAW, write_dataset


def vocaset(root, rng, speakers=("ann", "bob", "cyd"), n_frames=6):
    """The layout of VOCASET, by hand."""
    vertices = {}
    (root / "templates").mkdir(parents=True)
    for i, speaker in enumerate(speakers):
        template = sheet(size=0.1 + 0.01 * i)
        write_ply(root / f"templates/{speaker}.ply", template)
        for sentence in ("sentence01", "sentence02"):
            frames = template.vertices + 0.001 * rng.standard_normal((n_frames, 25, 3))
            vertices[f"{speaker}.{sentence}"] = frames
            folder = root / "unposedcleaneddata" / speaker
            folder.mkdir(parents=True, exist_ok=True)
            write_ply_sequence(folder / sentence, template, frames)
            (root / "audio" / speaker).mkdir(parents=True, exist_ok=True)
            sound = 0.1 * rng.standard_normal(n_frames * 22_000 // 60)
            soundfile.write(root / f"audio/{speaker}/{sentence}.wav", sound, 22_000)
    return vertices


def test_vocaset_folder_is_read(tmp_path, rng):
    vertices = vocaset(tmp_path / "v", rng)
    folder = open_meshes(tmp_path / "v", MeshDataConfig(), tmp_path / "built")
    assert folder.unit_mm == 1000
    splits = {clip.name: clip.split for clip in folder.clips}
    assert splits["ann.sentence01"] == splits["bob.sentence02"] == "train"
    assert splits["cyd.sentence01"] == "validation"
    assert folder.lips is None
    for clip in folder.split("train"):
        s, r = pack_vertices(folder.templates[clip.speaker], vertices[clip.name])
        kept = (getattr(folder.bases, k).expand(clip.motion()[k]) for k in ("stretch", "rotation"))
        for given, wanted in zip(kept, (s, r), strict=True):  # noise: all of it is in the basis
            assert np.abs(given - wanted).max() < 0.02 * np.abs(wanted).max()
        assert len(clip.waveform()) == pytest.approx(6 / 60 * RATE, abs=2)  # 22 kHz to 16


def test_heads_act_a_dataset_folder(tmp_path):
    data = write_dataset(tmp_path / "d", 3, 2, 2.0)
    config = MeshDataConfig(fps=30, identities=(2, 3), clips=2, validation_clips=1, basis_frames=60)
    folder = open_meshes(data, config, tmp_path / "m")
    assert folder.unit_mm == 10
    first, second, third = folder.clips
    assert first.speaker == third.speaker != second.speaker
    assert [c.split for c in folder.clips] == ["train", "train", "validation"]
    assert set(folder.templates) == set(head_templates((2, 3)))
    controls, head = default_controls(), build_head(2)
    motion = first.motion()
    assert len(motion["stretch"]) == 60
    s, r = (getattr(folder.bases, k).expand(motion[k][[10, 27]]) for k in ("stretch", "rotation"))
    out = mesh_solver(folder.templates[first.speaker]).solve(s, r)
    shut, opened = (controls.rest.copy() for _ in range(2))
    opened[controls.index(JAW)] = 0.6  # 0.9 s is within the first burst
    for name in ("CTRL_L_mouth_lipsTogetherU.ty", "CTRL_L_mouth_lipsTogetherD.ty"):
        shut[controls.index(name)] = 1
    assert CLICKS[0] < 27 / 30 < CLICKS[0] + 0.2
    lips = head_lips()
    np.testing.assert_array_equal(folder.lips.both, lips.both)
    for i, values in enumerate((shut, opened)):
        truth = head.pose(values)[head.slices["cage"]]
        np.testing.assert_allclose(out[i], truth, atol=0.1)  # cm
        assert np.abs(out[i] - truth).mean() < 1e-2
        rims = motion["lips"][[10, 27][i]]
        np.testing.assert_allclose(rims, (truth - head.cage.vertices)[lips.both], atol=1e-4)
    with pytest.raises(DataError, match=r"set data\.fps=30"):
        open_meshes(data, MeshDataConfig(), tmp_path / "m")
