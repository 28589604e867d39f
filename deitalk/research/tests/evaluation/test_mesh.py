"""Scores of mesh models: gaps by hand, a model at rest, refused models and folders."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from deitalk.config.load import parse_config
from deitalk.errors import CheckpointError, DataError
from deitalk.models.checkpoint import save_model
from deitalk.models.deformation_decoder import InversePCA
from deitalk.research.cli import app
from deitalk.research.config import ComparedSDFAModelConfig
from deitalk.research.meshes.folder import Lips
from deitalk.research.meshes.scores import as_markdown, evaluate_mesh, lip_gap, smallest_gaps
from deitalk.research.meshes.sources import act, acted_clips, head_lips, head_templates
from deitalk.research.meshes.training import new_mesh_model
from rig.mesh import TriMesh
from tests.command import ran
from tests.dataset import write_dataset

VOCA = {"kind": "voca", "n_mels": 16, "n_mfcc": 10, "channels": [8, 8, 12, 12]}


def still(templates=None):
    """A model of vertex offsets with lips at rest."""
    templates = templates or head_templates((0,))
    config = ComparedSDFAModelConfig(
        frontend=VOCA, motion="offsets", shared_size=None, branch_sizes=()
    )
    count = len(next(iter(templates.values())).vertices)
    layers = {"offsets": InversePCA(1, 3 * count)}
    return new_mesh_model(config, layers, templates, fps=30, unit_mm=10).eval()


def test_lip_gap_by_hand():
    """Eight pairs; the middle four are 2, 2, 2 and 6 mm apart, the outer ones are not used."""
    lips = Lips(np.arange(8), np.arange(8, 16))
    vertices = np.zeros((2, 16, 3))
    vertices[0, :8, 1] = [9, 9, 0.2, 0.2, 0.2, 0.6, 9, 9]
    np.testing.assert_allclose(lip_gap(vertices, lips, 10), [3, 0])
    np.testing.assert_allclose(lip_gap(-vertices, lips, 10), [3, 0])  # crossed lips are not closed


def test_smallest_gaps_by_hand():
    gap = np.full(60, 5.0)
    gap[10] = 0.5  # 0.333 s
    gap[30] = 2.0
    phones = [
        (0.0, 0.25, "AA1"),  # too near to the /p/
        (0.25, 0.28, "S"),
        (0.28, 0.30, "P"),  # its gap comes one frame later: within the window
        (0.5, 0.9, "IY"),
        (0.9, 1.1, "M"),
        (1.1, 1.3, "S"),
        (1.6, 1.9, "AE0"),
        (3.0, 3.1, "B"),  # after the clip's end
    ]
    bilabials, after_s, vowels = smallest_gaps(gap, phones, 30)
    assert bilabials == [0.5, 2.0]
    assert after_s == [0.5]
    assert vowels == [5.0]


def test_scores_of_a_head_at_rest(tmp_path):
    data = write_dataset(tmp_path / "d", 1, 5)
    model = still()
    report = evaluate_mesh(model, data, split="validation")
    scores = report["groups"]["all"]
    (clip,) = acted_clips(data, "validation", ["neutral"], None)
    _, truth = act(clip, model.speakers[0], 30)
    lips = head_lips().both
    moved = 10 * np.linalg.norm((truth - model.template(0).vertices)[:, lips], axis=-1)
    assert scores["clips"] == 1
    assert scores["lips_mm"] == pytest.approx(moved.mean(), rel=1e-4)
    assert scores["lips_mm"] == pytest.approx(scores["still_mm"], rel=1e-4)
    assert scores["lips_mm"] > scores["mesh_mm"] > 0
    # The dataset's lips are shut but for its bursts: M at 0.7 s is shut, AA at 0.8 s is open.
    assert scores["bilabials"] == 1
    assert scores["truth_bilabial_closed"] == 1
    assert scores["bilabial_closed"] == 1  # lips at rest touch
    assert scores["vowel_closed"] == 1  # and never open
    assert "closed to 1 mm" in as_markdown(report)


def test_unsuitable_models_and_folders_are_refused(tmp_path):
    data = write_dataset(tmp_path / "d", 1, 1)
    ((name, template),) = head_templates((0,)).items()
    with pytest.raises(CheckpointError, match="'ann' is no embedded head"):
        evaluate_mesh(still({"ann": template}), data)
    small = TriMesh(template.vertices[:3], template.faces[:1] * 0 + [[0, 1, 2]])
    with pytest.raises(CheckpointError, match="no embedded head"):
        evaluate_mesh(still({name: small}), data)
    with pytest.raises(DataError, match="no neutral clips"):
        evaluate_mesh(still(), data, split="test")
    with pytest.raises(DataError, match="no neutral clips"):  # none has s before m
        evaluate_mesh(still(), data, split="train", transitions=True)


def test_command_writes_a_report_and_refuses_other_options(tmp_path):
    data = write_dataset(tmp_path / "d", 1, 5)
    config = parse_config(
        {
            "kind": "sdfa_compared",
            "model": {
                "frontend": VOCA,
                "motion": "offsets",
                "shared_size": None,
                "branch_sizes": [],
            },
        }
    )
    save_model(tmp_path / "m", still(), config, {})
    arguments = ["evaluate", str(tmp_path / "m"), "--data", str(data), "--split", "validation"]
    result = ran(*arguments, "-o", tmp_path / "r.json")
    assert "| p b m |" in result.output
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["encoder"] == "voca" and report["groups"]["all"]["bilabials"] == 1
    for wrong in (("--noise", "pink"), ("-o", str(tmp_path / "r.txt"))):
        refused = CliRunner().invoke(app, [*arguments, *wrong])
        assert isinstance(refused.exception, DataError)
