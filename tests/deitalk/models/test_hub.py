"""Models that travel: pushed to a hub, fetched by name, kept in the cache, never by a request."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
import soundfile
import yaml
from huggingface_hub import constants, file_download

from api.settings import Settings
from deitalk.config import hub
from deitalk.config.curves import Config
from deitalk.errors import CheckpointError
from deitalk.models.checkpoint import save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import model_folder, weights_hash
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.training.tuning.recipe import read_recipe
from rig import ControlSet
from rig.controls import Control
from tests.command import deitalk
from tests.deitalk.pipeline.test_curves import SMALL
from tests.hub import TOKEN, serving

NOWHERE = "http://127.0.0.1:9"
TEMPLATE = "HUGGINGFACE_CO_URL_TEMPLATE"
REPORT = "# Before and after\n\nThe result is step 20.\n"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder: the model in ``best``, its report beside it."""
    run = tmp_path_factory.mktemp("runs") / "anna"
    run.mkdir()
    changes = {"actors": ("anna", "ben"), "intensity": True, "effort": True}
    config = Config(model=SMALL.model_copy(update=changes))
    base = str(tmp_path_factory.getbasetemp() / "secret" / "base")
    save_model(run / "best", DEITalk(config.model), config, {"step": 20, "base": base})
    (run / "report.md").write_text(REPORT)
    scores = {"after": {"error_of_mean_pose": 0.61, "mean_r": 0.58, "range": None}}
    (run / "report.json").write_text(json.dumps({"clips": 12, "scores": scores}))
    return run


