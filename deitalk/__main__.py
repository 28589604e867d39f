"""``python -m deitalk``."""

from deitalk.cli import main

main()
