"""Lips as a linear function of the coefficients."""

from pathlib import Path

import numpy as np
import torch

from deitalk.research.meshes.folder import read_mesh_folder
from deitalk.research.meshes.lip_regression import LipRegression
from deitalk.research.tests.training.test_mesh import write_sheets
from tests.deitalk.models.test_mesh_model import LIPS


def test_lips_are_exact_where_motion_is_linear(tmp_path: Path):
    """Offsets to lips is linear by definition; what is left is float16 and the basis."""
    folder = read_mesh_folder(write_sheets(tmp_path / "m"))
    clips = [(c.motion(), folder.training_speakers.index(c.speaker)) for c in folder.clips]
    lips = LipRegression.fit(clips, folder, motion="offsets")
    assert lips.residual_mm < 0.1
    motion, place = clips[1]
    rows = torch.from_numpy(motion["offsets"])[None]
    predicted = lips({"offsets": rows}, torch.eye(2)[[place]])[0]
    np.testing.assert_allclose(predicted, 10 * motion["lips"], atol=0.5)  # mm
    rest = folder.templates["ann"].vertices
    parting = 10 * (rest[LIPS.upper] - rest[LIPS.lower])
    np.testing.assert_allclose(lips.rest_parting(torch.eye(2)[:1])[0, 0], parting, atol=1e-4)
