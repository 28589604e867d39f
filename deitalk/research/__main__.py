"""`python -m deitalk.research`: the verbs of a checkout."""

from deitalk.cli import main
from deitalk.research.cli import app

if __name__ == "__main__":
    main(app, "python -m deitalk.research")
