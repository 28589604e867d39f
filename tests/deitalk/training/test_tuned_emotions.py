"""Emotions of a tuned model: those that captures lack are the base's change, whatever is captured."""

from pathlib import Path

import numpy as np
import pytest
import torch

from deitalk import animate
from deitalk.audio.load import Recording
from deitalk.config.finetuning import FinetuneConfig
from deitalk.config.rig_file import read_controls
from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from deitalk.models.checkpoint import load_model
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.training.tuning.carry import carry_matrix
from deitalk.training.tuning.regression import _jaw_share
from deitalk.training.tuning.task import finetune
from rig import RigCurves, default_controls, read_curves, write_curves
from tests.dataset import FPS, JAW, jaw
from tests.deitalk.training.conftest import recipe, relabelled

CONTROLS = default_controls()
SPEECH = np.pad(speechlike(1.5), (4000, 4000))
RIG = "id: puppet@1\ncontrols: {hinge: {}, smile: {}, hat: {}}\n"


def settings(base: str, *more: str) -> FinetuneConfig:
    """The regression alone, as by default."""
    return recipe(base, "train.steps=0", *more)


def labelled(data: Path, folder: Path, emotions: str | list[str], rig: str | None = None) -> Path:
    """The dataset with these emotions, of another rig where one is given: its hinge is the jaw."""
    relabelled(data, folder, emotion=emotions, voice=emotions, known="")
    if rig is not None:
        controls = read_controls(rig)
        for path in (folder / "curves").iterdir():
            values = np.tile(controls.rest, (len(jaw()), 1))
            values[:, :2] = np.stack([jaw(), 0.3 * jaw() ** 2], axis=1)
            curves = RigCurves(
                values.astype(np.float32), controls.names, FPS, control_set=controls.id
            )
            write_curves(path, curves)
    return folder


def readings(model, emotion: str) -> tuple[np.ndarray, np.ndarray]:
    """Curves of the network alone, neutral and in an emotion."""
    weights = np.zeros((50, 5), np.float32)
    weights[:, EMOTIONS.index(emotion)] = 1
    with torch.no_grad():
        found = load_model(model).read(SPEECH, weights)
    return found.neutral, found.emotional


def change(model, emotion: str) -> np.ndarray:
    neutral, acted = readings(model, emotion)
    return acted - neutral


@pytest.fixture(scope="module")
def neutral(base, data, tmp_path_factory) -> Path:
    """A model tuned on neutral captures of the board."""
    place = tmp_path_factory.mktemp("neutral")
    finetune(settings(base), labelled(data, place / "data", "neutral"), place / "run")
    return place / "run" / "best"


@pytest.mark.parametrize("emotion", EMOTIONS[1:])
def test_neutral_captures_leave_the_change_of_every_emotion(base, neutral, emotion):
    """The neutral reading is learnt, and what an emotion adds is exactly the base's."""
    before, after = (readings(model, "neutral")[0] for model in (base, neutral))
    assert np.abs(after - before).max() > 0.05
    np.testing.assert_allclose(change(neutral, emotion), change(base, emotion), atol=2e-5)


@pytest.fixture(scope="module")
def calm(base, data, tmp_path_factory) -> Path:
    """A model tuned on neutral captures in which the jaw opens a tenth as far."""
    place = tmp_path_factory.mktemp("calm")
    folder = labelled(data, place / "data", "neutral")
    for path in (folder / "curves").iterdir():
        curves = read_curves(path)
        values = curves.values.copy()
        values[:, CONTROLS.index(JAW)] *= 0.1
        write_curves(path, RigCurves(values, curves.names, curves.fps))
    finetune(settings(base), folder, place / "run")
    return place / "run" / "best"


@pytest.mark.parametrize("emotion", EMOTIONS[1:])
def test_emotions_move_the_jaw_of_a_calm_actor_less(base, calm, emotion):
    """As much less as the neutral jaw moves; every other control as the base's."""
    place = CONTROLS.index(JAW)
    of_base, found = change(base, emotion), change(calm, emotion)
    others = np.delete(np.arange(len(CONTROLS)), place)
    np.testing.assert_allclose(found[:, others], of_base[:, others], atol=2e-5)
    share = found[:, place].std() / of_base[:, place].std()
    assert 0.19 < share < 0.8
    assert np.corrcoef(found[:, place], of_base[:, place])[0, 1] > 0.999


@pytest.mark.parametrize(("size", "shape"), [(1.0, 1), (0.5, 1), (0.5, 3), (0.3, 3)])
def test_no_emotion_widens_the_jaw_of_an_actor_more_than_the_base(rng, size, shape):
    """Whether the actor's jaw is smaller than the base's, or mostly shut with wide openings.

    A jaw that hardly moves is another case: of an emotion `CALMEST` is always left.
    """
    calm = np.abs(np.sin(np.linspace(0, 40, 3000))) * 0.4
    acted = np.stack([calm, 0.7 * calm, 1.5 * calm, 0.2 + calm, 0.1 + 1.2 * calm])
    own = np.float32(size * 0.4 * (calm / 0.4) ** shape + rng.normal(0, 0.005, calm.shape))
    share, pose = _jaw_share(acted, own, 0)

    def wide(rows):
        return np.subtract(*np.percentile(rows, (95, 5), axis=-1))

    shown = own + pose[:, None] + share * (acted - calm - pose[:, None])
    assert (wide(shown) / wide(own) <= np.maximum(wide(acted) / wide(calm), 1) + 0.02).all()
    np.testing.assert_allclose(pose, [0, 0, 0, 0.2, 0.1], atol=0.01)
    assert share <= 1 and (size == 1.0) == (share == 1)


