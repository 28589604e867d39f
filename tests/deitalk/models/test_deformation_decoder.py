"""Table 3: sizes, parameters counted by hand, and a last layer that is not trained."""

import numpy as np
import pytest
import torch

from deitalk.models.deformation_decoder import InversePCA, MotionDecoder
from deitalk.research.meshes.gradient_bases import Bases, fit_basis
from deitalk.research.meshes.packing import pack_vertices
from deitalk.research.meshes.training import frozen_layer
from rig.mesh.trimesh import TriMesh, triangle_areas

PAPER_TRIANGLES = 9976


def decoder(n=7, sizes=(3, 4), **options):
    torch.manual_seed(0)
    layers = frozen(sizes, n)
    for layer in layers.values():
        layer.components.normal_()
        layer.mean.normal_()
    return MotionDecoder(12, 2, layers, shared=10, hidden=(8, 6), **options)


def frozen(sizes, n):
    return {"stretch": InversePCA(sizes[0], 6 * n), "rotation": InversePCA(sizes[1], 3 * n)}


def decode(model, attended, speaker):
    return model.expand(model(attended, speaker))


def grid(n=4):
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    vertices = np.stack([x.ravel(), y.ravel(), 0.1 * x.ravel() ** 2], axis=1)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (corner[i : n - 1 + i, j : n - 1 + j].ravel() for i in (0, 1) for j in (0, 1))
    return TriMesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))


@pytest.fixture
def fitted(rng):
    template = grid()
    moved = template.vertices + 0.1 * rng.standard_normal((9, *template.vertices.shape))
    s, r = pack_vertices(template, moved)
    areas = triangle_areas(template)
    return Bases(fit_basis(s, areas), fit_basis(r, areas), ()), s, r


def test_layer_sizes_are_those_of_table_3():
    with torch.device("meta"):
        model = MotionDecoder(512, 8, frozen((85, 180), PAPER_TRIANGLES), normalise_weights=False)
        out = decode(model, torch.zeros(2, 512), torch.zeros(2, 8))
    assert out.s.shape == (2, 59856)  # printed as 59865, which 6 does not divide
    assert out.r.shape == (2, 29928)
    shapes = {name: tuple(p.shape) for name, p in model.named_parameters() if p.ndim == 2}
    assert shapes == {
        "shared.0.weight": (512, 520),
        "branches.stretch.coefficients.0.weight": (512, 520),
        "branches.stretch.coefficients.2.weight": (256, 512),
        "branches.stretch.coefficients.4.weight": (85, 256),
        "branches.rotation.coefficients.0.weight": (512, 520),
        "branches.rotation.coefficients.2.weight": (256, 512),
        "branches.rotation.coefficients.4.weight": (180, 256),
    }
    fixed = sum(
        b.numel() for name, b in model.named_buffers() if name.endswith(("mean", "components"))
    )
    assert fixed * 4 / 2**20 == pytest.approx(66.9 - 26.63, abs=0.05)  # §4.4: the part from PCA


def test_number_of_parameters_by_hand():
    def layer(n_in, n_out):  # direction, length (weight normalisation), bias
        return n_out * n_in + n_out + n_out

    branches = sum(layer(520, 512) + layer(512, 256) + layer(256, k) for k in (85, 180))
    model = MotionDecoder(512, 8, frozen((85, 180), 1))
    assert sum(p.numel() for p in model.parameters()) == layer(520, 512) + branches == 1_133_330


def test_projected_frames_come_back_and_coefficients_have_unit_variance(fitted):
    bases, s, r = fitted
    for basis, frames in zip((bases.stretch, bases.rotation), (s, r), strict=True):
        layer = frozen_layer(basis)
        coefficients = basis.project(frames)
        np.testing.assert_allclose(coefficients.std(axis=0, ddof=1), 1, atol=2e-2)
        back = layer(torch.from_numpy(coefficients).float()).numpy()
        np.testing.assert_allclose(back, frames, atol=5e-3)


def test_speaker_is_joined_twice():
    """Without its input to the shared layer it still changes both branches, and vice versa."""
    x, speakers = torch.randn(1, 12), torch.eye(2)
    for where in ("shared", "branches"):
        model = decoder(normalise_weights=False)
        with torch.no_grad():
            if where == "shared":
                model.shared[0].weight[:, -2:] = 0
            else:
                for branch in model.branches.values():
                    branch.coefficients[0].weight[:, -2:] = 0
        one, two = (decode(model, x, speaker[None]) for speaker in speakers)
        assert (one.s - two.s).abs().max() > 1e-4
        assert (one.r - two.r).abs().max() > 1e-4
