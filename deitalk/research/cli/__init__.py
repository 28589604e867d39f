"""Verbs of the command line that a checkout has beside those of the wheel."""

from deitalk.cli import root
from deitalk.cli.data import app as data_app
from deitalk.cli.options import CheckedCommands
from deitalk.research.cli.ablate import ablate
from deitalk.research.cli.attention import attention
from deitalk.research.cli.corpus import app as corpus_app
from deitalk.research.cli.evaluate import evaluate
from deitalk.research.cli.folds import folds
from deitalk.research.cli.lips import lips
from deitalk.research.cli.sheet import sheet
from deitalk.research.cli.study import app as study_app
from deitalk.research.cli.train import train
from deitalk.research.cli.tuned import tuned

app = CheckedCommands(
    name="deitalk.research",
    help="Training, corpora, scores and studies.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.callback()(root)
for _verb in (ablate, attention, evaluate, folds, lips, sheet, train, tuned):
    app.command()(_verb)
app.add_typer(corpus_app, name="corpus")
app.add_typer(study_app, name="study")
app.add_typer(data_app, name="data")
