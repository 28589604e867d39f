"""Contacts of the lips of a tuned model: those of its base, unless captures tell them better."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk.config.rules import SharpenContacts
from deitalk.data.clips import read_clips
from deitalk.data.waveforms import read_waveform
from deitalk.emotions import EMOTIONS
from deitalk.evaluation.smoothness import lips_together
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.research.config import read_training
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.training.tuning.task import finetune
from rig import RigCurves, default_controls, read_curves, write_curves
from tests.dataset import JAW, jaw
from tests.deitalk.training.conftest import TINY, recipe, relabelled

CONTROLS = default_controls()
CONTACTS = [n for n in CONTROLS.names if "lipsTogether" in n or "lipBiteD" in n]
SPEECH = np.pad(speechlike(1.5), (4000, 4000))
NUMBERS = SharpenContacts(shoulder=0.31)


@pytest.fixture(scope="module")
def reader(tmp_path_factory) -> str:
    """A network of random weights with a readout of the lips, whose contacts move."""
    folder = tmp_path_factory.mktemp("reader") / "model"
    torch.manual_seed(0)
    config = read_training(TINY)
    config = config.model_copy(
        update={
            "model": config.model.model_copy(update={"lips": True}),
            "rules": config.rules.model_copy(update={"sharpen_contacts": NUMBERS}),
        }
    )
    model = DEITalk(config.model)
    with torch.no_grad():
        model.decoder.output.weight.normal_(std=0.05)
        model.decoder.style.weight.normal_(std=1.0)
        model.decoder.output.bias[[CONTROLS.index(name) for name in CONTACTS]] = 0.5
        model.lips.listen.weight.normal_(std=1.0)
        model.lips.phones.weight.normal_(std=1.0)
        model.lips.moves.weight.normal_(std=0.1)
        model.lips.shown.weight.normal_(std=0.1)
    save_model(folder, model, config, {"steps": 0})
    return str(folder)


def captures(data: Path, folder: Path, known: list[str]) -> Path:
    """The dataset in a neutral voice, of which some controls are known."""
    relabelled(data, folder, emotion="neutral", voice="neutral", known="known.txt")
    (folder / "known.txt").write_text("\n".join(known) + "\n")
    return folder


def tuned(base: str, folder: Path, out: Path, *more: str) -> DEITalk:
    finetune(recipe(base, "train.steps=0", *more), folder, out)
    model = load_model(out / "best")
    assert isinstance(model, DEITalk)
    return model


def moved(before: DEITalk, after: DEITalk, emotion: str) -> set[str]:
    """Controls that a tuning changed, of both readings of a recording."""
    weights = np.zeros((50, len(EMOTIONS)), np.float32)
    weights[:, EMOTIONS.index(emotion)] = 1
    read = [model.read(SPEECH, weights) for model in (before, after)]
    pairs = ((getattr(each, name) for each in read) for name in ("neutral", "emotional"))
    apart = np.max([np.abs(one - other).max(axis=0) for one, other in pairs], axis=0)
    return {CONTROLS.names[i] for i in np.flatnonzero(apart > 1e-5)}


BROW = "CTRL_L_brow_down.ty"
FUNNEL = "CTRL_L_mouth_funnelU.ty"


@pytest.mark.parametrize(
    ("known", "alike"),
    [
        ([BROW], set(CONTROLS.names) - {BROW}),
        ([JAW], set(CONTACTS)),
        ([JAW, FUNNEL], set(CONTACTS)),
    ],
)
def test_controls_that_captures_lack_are_read_as_the_base_reads_them(
    reader, data, tmp_path, known, alike
):
    """All of them where no control of the mouth is captured, else contacts and tongue.

    The measures of the mouth are corrected by several controls together, which are not the base's
    where captures show some of them.
    """
    before = load_model(reader)
    after = tuned(reader, captures(data, tmp_path / "data", known), tmp_path / "run")
    for emotion in ("neutral", "angry"):
        changed = moved(before, after, emotion)
        assert set(known) <= changed and not changed & alike
    assert after.rules.sharpen_contacts == NUMBERS


@pytest.mark.parametrize("who", ["base", "captures"])
def test_captured_contacts_are_learnt_where_they_tell_more(reader, data, tmp_path, who):
    """Contacts as the base reads them stay its own; those that follow the jaw are regressed."""
    before = load_model(reader)
    folder = captures(data, tmp_path / "data", [JAW, *CONTACTS])
    for clip in read_clips(folder):
        curves = read_curves(clip.curves)
        if who == "base":
            frames = len(curves) * 30 // 60
            weights = np.eye(len(EMOTIONS), dtype=np.float32)[:1].repeat(frames, axis=0)
            read = before.read(read_waveform(clip.audio), weights).neutral
            lips = lips_together(read.repeat(2, axis=0), CONTROLS)
            shut = lips > np.median(lips[jaw() > 0])
        else:
            shut = curves.values[:, CONTROLS.index(JAW)] < 0.3
        values = curves.values.copy()
        values[:, [CONTROLS.index(name) for name in CONTACTS]] = shut[:, None]
        write_curves(clip.curves, RigCurves(values, curves.names, fps=curves.fps))
    after = tuned(reader, folder, tmp_path / "run")
    learnt = set(CONTACTS) & moved(before, after, "neutral")
    assert learnt == (set() if who == "base" else set(CONTACTS))
    kept = after.rules.sharpen_contacts == NUMBERS
    assert kept == (who == "base")


def test_without_its_decoder_nothing_is_read(reader, data, tmp_path):
    folder = captures(data, tmp_path / "data", [JAW])
    after = tuned(reader, folder, tmp_path / "run", "tune.keep=false")
    assert after.lips is None and after.rules.sharpen_contacts == SharpenContacts()
