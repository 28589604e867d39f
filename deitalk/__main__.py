"""``python -m deitalk``."""

import os
import sys

# `-m` puts the working folder first, before the standard library.
if sys.path[:1] != [os.path.dirname(os.path.dirname(__file__))] and not sys.flags.safe_path:
    del sys.path[0]

from deitalk.cli import program

program()
