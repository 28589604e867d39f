"""The command ``python -m deitalk.evaluation.voice_activity``."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from deitalk.errors import DataError, DeitalkError
from deitalk.evaluation.report import write_json
from deitalk.evaluation.voice_activity.comparison import as_markdown, run
from rig.files import new_file


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command of the module's docstring; an error is one line on stderr."""
    parser = argparse.ArgumentParser(prog="python -m deitalk.evaluation.voice_activity")
    parser.add_argument("data", type=Path, help="dataset folder, from `deitalk corpus build`")
    parser.add_argument("--noise", required=True, help="folder of recordings, or pink")
    parser.add_argument("--music", default="synthetic", help="folder of recordings, or synthetic")
    parser.add_argument("--detectors", default="ours,silero,webrtc", help="names, by commas")
    parser.add_argument("--clips", type=int, default=30, help="most clips of a source of speech")
    parser.add_argument("--json", type=new_file, help="also write the report to this file")
    given = parser.parse_args(arguments)
    try:
        if given.clips < 1:
            raise DataError(f"--clips {given.clips}: must be at least 1")
        names = given.detectors.split(",")
        report = run(given.data, given.noise, given.music, names, given.clips)
        sys.stdout.write(as_markdown(report))
        write_json(given.json, report)
    except DeitalkError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