@pytest.mark.parametrize("emotion", ["happy", "fear", "angry=0.5,sad=0.5"])
def test_strength_is_ordered_after_tuning_as_before(base, neutral, emotion):
    """Voices of several levels and tilts have the intensities that the base gives them."""
    for loud in (0.05, 0.3, 0.9):
        rough = loud * np.tanh(4 * SPEECH) + (1 - loud) * SPEECH
        recording = Recording(rough.astype(np.float32), "voice", 16_000, 1)
        one, other = (
            animate(recording, emotion, model=load_model(model)) for model in (base, neutral)
        )
        np.testing.assert_allclose(other.curves.intensity, one.curves.intensity, atol=1e-5)
    assert load_model(neutral).rules.voice_intensity == load_model(base).rules.voice_intensity


def test_captured_emotions_are_learnt_and_others_stay_the_base(base, data, tmp_path):
    """Happy and neutral are captured; by rules too, each emotion is the captures' or the base's."""
    labels = ["neutral", "happy"] * 3
    finetune(settings(base), labelled(data, tmp_path / "data", labels), tmp_path / "run")
    model = load_model(tmp_path / "run/best")
    assert model.config.captured_emotions == ("neutral", "happy")
    expressions = model.rules.expressions
    assert expressions.captured == ("happy",) and not expressions.covers_teeth
    gains = model.decoder.change.carry.diagonal()
    for emotion in ("angry", "sad", "surprised"):
        wanted = change(base, emotion)
        found = change(tmp_path / "run/best", emotion)
        np.testing.assert_allclose(found, wanted * gains.numpy(), atol=5e-4)


def test_of_an_unknown_rig_an_emotion_passes_as_neutral_with_a_note(base, data, tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG)
    rig = str(tmp_path / "rig.yaml")
    folder = labelled(data, tmp_path / "data", "neutral", rig)
    finetune(settings(base, f"model.control_set={rig}"), folder, tmp_path / "run")
    best = tmp_path / "run/best"
    assert not change(best, "angry").any()
    recording = Recording(SPEECH, "voice", 16_000, 1)
    for emotion, count in (("angry", 1), ("fear", 1), ("neutral", 0)):
        notes = animate(recording, emotion, model=load_model(best)).recording.warnings
        assert sum("passes as neutral" in note for note in notes) == count, emotion


def test_a_map_carries_emotions_to_a_rig(base, data, tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG)
    (tmp_path / "map.csv").write_text(
        "target,source,weight\nCTRL_C_jaw.ty,hinge,1\n"
        "CTRL_L_mouth_cornerPull.ty,smile,0.5\nCTRL_R_mouth_cornerPull.ty,smile,0.5\n"
    )
    rig, table = str(tmp_path / "rig.yaml"), tmp_path / "map.csv"
    folder = labelled(data, tmp_path / "data", "neutral", rig)
    given = (f"model.control_set={rig}", f"tune.map={table}")
    finetune(settings(base, *given), folder, tmp_path / "run")
    for emotion in EMOTIONS[1:]:
        found, of_base = change(tmp_path / "run/best", emotion), change(base, emotion)
        jaw_moves = of_base[:, CONTROLS.index("CTRL_C_jaw.ty")]
        assert np.corrcoef(found[:, 0], jaw_moves)[0, 1] > 0.999
        np.testing.assert_allclose(found[:, 0], jaw_moves, atol=0.06 * np.abs(jaw_moves).max())
        assert not found[:, 2].any(), "nothing is told of the hat"


@pytest.mark.parametrize("part", ["head", "all"])
def test_every_part_is_tuned_on_another_rig(base, data, tmp_path, part):
    """Also where the frontend learns, and no features are kept."""
    (tmp_path / "rig.yaml").write_text(RIG)
    rig = str(tmp_path / "rig.yaml")
    folder = labelled(data, tmp_path / "data", "neutral", rig)
    given = (f"model.control_set={rig}", f"tune.part={part}", "data.augment=false")
    scores = finetune(recipe(base, *given), folder, tmp_path / "run")
    assert scores["after"]["error_of_mean_pose"] < 1
    assert not change(tmp_path / "run/best", "angry").any()


def test_a_map_of_other_curves_is_refused(base, data, tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG)
    (tmp_path / "map.csv").write_text("target,source\nCTRL_C_jaw.ty,chin\n")
    rig = str(tmp_path / "rig.yaml")
    folder = labelled(data, tmp_path / "data", "neutral", rig)
    given = (f"model.control_set={rig}", f"tune.map={tmp_path / 'map.csv'}")
    with pytest.raises(DataError, match="'chin' is no control of puppet@1"):
        finetune(settings(base, *given), folder, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["arkit", "metahuman-raw", "cc4", "daz8", "daz9"])
def test_public_rigs_need_no_map(name):
    """A control that one shape of the board moves alone, carries it whole."""
    rig = read_controls(name)
    carry = carry_matrix(CONTROLS, rig)
    assert carry.shape == (len(rig), len(CONTROLS)) and np.isfinite(carry).all()
    opens = np.abs(carry[:, CONTROLS.index("CTRL_C_jaw.ty")])
    most = rig.names[int(opens.argmax())].lower()
    assert opens.max() > 0.3 and ("jaw" in most or "open" in most), most
    assert carry_matrix(CONTROLS, read_controls("facegood")) is None
