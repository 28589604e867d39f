"""The lip seal, by hand, on an embedded head."""

import numpy as np
import pytest

from deitalk.errors import ConfigError
from deitalk.models.deformation_decoder import InversePCA
from deitalk.postprocess.lip_seal import known_skins, seal_lips
from deitalk.research.config import ComparedSDFAModelConfig
from deitalk.research.meshes.sources import head_templates
from deitalk.research.meshes.training import new_mesh_model
from tests.deitalk.models.test_mesh_model import VOCA, sheet


def parted(gap_mm):
    """A known skin in three frames: at rest, parted by `gap_mm`, wide open."""
    skin, template = known_skins()[0], next(iter(head_templates((0,)).values()))
    frames = np.tile(template.vertices.astype(np.float32), (3, 1, 1))
    for lip, sign in zip(skin.lips, (1, -1), strict=True):
        move = np.zeros((3, len(lip.weight), 3))
        move[..., 1] = sign * np.array([0, gap_mm, 20.0])[:, None] / 20  # cm, half a gap
        frames[:, lip.reach] += lip.along(move)
    return frames, skin.lips


def gaps_mm(frames, lips):
    """Mean gap of the middle of the lips [shape=(T,)]."""
    upper, lower = (lip.weight @ frames[:, lip.rim, 1].T for lip in lips)
    return 10 * (upper - lower)[13:-13].mean(axis=0)


@pytest.mark.parametrize(("gap_mm", "left"), [(0.5, 0), (0.9, 0), (1.5, 0.5), (3.4, 1)])
def test_seal_lips_by_hand(gap_mm, left):
    frames, lips = parted(gap_mm)
    given, sealed = gaps_mm(frames, lips), seal_lips(frames, 2.0, 10)
    gaps = gaps_mm(sealed, lips)
    assert gaps[0] < 0.1 and gaps[2] == pytest.approx(given[2], abs=1e-3)
    if left in (0, 1):
        assert gaps[1] == pytest.approx(left * given[1], abs=0.2)
    else:
        assert 0.1 * given[1] < gaps[1] < 0.9 * given[1]
    far = np.linalg.norm(sealed - frames, axis=-1)[1] * 10
    assert far.max() < 0.65 * (given[1] - gaps[1] + 1)  # the lower lip's part is 0.6
    assert (far > 0.01).mean() < 0.25  # of the head
    np.testing.assert_array_equal(sealed[2], frames[2])


def test_new_mesh_model_rejects_a_seal_of_other_faces():
    with pytest.raises(ConfigError, match=r"seal_mm=2: only the embedded heads"):
        new_mesh_model(
            ComparedSDFAModelConfig(frontend=VOCA, motion="offsets", seal_mm=2),
            {"offsets": InversePCA(1, 48)},
            {"ann": sheet(4)},
            fps=30,
            unit_mm=10,
        )


def test_seal_lips_with_reach_0_changes_nothing():
    frames, _ = parted(0.5)
    assert seal_lips(frames, 0.0, 10) is frames
