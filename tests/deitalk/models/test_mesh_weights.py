"""Folders of mesh models: round trips, what is not stored, trimmed bases, damaged files."""

import numpy as np
import pytest
import torch

from deitalk.errors import CheckpointError
from deitalk.models.checkpoint import load_model, require_model, save_model
from deitalk.models.folder import describe_model
from deitalk.models.mesh_model import MeshModel
from deitalk.pipeline.mesh import mesh_coefficients
from deitalk.research.meshes.predict import predict_mesh
from deitalk.research.training.trim import trimmed
from tests.deitalk.models.test_mesh_model import model, noise, tiny


def test_saved_model_read_again_predicts_the_same(tmp_path):
    sdfa = model()
    save_model(tmp_path / "m", sdfa, tiny(), {"step": 3}, half_bases=False)
    back = load_model(tmp_path / "m")
    assert back.speakers == ("ann", "bob")
    assert (back.fps, back.unit_mm) == (60, 10)
    sound = noise(0.3)
    np.testing.assert_array_equal(predict_mesh(back, sound, 1), predict_mesh(sdfa, sound, 1))
    about = describe_model(tmp_path / "m")
    assert about["training"] == {"step": 3}
    assert about["parameters"] == sum(p.numel() for p in sdfa.parameters())
    save_model(tmp_path / "h", sdfa, tiny(), {})
    small = (tmp_path / "h/model.safetensors").stat().st_size
    whole = (tmp_path / "m/model.safetensors").stat().st_size
    basis = sum(b.numel() for n, b in sdfa.named_buffers() if "inverse_pca" in n)
    assert whole - small == pytest.approx(2 * basis, abs=64)
    save_model(tmp_path / "s", sdfa, tiny(), {}, half=True)
    smallest = (tmp_path / "s/model.safetensors").stat().st_size
    assert smallest < 0.6 * whole
    loaded = load_model(tmp_path / "s")
    assert next(loaded.parameters()).dtype == torch.float32
    np.testing.assert_allclose(predict_mesh(loaded, sound), predict_mesh(sdfa, sound), atol=2e-2)


def test_numbers_that_never_move_are_not_stored(tmp_path):
    sdfa = model()
    layer = sdfa.decoder.branches["stretch"].inverse_pca
    save_model(tmp_path / "a", sdfa, tiny(), {}, half_bases=False)
    layer.components[:, 10:100] = 0
    save_model(tmp_path / "b", sdfa, tiny(), {}, half_bases=False)
    one, other = ((tmp_path / n / "model.safetensors").stat().st_size for n in "ab")
    assert one - other == pytest.approx(4 * 90 * (3 + 1), abs=64)  # components and mean
    back = load_model(tmp_path / "b").decoder.branches["stretch"].inverse_pca
    assert torch.equal(back.components, layer.components)


def test_trimmed_bases_keep_their_first_components():
    """Components are ordered: two of three are the first two."""
    sdfa = model()
    small = trimmed(sdfa, {"stretch": 2})
    assert small.decoder.branches["stretch"].inverse_pca.components.shape == (2, 108)
    (rows,), (fewer,) = (list(mesh_coefficients(m, noise(0.3))) for m in (sdfa, small))
    torch.testing.assert_close(fewer["stretch"], rows["stretch"][:, :2])
    torch.testing.assert_close(fewer["rotation"], rows["rotation"])
    for sizes, said in (({"stretch": 4}, "4 of 3"), ({"offsets": 1}, "no branch")):
        with pytest.raises(CheckpointError, match=said):
            trimmed(sdfa, sizes)


def test_load_model_rejects_damaged_templates(tmp_path):
    save_model(tmp_path / "m", model(), tiny(), {})
    (tmp_path / "m/templates.npz").write_bytes(b"no")
    with pytest.raises(CheckpointError, match="no archive of numpy arrays"):
        load_model(tmp_path / "m")
    (tmp_path / "m/config.yaml").write_text("name: other\n")
    with pytest.raises(CheckpointError, match="made for control set 'none"):
        load_model(tmp_path / "m")
    with pytest.raises(CheckpointError, match="no model there"):
        require_model(tmp_path / "nothing", MeshModel)
