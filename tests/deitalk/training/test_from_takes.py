"""From takes to a tuned model by three commands: what one refuses, all refuse."""

import json

import pytest
from typer.testing import CliRunner

from deitalk.cli import app
from tests.takes import write_live_link


def run(*arguments) -> tuple[int, str]:
    """Exit code, and what was printed with the error."""
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    return done.exit_code, f"{done.output}{done.exception or ''}"


def import_takes(folder, seconds, out, *options) -> tuple[int, str]:
    """Import takes of an actor of these lengths, seconds."""
    for place, length in enumerate(seconds):
        write_live_link(folder / f"take_{place}.csv", length)
    return run("data", "import", folder, "--actor", "anna", "-e", "happy", "-o", out, *options)


def tune(base, data, out, steps=2) -> tuple[int, str]:
    sets = (
        f"train.steps={steps}",
        "train.evaluate_every=2",
        "train.batch_size=2",
        "data.window_frames=32",
    )
    given = (f"tune.base={base}", "data.augment=false", *sets)
    return run("finetune", data, "-o", out, *(part for s in given for part in ("--set", s)))


@pytest.mark.parametrize("steps", [0, 2])
@pytest.mark.parametrize("seconds", [(32,), (6, 6.5, 7)])
def test_takes_that_are_imported_are_sound_and_tune_a_model(base, tmp_path, seconds, steps):
    data, out = tmp_path / "data", tmp_path / "run"
    for code, text in (import_takes(tmp_path / "takes", seconds, data), run("data", "check", data)):
        assert code == 0, text
        assert "do not follow their sound" not in text
    code, text = tune(base, data, out, steps)
    assert code == 0, text
    assert (out / "best/model.json").is_file()
    assert json.loads((out / "report.json").read_text())


def test_one_clip_is_learnt_from_and_steps_are_refused_in_one_line(base, tmp_path):
    """Six seconds are one clip, which cannot both train and validate."""
    data, out = tmp_path / "data", tmp_path / "run"
    assert import_takes(tmp_path / "takes", (6,), data)[0] == 0
    assert run("data", "check", data)[0] == 0
    code, text = tune(base, data, out)
    assert code == 1 and "0 clips to train on and 1 to validate; steps" in text
    assert not out.exists()
    assert tune(base, data, out, steps=0)[0] == 0
