"""The lip seal, by hand, on an embedded head."""

import numpy as np
import pytest

from deitalk.config.mesh import SDFAModelConfig
from deitalk.errors import ConfigError
from deitalk.models.deformation_decoder import InversePCA
from deitalk.postprocess.known_phones import seal_lips
from deitalk.research.meshes.folder import head_lips, head_templates
from deitalk.research.meshes.scores import lip_gap
from deitalk.research.meshes.training import new_mesh_model
from tests.deitalk.models.test_mesh_model import VOCA, sheet
from tests.each import each


def parted(gap_mm):
    """A head's skin in three frames: closed, parted by `gap_mm`, wide open."""
    template = next(iter(head_templates((0,)).values()))
    lips, frames = head_lips(), np.tile(template.vertices.astype(np.float32), (3, 1, 1))
    middle = 0.5 * (frames[:, lips.upper] + frames[:, lips.lower])
    half = np.array([0, gap_mm, 20.0])[:, None] / 20  # cm, half a gap
    for rim, sign in ((lips.upper, 1), (lips.lower, -1)):
        frames[:, rim] = middle
        frames[:, rim, 1] += sign * half
    return frames, lips


@each(("gap_mm", "left_mm"), [(0.9, 0), (1.0, 0), (1.5, 0.75), (2.0, 2.0)])
def test_seal_lips_by_hand(gap_mm, left_mm):
    frames, lips = parted(gap_mm)
    sealed = seal_lips(frames, 2.0, 10)
    gaps = lip_gap(sealed, lips, 10)
    np.testing.assert_allclose(gaps, [0, left_mm, 20], atol=1e-3)
    far = np.linalg.norm(sealed - frames, axis=-1)[1] * 10
    assert far.max() == pytest.approx((gap_mm - left_mm) * 0.62, abs=1e-3)  # the lower lip's part
    assert (far > 0).mean() < 0.2  # of the head
    np.testing.assert_array_equal(sealed[2], frames[2])


def test_new_mesh_model_rejects_a_seal_of_other_faces():
    with pytest.raises(ConfigError, match=r"seal_mm=2: only the embedded heads"):
        new_mesh_model(
            SDFAModelConfig(frontend=VOCA, motion="offsets", seal_mm=2),
            {"offsets": InversePCA(1, 48)},
            {"ann": sheet(4)},
            fps=30,
            unit_mm=10,
        )


def test_seal_lips_with_reach_0_changes_nothing():
    frames, _ = parted(0.5)
    assert seal_lips(frames, 0.0, 10) is frames
