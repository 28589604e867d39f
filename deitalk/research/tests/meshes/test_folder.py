"""The mesh folder: motion comes back through it, and damaged files are refused."""

import json

import numpy as np
import pytest

from deitalk.errors import DataError
from deitalk.research.meshes.folder import MeshSequence, read_mesh_folder, write_mesh_folder
from deitalk.research.meshes.packing import pack_vertices
from deitalk.research.tests.training.test_mesh_segments import RATE, sequence, sheet, written
from rig.mesh.deformation import mesh_solver


def test_vertices_come_back_through_the_folder(tmp_path, rng):
    folder, sequences = written(tmp_path, rng)
    assert (folder.fps, folder.unit_mm) == (30, 10)
    assert folder.training_speakers == ("ann", "bob")
    assert [c.name for c in folder.split("validation")] == ["a2"]
    for clip, source in zip(folder.clips[:2], sequences, strict=False):
        waveform, vertices = source.load()
        template, motion = folder.templates[clip.speaker], clip.motion()
        s, r = (getattr(folder.bases, k).expand(motion[k]) for k in ("stretch", "rotation"))
        out = mesh_solver(template).solve(s, r)
        np.testing.assert_allclose(out, vertices, atol=2e-2)  # cm: 0.2 mm
        offsets = folder.bases.offsets.expand(motion["offsets"]).reshape(vertices.shape)
        np.testing.assert_allclose(template.vertices + offsets, vertices, atol=2e-2)
        np.testing.assert_allclose(
            motion["lips"], (vertices - template.vertices)[:, [21, 22, 16, 17]], atol=1e-6
        )
        np.testing.assert_allclose(clip.waveform(), waveform, atol=1e-4)


def test_triangles_at_rest_are_skipped_with_equal_results(tmp_path, rng):
    """The sheet's first row stays: its numbers must be those of the whole computation, zero."""
    folder, sequences = written(tmp_path, rng)
    template, (_, vertices) = folder.templates["ann"], sequences[0].load()
    vertices = vertices.copy()
    vertices[:, :15] = template.vertices[:15]
    one = MeshSequence("x", "ann", "train", lambda: (np.zeros(RATE, np.float32), vertices))
    write_mesh_folder(
        tmp_path / "n", {"ann": template}, [one], fps=30, unit_mm=10, basis_error_mm=0.001
    )
    bases = read_mesh_folder(tmp_path / "n").bases
    stays = np.abs(vertices - template.vertices).max(axis=(0, 2)) < 1e-6
    still = stays[template.faces].all(axis=1)
    assert 16 <= still.sum() < 20
    s, r = pack_vertices(template, vertices)
    motion = read_mesh_folder(tmp_path / "n").clips[0].motion()
    np.testing.assert_allclose(bases.stretch.expand(motion["stretch"]), s, atol=5e-2)
    np.testing.assert_allclose(bases.rotation.expand(motion["rotation"]), r, atol=5e-2)
    assert np.abs(s).max() > 0.3
    kept = bases.stretch.components.reshape(-1, len(still), 6)
    assert (kept[:, still] == 0).all() and (kept[:, ~still] != 0).any(axis=(0, 2)).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"speaker": "eve"}, "'eve' has no template"),
        ({"split": "dev"}, "split 'dev' is unknown"),
        ({"name": "../x"}, "must be usable as a file's"),
        ({"name": ""}, "must be usable as a file's"),
    ],
)
def test_write_mesh_folder_rejects_a_bad_sequence_and_writes_nothing(tmp_path, rng, change, said):
    template = sheet()
    values = {"name": "a", "speaker": "ann", "split": "train"} | change
    one = sequence(**values, template=template, rng=rng)
    with pytest.raises(DataError, match=said):
        write_mesh_folder(tmp_path / "m", {"ann": template}, [one], fps=30, unit_mm=10)
    assert not list(tmp_path.iterdir())


def test_read_mesh_folder_rejects_damaged_files(tmp_path, rng):
    folder, _ = written(tmp_path, rng)
    path = tmp_path / "m"
    rows = np.zeros((3, 1), np.float16)
    np.savez(path / "motion/a1.npz", stretch=rows, rotation=rows, offsets=rows[:2])
    with pytest.raises(DataError, match=r"arrays of \[2, 3\] frames"):
        folder.clips[0].motion()
    (path / "motion/a1.npz").write_bytes(b"no")
    with pytest.raises(DataError, match=r"a1\.npz: cannot be read"):
        folder.clips[0].motion()
    lips = (path / "lips.npz").read_bytes()
    (path / "lips.npz").write_bytes(b"no")
    with pytest.raises(DataError, match=r"lips\.npz: cannot be read"):
        read_mesh_folder(path)
    (path / "lips.npz").write_bytes(lips)
    bases = (path / "bases.npz").read_bytes()
    (path / "bases.npz").write_bytes(b"no")
    with pytest.raises(DataError, match="build it again"):
        read_mesh_folder(path)
    (path / "bases.npz").write_bytes(bases)
    table = (path / "clips.csv").read_text()
    (path / "clips.csv").write_text(table.replace("a1,", "../a1,"))
    with pytest.raises(DataError, match="leaves the folder"):
        read_mesh_folder(path)
    (path / "clips.csv").write_text(table.replace(",bob,", ",eve,"))
    with pytest.raises(DataError, match="'eve' has no template"):
        read_mesh_folder(path)
    (path / "mesh.json").write_text(json.dumps({"format_version": 99, "fps": 1, "unit_mm": 1}))
    with pytest.raises(DataError, match="version 99"):
        read_mesh_folder(path)
    (path / "mesh.json").write_text("{}")
    with pytest.raises(DataError, match="no mesh folder"):
        read_mesh_folder(path)
