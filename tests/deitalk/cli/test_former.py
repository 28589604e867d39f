"""Former names of commands: each gives the line of today, which exists, and prints it."""

import json

from typer.main import get_command
from typer.testing import CliRunner

from deitalk.cli import app
from deitalk.cli.console import FORMER, today
from deitalk.installed import VERBS as RESEARCH
from tests.each import each

LINES = {
    "mesh a.wav --speaker Ada -o f.glb": "animate --vertices a.wav --identity Ada -o f.glb",
    "plot a.wav -e happy -o c.png": "animate a.wav -e happy -o c.png",
    "suggest a.wav --json": "animate -e auto a.wav --json",
    "livelink send take/ --play": "live --model default take/ --play",
    "livelink replay c.csv --loop": "live c.csv --loop",
    "livelink receive -o a.csv --idle=2": "live --record a.csv --timeout 2",
    "livelink receive -oa.csv": "live --record a.csv",
    "livelink receive --out=a.csv --port 0": "live --record a.csv --port 0",
    "controls jaw --json": "face controls jaw --json",
    "unreal C:/Game --force": "install unreal C:/Game --force",
    "blender": "install blender",
    "studio --port 9000 --no-open": "serve --open --port 9000 --no-open",
    "openapi -o a.json": "serve openapi -o a.json",
    "key farm": "serve key farm",
    "actor build a.wav -o a.json": "data voice a.wav -o a.json",
    "benchmark --model live --threads 2": "evaluate --speed live --threads 2",
}
VERBS = """animate batch live preview convert validate retarget face install serve data finetune
model""".split()


def test_former_lines_are_those_of_today():
    for former, line in LINES.items():
        assert today(former.split()) == line.split()
    assert {
        words for words in FORMER if any(f.split()[: len(words)] == [*words] for f in LINES)
    } == {*FORMER}
    unchanged = ["animate", "mesh", "-o", "plot"]  # a recording of that name
    assert today(unchanged) is unchanged


def test_lines_of_today_exist_with_their_options():
    for former in FORMER.values():
        command = get_command(app)
        for word in former.words:
            command = command.commands[word]
        known = {option for parameter in command.params for option in parameter.opts}
        renamed = {option for options in former.options.values() for option in options}
        assert renamed | {o for o in former.added if o.startswith("-")} <= known


def test_thirteen_verbs_are_shown():
    """The verbs of research are in a checkout alone."""
    commands = get_command(app).commands
    shown = {name for name, command in commands.items() if not command.hidden}
    assert shown - {*RESEARCH} == {*VERBS} and len(VERBS) == 13


@each("line", ["controls --json", "suggest no-such.wav"])
def test_former_names_print_the_line_of_today_on_stderr(line):
    done = CliRunner().invoke(app, line.split())
    note = done.stderr.splitlines()[0]
    assert note.startswith("note: this command is now: deitalk ")
    if line.startswith("controls"):
        assert note.endswith("deitalk face controls --json") and len(json.loads(done.stdout)) == 185


def test_options_of_every_day_are_the_first_panel_of_animate():
    options = [p for p in get_command(app).commands["animate"].params if p.opts[0][0] == "-"]
    shown = {}
    for option in options:
        if not option.hidden:
            shown.setdefault(getattr(option, "rich_help_panel", None), []).append(option.opts[0])
    assert next(iter(shown)) is None and len(shown[None]) <= 10, shown
    assert {"--out", "--emotion", "--intensity", "--words"} <= {*shown[None]}
    assert {"Editing", "Performance", "Expert"} <= {*shown}
