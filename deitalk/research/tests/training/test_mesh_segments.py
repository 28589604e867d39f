"""Mesh sequences: folders in and out, spectra in time with their frames, segments, bases."""

import numpy as np

from deitalk.config.frontends import SDFAMelConfig
from deitalk.frontends.sdfa_encoder import SDFAEncoder
from deitalk.research.meshes.folder import Lips, MeshSequence, read_mesh_folder, write_mesh_folder
from deitalk.research.meshes.mesh_bases import fit_mesh_bases
from deitalk.research.meshes.packing import pack_vertices
from deitalk.research.meshes.segments import Segments
from rig.mesh import TriMesh
from rig.mesh.deformation import mesh_solver

RATE = 16_000
SMALL = SDFAMelConfig(
    window_seconds=0.032, frame_rate=125, n_mels=16, window_frames=16, query_frames=3
)
ENCODER = SDFAEncoder(SMALL)
LIPS = Lips(np.array([21, 22]), np.array([16, 17]))


def sheet(n=5, size=8.0):
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n))
    vertices = np.stack([x.ravel(), y.ravel(), 0.05 * x.ravel() ** 2], axis=1)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (corner[i : n - 1 + i, j : n - 1 + j].ravel() for i in (0, 1) for j in (0, 1))
    return TriMesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))


def moved(template, n_frames, rng):
    """Smooth motion of all but the first vertices (where the solver is pinned)."""
    phase = 2 * np.pi * np.arange(n_frames)[:, None, None] / 83  # no two alike
    shape = rng.standard_normal((2, *template.vertices.shape)) * 0.2
    shape[:, template.vertices[:, 2] < 1e-9] = 0
    return template.vertices + np.sin(phase) * shape[0] + np.cos(phase) * shape[1]


def sequence(name, speaker, split, template, rng, n_frames=30, fps=30):
    waveform = (0.1 * rng.standard_normal(n_frames * RATE // fps)).astype(np.float32)
    waveform -= waveform.mean()  # reading takes a recording's mean away
    vertices = moved(template, n_frames, rng).astype(np.float32)
    return MeshSequence(name, speaker, split, lambda: (waveform, vertices))


def written(tmp_path, rng, n_frames=30):
    templates = {"ann": sheet(), "bob": sheet(size=10.0)}
    sequences = [
        sequence("a1", "ann", "train", templates["ann"], rng, n_frames),
        sequence("b1", "bob", "train", templates["bob"], rng, 2 * n_frames),
        sequence("a2", "ann", "validation", templates["ann"], rng, n_frames),
    ]
    write_mesh_folder(
        tmp_path / "m", templates, sequences, fps=30, unit_mm=10, lips=LIPS, basis_error_mm=0.01
    )
    return read_mesh_folder(tmp_path / "m"), sequences


def segments(folder, augment=False, **options):
    options = {"batch_size": 4, "n_frames": 2, "seed": 0} | options
    return Segments(
        folder.split("train"),
        folder.training_speakers,
        folder.fps,
        ENCODER,
        augment=augment,
        **options,
    )


def test_bases_keep_a_share_of_the_variance_with_all_triangles_alike():
    """As the paper has it: plain principal components of s and r (§4.4)."""
    template = sheet()
    rng = np.random.default_rng(0)
    moving = template.vertices + 0.02 * rng.standard_normal((60, 25, 3))
    bases = fit_mesh_bases(
        {"ann": template}, [("ann", lambda: moving)], [("ann", lambda: moving)],
        n_frames=60, error_mm=1e-9, unit_mm=10, variance=0.97, weigh_triangles=False,
    )  # fmt: skip
    s, r = pack_vertices(template, moving)
    for values, basis in ((s, bases.stretch), (r, bases.rotation)):
        power = np.linalg.svd(values - values.mean(axis=0), compute_uv=False) ** 2
        share = np.cumsum(power) / power.sum()
        assert len(basis.components) == 1 + np.searchsorted(share, 0.97)
        np.testing.assert_array_equal(basis.weights, 1)
        left = values - basis.expand(basis.project(values))
        assert (left**2).sum() <= 0.0301 * power.sum()


def test_bases_keep_held_out_frames_within_the_bound():
    rng = np.random.default_rng(0)
    template = sheet()
    shapes = 0.05 * rng.standard_normal((4, 25, 3))
    shapes[:, template.vertices[:, 2] < 1e-9] = 0

    def acted(seed, n_frames=80):
        weights = np.random.default_rng(seed).standard_normal((n_frames, 4))
        moving = template.vertices + np.einsum("tk,kvc->tvc", weights, shapes)
        return [("ann", lambda: moving.astype(np.float32))]

    def fitted(bound):
        return fit_mesh_bases(
            {"ann": template}, acted(0), acted(1), n_frames=400, error_mm=bound, unit_mm=10
        )

    loose, tight = fitted(1.0), fitted(0.2)
    for bases, bound in ((loose, 1.0), (tight, 0.2)):
        for kind in (0.0, 1.0):
            rows = [row for row in bases.table if row["offsets"] == kind]
            assert rows[-1]["lively_p99_mm"] <= bound
            assert all(row["lively_p99_mm"] > bound for row in rows[:-1])
        assert rows[-1]["first"] == len(bases.offsets.components)
    assert len(tight.table) > len(loose.table)
    assert len(tight.offsets.components) == 4  # as many as there are shapes
    frames = acted(1)[0][1]()[::9]
    s, r = pack_vertices(template, frames)
    kept = (
        tight.stretch.expand(tight.stretch.project(s)),
        tight.rotation.expand(tight.rotation.project(r)),
    )
    error = np.linalg.norm(mesh_solver(template).solve(*kept) - frames, axis=-1)
    assert error.mean() * 10 < 0.2
