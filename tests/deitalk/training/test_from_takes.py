"""From takes to a tuned model by three commands: what one refuses, all refuse."""

import json

from typer.testing import CliRunner

from deitalk.cli import app
from tests.each import each
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


def tune(base, data, out) -> tuple[int, str]:
    sets = (
        "train.steps=2",
        "train.evaluate_every=2",
        "train.batch_size=2",
        "data.window_frames=32",
    )
    given = (f"tune.base={base}", "data.augment=false", *sets)
    return run("finetune", data, "-o", out, *(part for s in given for part in ("--set", s)))


@each("seconds", [(32,), (6, 6.5, 7)])
def test_takes_that_are_imported_are_sound_and_tune_a_model(base, tmp_path, seconds):
    data, out = tmp_path / "data", tmp_path / "run"
    for code, text in (import_takes(tmp_path / "takes", seconds, data), run("data", "check", data)):
        assert code == 0, text
        assert "do not follow their sound" not in text
    code, text = tune(base, data, out)
    assert code == 0, text
    assert (out / "best/model.json").is_file()
    assert json.loads((out / "report.json").read_text())


def test_a_short_take_is_refused_by_all_in_one_line(base, tmp_path):
    """Six seconds are one clip, which cannot both train and validate."""
    data, out = tmp_path / "data", tmp_path / "run"
    refused = [import_takes(tmp_path / "takes", (6,), data)]
    assert not data.exists()
    code, _ = import_takes(tmp_path / "takes", (6,), data, "--split-by", "none")
    assert code == 0
    refused += [run("data", "check", data), tune(base, data, out)]
    for code, text in refused:
        assert code == 1
        assert "1 clips to train on and 0 to validate, needs one of each" in text
    assert not out.exists()
