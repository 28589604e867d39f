"""Ablations: variants are read, trained, scored and resumed."""

import json
from pathlib import Path

import pandas as pd
import pytest
import yaml

import deitalk.research.training.ablation
import deitalk.training.trainer
from deitalk.config.curves import Config
from deitalk.errors import ConfigError, DataError
from deitalk.research.config import read_training
from deitalk.research.training.ablation import Variant, ablate, as_markdown, read_variants
from rig.errors import TargetError
from tests.dataset import write_dataset
from tests.deitalk.models.test_mesh_model import VOCA
from tests.deitalk.models.test_mesh_model import tiny as tiny_mesh
from tests.errors import one_line

pytestmark = pytest.mark.usefixtures("empty_pictures")

CONFIGS = Path(__file__).resolve().parents[4] / "configs"


def flat(tree: dict, prefix: str = "") -> dict:
    out = {}
    for key, value in tree.items():
        out |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return out


def differences(variant: Variant) -> set[str]:
    base, ours = (flat(c.model_dump()) for c in (read_training(variant.base), variant.config(0, 7)))
    changed = {key for key in base if base[key] != ours[key]}
    return changed - {"kind", "name", "train.steps"}  # networks of other papers have kinds


def test_variants_change_the_settings_in_their_names():
    variants = {variant.name: variant for variant in read_variants(CONFIGS / "ablations")}
    assert next(iter(variants)) == "full"
    changed = {name: differences(variant) for name, variant in variants.items()}
    weights = "loss.control_weights."
    assert changed == {
        "full": set(),
        "no_dei": {"model.intensity", "loss.contrast", "loss.intensity"},
        "no_dpe": {"model.positions"},
        "no_velocity": {"loss.velocity"},
        "no_classification": {"loss.classification"},
        "no_real_speech": {"data.real_fraction"},
        "no_contact": {"loss.contact", weights + "lipsTogether", weights + "lipBiteD"},
    }
    run = variants["no_dei"].config(2, 7, ["train.batch_size=8", "loss.contrast=3"])
    assert (run.train.seed, run.train.steps, run.train.batch_size) == (2, 7, 8)
    assert run.loss.contrast == 0  # the overrides of the variant come last


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "needs two keys"),
        ("base: a.yaml", "needs two keys"),
        ("base: 3\noverrides: []", "must be a file"),
        ("base: absent.yaml\noverrides: []", "does not exist"),
        ("base: base.yaml\noverrides: [loss.velocty=0]", "unknown key"),
        ("base: tuning.yaml\noverrides: []", "of curves, or of meshes"),
        (": :", "cannot be read as YAML"),
    ],
)
def test_read_variants_rejects_a_wrong_file(tmp_path, text, message):
    (tmp_path / "base.yaml").write_text("")
    (tmp_path / "tuning.yaml").write_text("kind: finetune")
    folder = tmp_path / "variants"
    folder.mkdir()
    (folder / "a.yaml").write_text(text.replace("base: ", "base: ../"))
    if "base: 3" in text:
        (folder / "a.yaml").write_text(text)
    with one_line(ConfigError, match=message):
        read_variants(folder)


def test_read_variants_rejects_curves_beside_meshes(tmp_path):
    for name in ("mel", "voca"):
        (tmp_path / f"{name}.yaml").write_text(f"base: {CONFIGS / name}.yaml\noverrides: []")
    with pytest.raises(ConfigError, match="of curves, or of meshes"):
        read_variants(tmp_path)


def test_read_variants_rejects_an_empty_folder(tmp_path):
    with pytest.raises(ConfigError, match="holds no"):
        read_variants(tmp_path)


OPTIONS = {"steps": 2, "seeds": 2, "most": 1, "probes": 0}
VARIANTS = [
    Variant("full", CONFIGS / "tiny.yaml", ()),
    Variant("still", CONFIGS / "tiny.yaml", ("loss.velocity=0",)),
]


@pytest.fixture
def data(tmp_path) -> Path:
    folder = write_dataset(tmp_path / "data", 2, 2)
    table = pd.read_csv(folder / "clips.csv")
    table["split"] = ["train", "train", "validation", "test"]
    table.to_csv(folder / "clips.csv", index=False)
    return folder


def fails(*_: object) -> None:
    raise KeyboardInterrupt


def test_ablation_resumes_after_a_kill_and_repeats_no_finished_run(data, tmp_path, monkeypatch):
    out = tmp_path / "runs"
    monkeypatch.setattr(
        deitalk.training.trainer, "save_checkpoints", fails
    )  # after the rows of the first evaluation
    with pytest.raises(KeyboardInterrupt):
        ablate(VARIANTS, data, out, **OPTIONS)
    monkeypatch.undo()
    runs: list[str] = []
    scores = ablate(VARIANTS, data, out, **OPTIONS, progress=lambda run, _: runs.append(run))
    assert list(dict.fromkeys(runs)) == [
        "full seed0", "still seed0", "full seed1", "still seed1"
    ]  # fmt: skip
    assert scores["full"]["network"]["test"]["lpe"]["n"] == 2
    assert pd.read_csv(out / "full/seed0/development.csv")["step"].tolist() == [2], "no row twice"
    for prediction in ("network", "groups"):
        assert scores["full"][prediction]["test"]["lpe"]["sd"] > 0
    assert scores["full"]["network"]["test"]["lpe"] != scores["full"]["groups"]["test"]["lpe"]
    assert "±" in (out / "ablations.md").read_text()

    (out / "still/seed1/report.json").unlink()
    trained: list[bool] = []

    def spy(*arguments, resume, **options):
        trained.append(resume)
        return real(*arguments, resume=resume, **options)

    real = deitalk.research.training.ablation.train_curves
    monkeypatch.setattr("deitalk.research.training.ablation.train_curves", spy)
    before = (out / "ablations.json").read_text()
    ablate(VARIANTS, data, out, **OPTIONS)
    assert (out / "ablations.json").read_text() == before
    assert trained == [True]  # only the run without a report, from where it was