@pytest.fixture(scope="module")
def the_hub(run, tmp_path_factory):
    """A hub to which the model was pushed by the command, and the settings of its clients."""
    with serving() as (state, address):
        home = tmp_path_factory.mktemp("hf")
        settings = {"HF_ENDPOINT": address, "HF_HOME": str(home), "HF_HUB_DISABLE_XET": "1"}
        # A process of its own: the client reads its variables when it is imported.
        done = subprocess.run(
            [sys.executable, "-m", "deitalk", "model", "push", run / "best", "me/anna"],
            env={k: v for k, v in os.environ.items() if not k.startswith("HF_")}
            | settings
            | {"HF_TOKEN": TOKEN},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        yield state, settings, done.stdout.strip()


def command(settings, *arguments):
    """`deitalk model` in this process, with the client as these variables would make it."""
    return whole_command(settings, "model", *arguments)


def whole_command(settings, *arguments):
    hub.fetch.cache_clear()
    hub.hub_metadata.cache_clear()
    address = settings["HF_ENDPOINT"] + "/{repo_id}/resolve/{revision}/{filename}"
    found = {
        "ENDPOINT": settings["HF_ENDPOINT"],
        TEMPLATE: address,
        "HF_HUB_CACHE": str(Path(settings["HF_HOME"]) / "hub"),
        "HF_TOKEN_PATH": str(Path(settings["HF_HOME"]) / "token"),
        "HF_HUB_OFFLINE": "HF_HUB_OFFLINE" in settings,
        "HF_HUB_DISABLE_XET": True,
    }
    token = {"HF_TOKEN": settings.get("HF_TOKEN", "")}
    copied = patch.object(file_download, TEMPLATE, address, create=True)  # by huggingface_hub < 1
    with patch.multiple(constants, **found), copied, patch.dict(os.environ, token):
        return deitalk(*arguments)


def test_a_pushed_model_has_a_card_of_its_report_and_no_folder_of_this_machine(the_hub, run):
    state, _, address = the_hub
    (files,) = state.repositories["me/anna"]
    assert address.endswith(f"/me/anna/commit/{state.files('me/anna', 'main')[0]}")
    assert state.private["me/anna"]
    weights = (run / "best/model.safetensors").read_bytes()
    assert files["model.safetensors"] == weights
    _, header, text = files["README.md"].decode().split("---\n", 2)
    head = yaml.safe_load(header)
    assert head["library_name"] == "deitalk" and head["pipeline_tag"] == "other"
    (entry,) = head["model-index"]
    (result,) = entry["results"]
    assert entry["name"] == "anna" and result["dataset"]["name"] == "12 held-out clips"
    assert {m["type"]: m["value"] for m in result["metrics"]} == {
        "error_of_mean_pose": 0.61, "mean_r": 0.58,
    }  # fmt: skip
    assert "anna, ben" in text and "--model me/anna" in text
    assert text.endswith("\n#" + REPORT)
    small = b"".join(data for name, data in files.items() if name != "model.safetensors")
    assert b"secret" not in small
    assert json.loads(files["model.json"])["training"]["base"] == "base"


def test_a_model_is_fetched_by_name_once_and_then_read_from_the_cache(the_hub, run, tmp_path):
    state, settings, _ = the_hub
    settings = settings | {"HF_HOME": str(tmp_path)}
    commit, _ = state.files("me/anna", "main")
    state.asked.clear()
    about = json.loads(command(settings, "info", "me/anna", "--json").out)
    assert about["name"] == f"me/anna@{commit}"
    assert about["sha256"] == weights_hash(run / "best")
    fetched = [path for kind, path in state.asked if kind == "GET" and "/resolve/" in path]
    held = [path.name for path in (run / "best").iterdir() if not path.name.startswith(".")]
    assert sorted(path.rpartition("/")[2] for path in fetched) == sorted(held)
    assert "effort.safetensors" in held
    state.asked.clear()
    for name in ("me/anna", f"me/anna@{commit}"):
        again = json.loads(command(settings, "info", name, "--json").out)
        assert again == about
        without = command(settings | {"HF_ENDPOINT": NOWHERE}, "info", name, "--json")
        assert json.loads(without.out) == about
    assert not [path for _, path in state.asked if "/resolve/" in path]


def rig_model():
    """A network of a rig of three controls, and its configuration."""
    controls = ControlSet("three@1", (Control("open"), Control("wide"), Control("smile")))
    return DEITalk(SMALL, controls), Config(model=SMALL)


@pytest.mark.parametrize("kind", ["default", "sdfa", "rig", "effort"])
def test_what_is_pushed_and_fetched_animates_as_before(the_hub, run, tmp_path, kind):
    """Every file that the loader uses travels, of every kind of model."""
    _, settings, _ = the_hub
    folder = run / "best" if kind == "effort" else kind
    if kind == "rig":
        folder = tmp_path / "rig"
        save_model(folder, *rig_model(), {"step": 1})
    settings = settings | {"HF_HOME": str(tmp_path / "home"), "HF_TOKEN": TOKEN}
    name = f"me/{kind}-travels"
    assert command(settings, "push", folder, name).code == 0
    wav, is_mesh = tmp_path / "speech.wav", kind == "sdfa"
    more = ["--vertices"] if is_mesh else ["-e", "angry"]
    soundfile.write(wav, speechlike(1.0), 16_000)
    takes = []
    for number, model in enumerate((folder, name)):
        takes.append(tmp_path / f"{number}.npz")
        done = whole_command(settings, "animate", wav, *more, "--model", model, "-o", takes[-1])
        assert done.code == 0, done.err
    before, after = (dict(np.load(take)) for take in takes)
    moving = "vertices" if is_mesh else "values"
    np.testing.assert_allclose(before[moving], after[moving], atol=1e-5)  # by one engine or two


def test_a_revision_stays_when_the_model_moves_on(the_hub, run, tmp_path):
    state, settings, _ = the_hub
    _, files = state.files("me/anna", "main")
    before = state.commit("me/moving", files)
    config = yaml.safe_load(files["config.yaml"]) | {"name": "newer"}
    after = state.commit("me/moving", {"config.yaml": yaml.safe_dump(config).encode()})
    names = {}
    for revision in ("", f"@{before}"):
        home = tmp_path / f"home{revision[:3]}"
        at_home = settings | {"HF_HOME": str(home)}
        about = json.loads(command(at_home, "info", f"me/moving{revision}", "--json").out)
        folder = next(home.rglob("config.yaml"))
        names[about["name"]] = yaml.safe_load(folder.read_text())["name"]
    assert names == {f"me/moving@{after}": "newer", f"me/moving@{before}": "deitalk"}


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("me/none", {}, "no such model"),
        ("me/anna@v9", {}, "no such model or revision"),
        ("me/other", {}, "config.yaml and model.safetensors"),
        ("me/none", {"HF_ENDPOINT": NOWHERE}, "no answer of the hub"),
        ("me/none", {"HF_HUB_OFFLINE": "1"}, "no answer of the hub"),
        ("runs/none/best", {}, "no model there"),
    ],
)
def test_what_cannot_be_fetched_is_one_line(the_hub, tmp_path, name, changes, words):
    state, settings, _ = the_hub
    state.repositories["me/other"] = [{"config.json": b"{}", "model.safetensors": b""}]
    done = command(settings | {"HF_HOME": str(tmp_path)} | changes, "info", name)
    assert done.code == 1
    assert words in done.err and done.err.count("\n") == 1, done.err
    assert not list(tmp_path.rglob("*.safetensors"))


