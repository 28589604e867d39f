"""The verbs of the command line and the options of every day."""

from typer.main import get_command

from deitalk.cli import app

VERBS = """animate batch live preview convert diff dub validate retarget face install serve data finetune
model export""".split()


def test_sixteen_verbs_are_shown():
    commands = get_command(app).commands
    shown = {name for name, command in commands.items() if not command.hidden}
    assert shown == {*VERBS} and len(VERBS) == 16


def test_options_of_every_day_are_the_first_panel_of_animate():
    options = [p for p in get_command(app).commands["animate"].params if p.opts[0][0] == "-"]
    shown = {}
    for option in options:
        if not option.hidden:
            shown.setdefault(getattr(option, "rich_help_panel", None), []).append(option.opts[0])
    assert next(iter(shown)) is None and len(shown[None]) <= 10, shown
    assert {"--out", "--emotion", "--intensity", "--words"} <= {*shown[None]}
    assert {"Editing", "Performance", "Expert"} <= {*shown}
