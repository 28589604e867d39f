"""The program ``deitalk``, which is ``python -m deitalk`` too."""

import os
import sys

# `-m` puts the working folder first, before the standard library.
if __name__ == "__main__" and not sys.flags.safe_path:
    if sys.path[:1] != [os.path.dirname(os.path.dirname(__file__))]:
        del sys.path[0]

from deitalk.signals import leave_on_ctrl_c


def run() -> None:
    """Run the command line as a process of its own; Ctrl-C is one line from here on."""
    leave_on_ctrl_c()
    from deitalk.cli import program

    program()


if __name__ == "__main__":
    run()
