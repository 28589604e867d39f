"""Run the commands of reports, and write ``docs/results/NAME.json``; then ``make docs``.

::

    python docs/make_reports.py --list
    python docs/make_reports.py default-test live-run --place corpus/=/data/corpus
    python docs/make_reports.py --group weights --places places.txt

Words such as ``corpus/`` stand for data (`PLACES` of ``result_tables/commands.py``): ``--place
WORD=PATH``, or lines of that form in a file outside git. Commands run in the root of the
repository. A command that fails leaves its report as it was; the others go on, and the exit code is
1.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs/results"
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

from result_tables.commands import COMMANDS, GROUPS, PLACES  # noqa: E402

from rig.files import atomic_write  # noqa: E402

Command = list[str]


def read_places(file: Path | None, given: Sequence[str]) -> dict[str, str]:
    """Paths by word.

    Raises
    ------
    ValueError
        If a line is not of the form WORD=PATH, or the word stands for nothing.
    """
    lines = [] if file is None else file.read_text(encoding="utf-8").splitlines()
    places = {}
    for line in (*lines, *given):
        if not line.strip() or line.startswith("#"):
            continue
        word, _, path = line.strip().partition("=")
        if word not in PLACES or not path:
            raise ValueError(f"{line!r}: must be WORD=PATH, the word one of {', '.join(PLACES)}")
        places[word] = str(Path(path).expanduser().absolute())
    return places


def filled(command: str, places: dict[str, str], out: Path) -> Command:
    """Words of a command, with paths where words stand for data.

    Raises
    ------
    ValueError
        If a path is not known and the word is no file of the repository's root.
    """
    places = places | {"OUT": str(out / "OUT")}
    words = []
    for word in shlex.split(command):
        head, slash, rest = word.partition("/")
        place = next((p for p in (word, head + slash, head) if p in places or p in PLACES), None)
        if place is None:
            words.append(word)
        elif place in places:
            words.append(str(Path(places[place], rest)) if rest else places[place])
        elif (ROOT / word).exists():
            words.append(word)
        else:
            raise ValueError(f"{place} is needed ({PLACES[place]}); give --place {place}=PATH")
    return words


def runnable(words: Command, report: Path) -> tuple[Command, Path | None]:
    """A command that writes a report, and the file of it; None if it prints the report."""
    own = ["python", "-m", "deitalk.research"]
    is_verb = words[:3] == own or words[0] == "deitalk"
    if words[0] == "deitalk":
        words = ["python", "-m", *words]
    action, rest = words[3] if is_verb else "", [sys.executable, *words[1:]]
    if not is_verb:
        return [*rest, "--json", str(report)], report
    if action == "evaluate" and "--speed" not in words:
        return [*rest, "-o", str(report), "--force"], report
    if action in ("ablate", "finetune", "folds"):
        name = {"ablate": "ablations", "finetune": "report"}.get(action, action)
        return rest, ROOT / words[words.index("-o") + 1] / f"{name}.json"
    return rest, None


def make(name: str, places: dict[str, str]) -> None:
    """Write a report.

    Raises
    ------
    ValueError
        If a place is not known or the command gives no report.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        (out / "OUT").mkdir()
        words = filled(COMMANDS[name], places, out)
        if {"finetune", "folds"} & {*words}:
            (out / "OUT").rmdir()
        command, file = runnable(words, out / f"{name}.json")
        paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        done = subprocess.run(
            command,
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": paths},
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        if file is not None and not file.is_file():
            raise ValueError(f"ended with {done.returncode} and wrote no report")
        if file is None and done.returncode:
            raise ValueError(f"ended with {done.returncode}")
        found = json.loads(done.stdout if file is None else file.read_text(encoding="utf-8"))
    found.pop("out", None)
    with atomic_write(RESULTS / f"{name}.json") as beside:
        beside.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def main() -> int:
    """Run from a command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="reports")
    parser.add_argument("--group", choices=GROUPS, action="append", default=[], help="all of these")
    parser.add_argument("--place", action="append", default=[], metavar="WORD=PATH")
    parser.add_argument("--places", type=Path, help="file with a line WORD=PATH for each place")
    parser.add_argument(
        "--list",
        action="store_true",
        help="print the command of every report, and the words for data",
    )
    given = parser.parse_args()
    if given.list:
        for group, commands in GROUPS.items():
            for name, command in commands.items():
                sys.stdout.write(f"{group:8} {name:18} {command}\n")
        for word, meaning in PLACES.items():
            sys.stdout.write(f"{'place':8} {word:18} {meaning}\n")
        return 0
    names = list(dict.fromkeys([*given.names, *(n for g in given.group for n in GROUPS[g])]))
    if unknown := [name for name in names if name not in COMMANDS]:
        parser.error(f"no report {', '.join(unknown)}; --list prints them")
    try:
        places = read_places(given.places, given.place)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    failed = []
    for name in names:
        began = time.perf_counter()
        try:
            make(name, places)
            result = "written"
        except (OSError, ValueError) as error:
            result = f"failed: {error}"
            failed.append(name)
        sys.stderr.write(f"{name}: {result}, {time.perf_counter() - began:.0f} s\n")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
