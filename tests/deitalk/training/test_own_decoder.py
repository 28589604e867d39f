"""A user's own decoder: a class that the settings name, whose models load where it is known."""

import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

import deitalk
from deitalk.data.clips import read_clips
from deitalk.errors import CheckpointError, ConfigError
from deitalk.models.checkpoint import load_model
from deitalk.models.folder import GRAPH
from deitalk.models.rig_decoder import RigDecoder

NAME = f"{__name__}:Recurrent"
SETTINGS = {
    "model.own_decoder": NAME,
    "train.batch_size": 2,
    "train.evaluate_every": 2,
    "train.workers": 0,
    "data.window_frames": 32,
}


class Recurrent(RigDecoder):
    """A recurrent layer in place of the convolutions."""

    def __init__(self, **sizes):
        super().__init__(**sizes)
        width = self.layers[0].conv.in_channels
        self.layers = nn.ModuleList()
        self.recurrent = nn.GRU(width, sizes["channels"], batch_first=True)

    def hidden(self, speech, emotion, guidance):
        rows = torch.cat(self.inputs(speech, emotion, guidance), dim=1)
        return self.with_speech(self.recurrent(rows.transpose(1, 2))[0], speech)


@pytest.fixture(scope="module")
def tuned(base, data, tmp_path_factory):
    """A model with it, tuned by the regression, and by two steps more."""
    out = tmp_path_factory.mktemp("own") / "run"
    return deitalk.finetune(data, out, base=base, settings=SETTINGS | {"train.steps": 2})


def test_a_tuned_model_has_it_and_the_captures_teach_it(tuned, data):
    model = load_model(tuned.model)
    assert type(model.decoder) is Recurrent and type(model.decoder.kept) is RigDecoder
    assert tuned.scores["after"]["error_of_mean_pose"] < 1
    assert not (tuned.model / GRAPH).exists(), "what it does between the layers is not known"
    performance = deitalk.animate(read_clips(data)[0].audio, "happy", model=tuned.model)
    assert np.isfinite(performance.curves.values).all()
    assert "learning_rate" not in (tuned.model / "config.yaml").read_text()


LOADED = """
    from deitalk.errors import CheckpointError
    from deitalk.models.checkpoint import load_model
    try:
        print(type(load_model({model!r}).decoder).__name__)
    except CheckpointError as error:
        print(error)
    import {module}
    print(type(load_model({model!r}).decoder).__name__)
"""
UNKNOWN = f"own decoder '{NAME}' is not known; import its module before"
ENTRY = f"[deitalk.decoders]\nrecurrent = {NAME}\n"


@pytest.mark.parametrize(
    ("entry", "first"),
    [pytest.param(ENTRY, "Recurrent", id="entry", marks=pytest.mark.thorough), ("", UNKNOWN)],
)
def test_its_models_load_where_the_class_is_installed_or_imported(tuned, tmp_path, entry, first):
    """Else nothing is imported: a model folder does not choose what is executed."""
    if entry:
        about = tmp_path / "mine-1.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1\n")
        (about / "entry_points.txt").write_text(entry)
    code = textwrap.dedent(LOADED).format(module=__name__, model=str(tuned.model))
    code = f"import sys; sys.path.append({str(tmp_path)!r})\n{code}"
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=root)
    said, last = done.stdout.splitlines()
    assert said.startswith(first) and last == "Recurrent", done.stdout + done.stderr


@pytest.mark.parametrize(
    "name", ["os.system", "os:system", "deitalk.models.rig_decoder:RigDecoder"]
)
def test_what_is_no_decoder_is_refused(base, data, tmp_path, name):
    with pytest.raises((CheckpointError, ConfigError), match=r"own_decoder|own decoder"):
        deitalk.finetune(data, tmp_path / "run", base=base, settings={"model.own_decoder": name})
    assert not (tmp_path / "run").exists()