@pytest.mark.parametrize(
    ("changes", "name", "words"),
    [
        ({"HF_TOKEN": "wrong"}, "me/anna", "hf auth login"),
        ({"HF_ENDPOINT": NOWHERE}, "me/anna", f"no answer of {NOWHERE}: check the network"),
        ({"HF_HUB_OFFLINE": "1"}, "me/anna", "; unset HF_HUB_OFFLINE"),
        ({}, "anna", "org/name"),
        ({}, "me/anna@main", "org/name"),
    ],
)
def test_what_cannot_be_pushed_is_one_line(the_hub, run, changes, name, words):
    state, settings, _ = the_hub
    commits = len(state.repositories["me/anna"])
    done = command(settings | {"HF_TOKEN": TOKEN} | changes, "push", run / "best", name)
    assert done.code == 1 and words in done.err and done.err.count("\n") == 1
    assert ("login" in done.err) == ("login" in words)
    assert len(state.repositories["me/anna"]) == commits


def test_no_answer_is_no_wait(monkeypatch):
    """An hour of retries would be the client's own; the hub is asked once."""
    monkeypatch.setattr(constants, "ENDPOINT", NOWHERE)
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    begin = time.perf_counter()
    with pytest.raises(CheckpointError, match="no answer of the hub"):
        model_folder("nobody/nothing")
    assert time.perf_counter() - begin < hub.SECONDS


@pytest.fixture
def no_hub(monkeypatch):
    """A request to the hub fails the test."""

    def asked(name):
        raise AssertionError(f"the hub was asked for {name}")

    for function in ("hub_metadata", "fetch"):
        monkeypatch.setattr(hub, function, asked)
        monkeypatch.setattr(f"deitalk.models.folder.{function}", asked, raising=False)


def test_a_folder_here_comes_before_the_hub(no_hub, run, tmp_path, monkeypatch):
    (tmp_path / "me").symlink_to(run)
    monkeypatch.chdir(tmp_path)
    assert weights_hash(model_folder("me/best")) == weights_hash(run / "best")
    (tmp_path / "you" / "empty").mkdir(parents=True)
    with pytest.raises(CheckpointError, match="no model there"):
        model_folder("you/empty")


def test_a_tuning_keeps_the_commit_that_it_began_with(the_hub, run, monkeypatch):
    monkeypatch.setattr(hub, "fetch", lambda name: run / "best")
    monkeypatch.setattr("deitalk.models.folder.fetch", lambda name: run / "best")
    assert read_recipe(None, base="me/anna").tune.base == "me/anna@best"


def test_a_service_fetches_at_its_start_and_a_request_never(run, tmp_path, monkeypatch):
    """Its models are folders by the time it answers, wherever its folder goes."""
    monkeypatch.setattr("api.settings.model_folder", lambda path: run / "best")
    settings = Settings(models={"anna": "me/anna", "mine": "runs/mine/best"}, data=tmp_path)
    assert settings.models["anna"] == run / "best"
    assert settings.models["mine"].is_absolute()


@pytest.mark.parametrize(
    ("error", "way"),
    [
        (401, "`hf auth login` logs in"),
        (403, "`hf auth login` logs in"),
        (404, "check the name"),
        (503, "try again"),
        (ConnectionRefusedError(111, "Connection refused"), "check the network"),
        (TimeoutError("timed out"), "check the network"),
        (OSError(28, "No space left on device", "model.safetensors"), "the space"),
    ],
)
def test_each_cause_has_its_way_out(monkeypatch, error, way):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", False)
    if isinstance(error, int):
        status, error = error, OSError("refused")
        error.response = SimpleNamespace(status_code=status)
    assert hub.cause(error).endswith(way)
