"""Verbs of the command line that a checkout has beside those of the wheel."""

from deitalk.cli.data import app as data_app
from deitalk.cli.face import app as face_app
from deitalk.cli.options import CheckedCommands
from deitalk.research.cli.ablate import ablate
from deitalk.research.cli.attention import attention
from deitalk.research.cli.corpus import app as corpus_app
from deitalk.research.cli.evaluate import evaluate
from deitalk.research.cli.lips import lips
from deitalk.research.cli.sheet import sheet
from deitalk.research.cli.study import app as study_app
from deitalk.research.cli.train import train

PANEL = "Research, in a checkout"
"""Panel of the help."""


def register(app: CheckedCommands) -> None:
    """Add the verbs of `deitalk.installed.VERBS` to the command line."""
    app.command(rich_help_panel=PANEL)(ablate)
    app.command(rich_help_panel=PANEL)(attention)
    app.command(rich_help_panel=PANEL)(evaluate)
    app.command(rich_help_panel=PANEL)(train)
    app.add_typer(corpus_app, name="corpus", rich_help_panel=PANEL)
    app.add_typer(study_app, name="study", rich_help_panel=PANEL)
    data_app.command(rich_help_panel=PANEL)(lips)
    face_app.command(rich_help_panel=PANEL)(sheet)
