"""The commands through their entry point."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import soundfile
from typer.main import get_command
from typer.testing import CliRunner

from deitalk.cli import app
from deitalk.research.evaluation.benchmark_curves import speechlike
from rig import read_curves, rest_curves, write_curves
from tests.command import deitalk, ran, refused

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def speech(tmp_path_factory):
    path = tmp_path_factory.mktemp("speech") / "speech.wav"
    soundfile.write(path, speechlike(1.5), 16_000)
    return str(path)


def process(*arguments):
    """Run the installed command in a separate process."""
    return subprocess.run(
        [sys.executable, "-m", "deitalk", *map(str, arguments)],
        capture_output=True,
        cwd=ROOT,
        timeout=120,
    )


def test_animate_writes_a_take_and_keeps_stdout_clean(tmp_path, model, speech):
    done = process("animate", speech, "-e", "happy", "--model", model, "-o", tmp_path / "take")
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout == b""
    assert b"45 frames" in done.stderr
    curves = read_curves(tmp_path / "take/curves.csv")
    assert curves.values.shape == (45, 185)


@pytest.mark.parametrize("name", ["take.v2/", "Scene 1.2", "br[/b]", "[red]"])
def test_animate_writes_a_take_into_a_folder_of_any_name(tmp_path, model, speech, name):
    arguments = ["animate", speech, "--model", model, "-o", f"{tmp_path}/{name}"]
    done = ran(*arguments)
    assert (tmp_path / name / "take.json").is_file()
    assert f"{tmp_path / name}: 45 frames" in done.stderr


@pytest.mark.parametrize(
    ("options", "printed", "share"),
    [
        (["-e", "happy"], "applied intensity 0.{mean} on average (0.{mean} predicted", 1.0),
        (["-e", "happy", "--intensity", "0"], "applied intensity 0.00 on average (0.{mean}", 0.0),
        (["-e", "happy", "--intensity-curve", "{still}"], "applied intensity 0.00 on", 0.0),
        ([], "emotion neutral: the neutral reading", 0.0),
    ],
)
def test_animate_prints_the_applied_intensity(tmp_path, model, speech, options, printed, share):
    (tmp_path / "still.csv").write_text("time,intensity\n0,0\n")
    given = [option.format(still=tmp_path / "still.csv") for option in options]
    arguments = ["animate", speech, "--model", model, *given, "--force", "-o", f"{tmp_path}/c.npz"]
    summary = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)
    assert summary["mean_intensity"] > 0.1
    assert summary["mean_applied_intensity"] == pytest.approx(share * summary["mean_intensity"])
    mean = f"{100 * summary['mean_intensity']:02.0f}"
    assert printed.format(mean=mean) in CliRunner().invoke(app, arguments).stderr
    assert json.loads(ran(*arguments, "--fps", "24", "--json").stdout)["frames"] == 36  # 1.5 s
    assert len(read_curves(tmp_path / "c.npz")) == 36


def test_animate_reads_stdin(tmp_path, model, speech):
    data = Path(speech).read_bytes()
    out = tmp_path / "c.npz"
    done = deitalk("animate", "-", "--model", model, "-o", out, stdin=data)
    assert done.code == 0, done.err
    assert len(read_curves(out)) == 45


@pytest.mark.parametrize(
    ("shell", "arguments", "code", "said"),
    [
        ("2>&-", ["convert", "a.csv", "b.json"], 0, ""),
        ("<&- >&- 2>&-", ["convert", "a.csv", "b.json"], 0, ""),
        ("<&-", ["animate", "-", "-o", "b.json"], 1, "deitalk: standard input is closed"),
        ("2>&-", ["convert", "absent.csv", "b.json"], 1, ""),
    ],
)
def test_a_command_without_standard_streams_ends_as_with_them(
    tmp_path, shell, arguments, code, said
):
    write_curves(tmp_path / "a.csv", rest_curves(3))
    line = f'exec "$@" {shell}', "sh", sys.executable, "-m", "deitalk", *arguments
    done = subprocess.run(["sh", "-c", *line], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == code and done.stderr.startswith(said), done
    assert (tmp_path / "b.json").is_file() == (code == 0)


@pytest.mark.parametrize(
    ("error", "is_told"),
    [
        (MemoryError(), True),
        (ImportError("libtorch_cpu.so: failed to map segment from shared object"), True),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried"), True),
        (RuntimeError("mat1 and mat2 shapes cannot be multiplied"), False),
        (ImportError("cannot import name 'x'"), False),
    ],
)
def test_the_end_of_memory_is_one_line_and_a_mistake_of_ours_is_none(monkeypatch, error, is_told):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("deitalk.cli.convert.reserve_file", fail)
    if is_told:
        assert "not enough memory" in refused("convert", "a.csv", "b.csv")
    else:
        with pytest.raises(type(error)):
            deitalk("convert", "a.csv", "b.csv")


def test_a_removed_working_folder_is_one_line(tmp_path):
    line = f'cd "{tmp_path}" && rmdir "{tmp_path}" && exec "$@"', "sh", sys.executable, "-P", "-m"
    command = ["sh", "-c", *line, "deitalk", "animate", ROOT / "docs/samples/promise.flac"]
    done = subprocess.run([*command, "-o", ROOT / "x.csv"], capture_output=True, text=True)
    assert done.returncode == 1 and "working folder was removed" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["-e", "furious"], "neutral, angry, happy, sad, surprised"),
        (["--intensity", "-1"], "-1"),
        (["--model", "no-such-model"], "no-such-model"),
        (["--intensity-curve", "no.csv"], "no.csv"),
        (["--fps", "0"], "fps=0 must be from 1 to 300"),
        (["-o", "take.xyz"], "'.xyz' is no suffix that is written"),
        (["-o", "take.v2"], "a folder with a slash: take.v2/"),
        (["-o", ""], "the name of the output is empty"),
        (["-o", "curves.csv", "--preview"], "--preview goes with a take folder"),
        (
            ["--voice", "{speech}"],
            "speech.wav is no JSON: it is no text; `deitalk data voice` writes",
        ),
        (["--edit", "{speech}"], "speech.wav is no text; `deitalk diff` writes"),
    ],
)
def test_animate_refuses_in_one_line(tmp_path, model, speech, options, expected):
    chosen = [] if "--model" in options else ["--model", model]
    given = [option.format(speech=speech) for option in options]
    line = refused("animate", speech, *chosen, "-o", tmp_path / "take", *given)
    assert expected in line
    assert not (tmp_path / "take").exists()


def test_animate_does_not_overwrite(tmp_path, model, speech):
    (tmp_path / "curves.csv").write_text("mine")
    line = refused("animate", speech, "--model", model, "-o", tmp_path / "curves.csv")
    assert "--force" in line
    assert (tmp_path / "curves.csv").read_text() == "mine"


def test_errors_are_reported_before_the_network_is_loaded(tmp_path):
    """Errors are reported before torch is imported and before a missing model is."""
    script = (
        "import sys; from deitalk.cli import main; "
        f"sys.argv = ['deitalk', 'animate', 'no.wav', '-o', {str(tmp_path / 'take')!r}]\n"
        "try: main()\n"
        "finally: print([m for m in ('torch', 'transformers') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip() == "[]" and "no.wav" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["animate"], "deitalk: Missing argument 'speech'; see `deitalk animate --help`"),
        (["anmate"], "anmate"),
        (["animate", "a.wav", "--emotoin", "happy"], "--emotoin"),
        (["animate", "a.wav", "--fps", "many"], "--fps"),
        (["install"], "see `deitalk install --help`"),
        (["convert", "a.csv"], "a target"),
    ],
)
def test_wrong_command_line_is_one_line_with_exit_code_2(arguments, expected):
    message = refused(*arguments, code=2)
    assert expected in message.replace("'SPEECH'", "'speech'")  # as older typers spell it


def test_controls_lists_and_filters():
    run = CliRunner().invoke
    assert len(json.loads(run(app, ["face", "controls", "--json"]).stdout)) == 185
    assert len(json.loads(run(app, ["face", "controls", "--set", "lip", "--json"]).stdout)) == 86
    jaws = json.loads(run(app, ["face", "controls", "jaw.ty", "--json"]).stdout)
    assert [row["control"] for row in jaws] == ["CTRL_C_jaw.ty"]
    sizes = {
        r["set"]: r["controls"]
        for r in json.loads(run(app, ["face", "controls", "--sets", "--json"]).stdout)
    }
    assert sizes["upper_face"] == 18


def test_benchmark_prints_stages_and_the_numbers_of_the_paper(model):
    done = ran("evaluate", model, "--speed", "--seconds", "1", "--repeats", "1", "--json")
    result = json.loads(done.stdout)
    assert {"audio", "model", "network", "expression"} == set(result["clip"]["stages"])
    assert result["clip"]["rtf_cpu"] == pytest.approx(result["clip"]["cpu_seconds"])
    assert result["table_4_clip"]["clip_seconds"] == 5.1
    assert re.fullmatch("[0-9a-f]{64}", result["sha256"])


def test_benchmark_refuses_a_file_that_it_would_not_write(model, tmp_path):
    out = tmp_path / "speed.json"
    assert "--json" in refused("evaluate", model, "--speed", "-o", str(out))
    assert not out.exists()
    assert "with --speed" in refused("evaluate", model, "--memory")


def test_every_command_has_help_and_is_in_a_page():
    pages = [ROOT / "README.md", ROOT / "MODEL_CARD.md", *(ROOT / "docs").glob("*.md")]
    text = "".join(page.read_text() for page in pages)
    for name, command in get_command(app).commands.items():
        for member, found in getattr(command, "commands", {"": command}).items():
            assert found.help, f"{name} {member}"
            assert found.hidden or re.search(rf"deitalk {name} ?{member}\b", text), (
                f"{name} {member}"
            )


def test_error_for_a_file_name_with_a_dash_first_gives_a_spelling_that_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "-dash.wav").touch()
    line = refused("animate", "-dash.wav", "-o", "take", code=2)
    assert line.endswith("write ./-dash.wav for the file of that name")


def test_a_model_is_not_exported_to_the_name_of_another_file(tmp_path):
    assert "files end with .onnx" in refused("model", "export", "default", "-o", tmp_path / "d.txt")
    assert not any(tmp_path.iterdir())


def test_stdout_is_no_target(tmp_path, speech):
    assert refused("animate", speech, "-o", "-") == (
        "deitalk: -o -: nothing is written to stdout; name a file or a folder"
    )
    assert not (ROOT / "-").exists()


def test_raw_controls_are_sent_by_json_alone(speech):
    sent = ["live", speech, "--model", "default", "--protocol", "vmc", "--rig", "raw"]
    assert "--rig raw does not apply to --protocol vmc" in refused(*sent)


def test_a_recording_is_sent_by_a_model_that_reads_all_of_it_first(model, speech):
    words = ["live", speech, "--model", model, "--words", "a", "--port", "9"]
    done = ran(*words)
    told = r"animating speech.wav\n(note: no voice .*\n)?note: ARKit is a lossy .*\nsending 1.5 s .*\n\d+ frames in"
    assert re.search(told, done.stderr)


@pytest.mark.parametrize(("argument", "code"), [("--version", 0), ("--nothing", 2)])
def test_a_program_ends_with_its_code_after_all_it_has_to_do(argument, code):
    script = f"""
import atexit, sys, deitalk.cli as cli
run, sys.argv = cli.main, ["deitalk", {argument!r}]
def main():
    atexit.register(print, "ended", end="")
    run()
cli.main = main
cli.program()
"""
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True)
    assert done.returncode == code
    assert done.stdout.endswith("ended")