def test_ablation_rejects_other_settings_and_edited_files(data, tmp_path):
    out, options = tmp_path / "runs", OPTIONS | {"seeds": 1}
    ablate(VARIANTS[:1], data, out, **options)
    with pytest.raises(DataError, match="other settings"):
        ablate(VARIANTS[:1], data, out, **(options | {"steps": 3}))
    (out / "ablations.md").write_text("my notes")
    with pytest.raises(TargetError, match=r"ablations\.md was changed since deitalk wrote it"):
        ablate(VARIANTS[:1], data, out, **options)
    assert (out / "ablations.md").read_text() == "my notes"
    (out / "ablations.md").unlink()
    (out / "full/seed0/report.json").write_text("[")
    with pytest.raises(DataError, match=r"report\.json: no evaluation; remove it"):
        ablate(VARIANTS[:1], data, out, **options)


def test_variants_of_a_mesh_model_share_the_meshes_of_the_first_run(tmp_path):
    data = write_dataset(tmp_path / "data", 2, 1, 1.1)
    base = tmp_path / "tiny.yaml"
    base.write_text(yaml.safe_dump(tiny_mesh(VOCA, "offsets", steps=2).model_dump(mode="json")))
    variants = [Variant("full", base, ()), Variant("slow", base, ("train.learning_rate=1e-5",))]
    out = tmp_path / "runs"
    options = {"seeds": 1, "split": "train", "most": 1}
    table = ablate(variants, data, out, **options)
    assert (out / "full/seed0/meshes/bases.npz").is_file()
    assert not (out / "slow/seed0/meshes").exists()
    for scores in table.values():
        assert scores["groups"]["all"]["lips_mm"]["n"] == 1
        assert scores["groups"]["all"]["lips_mm"]["mean"] > 0
    text = (out / "ablations.md").read_text()
    assert "## all, meshes" in text and "| slow | " in text
    report = json.loads((out / "slow/seed0/report.json").read_text())
    assert report["groups"]["all"]["lips_mm"] == table["slow"]["groups"]["all"]["lips_mm"]["mean"]
    before = (out / "ablations.json").read_text()
    (out / "full/seed0/best/model.safetensors").unlink()
    ablate(variants, data, out, **options)  # the runs are finished
    assert (out / "ablations.json").read_text() == before


def test_variants_of_sdfa_change_the_parts_in_their_names():
    variants = {v.name: v for v in read_variants(CONFIGS / "mesh_ablations")}
    frontend = "model.frontend."
    common = {"train.start_encoder", "train.evaluate_every", frontend + "tapers"}
    assert differences(variants["full"]) == common
    for name, key in (("no_spec_bilstm", "gathering"), ("no_attention", "summary")):
        assert differences(variants[name]) == common | {frontend + "kind"}
        parts = variants[name].config(0, None).model.frontend
        usual = type(parts).model_fields
        changed = {part for part in ("gathering", "summary")
                   if getattr(parts, part) != usual[part].default}  # fmt: skip
        assert changed == {key}
        assert variants[name].config(0, None).train.steps == 2000
    for name, steps in (("karras", 4000), ("voca", 4000)):
        config = variants[name].config(1, None)
        assert (config.model.frontend.kind, config.train.steps, config.train.seed) == (
            name,
            steps,
            1,
        )


def test_ablation_rejects_a_folder_of_the_user(tmp_path):
    (tmp_path / "ablations.md").write_text("mine")
    with pytest.raises(TargetError, match="holds files that deitalk did not write"):
        ablate([], tmp_path, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["ablations.md"]


def test_markdown_table_by_hand():
    score = {"mean": 0.5, "sd": 0.01, "n": 3}
    table = {
        "full": {"network": {"a": {"lpe": score}}, "groups": {"a": {}}},
        "no_dei": {"network": {"a": {}}, "groups": {"a": {"lpe": score}}},
    }
    raw, ruled = as_markdown(table, "test", 3).split("## a, with the rules of the model")
    assert "## a, the network alone" in raw
    assert "| full | 0.5 ± 0.01 | – |" in raw and "| no_dei | – |" in raw
    assert "| full | – |" in ruled and "| no_dei | 0.5 ± 0.01 | – |" in ruled
    assert isinstance(read_training(CONFIGS / "mel.yaml"), Config)
