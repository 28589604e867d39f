"""Make the virtual environment of the Makefile; an older Python can run this file, to be refused.

``python environment.py FOLDER`` keeps an environment that is whole and of a Python that
pyproject.toml allows; with ``--asked`` also only one of this Python. Others are made again.
"""

import os
import re
import shutil
import subprocess
import sys

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def main(folder, asked=""):
    """Make or keep the environment; an error is one line."""
    first, end = allowed()
    own, kept = sys.version_info[:2], version_of(folder)
    if kept and first <= kept[1] < end and (not asked or kept == own):
        return
    name = f"{sys.executable} (Python {own[0]}.{own[1]})"
    if not (own[0] == 3 and first <= own[1] < end):
        known = [f"python3.{minor}" for minor in range(first, end)]
        here = [name for name in known if shutil.which(name)]
        way = f"make demo PYTHON={(here or known)[0]}"
        way = way if here else f"install one, then {way}"
        sys.exit(f"{name} does not do; deitalk needs Python 3.{first} to 3.{end - 1}: {way}")
    if os.path.isdir(folder):
        if os.listdir(folder) and not os.path.exists(os.path.join(folder, "pyvenv.cfg")):
            sys.exit(f"{folder} is no virtual environment; name another folder: VENV=.venv")
        if os.path.dirname(os.path.realpath(folder)) != os.path.realpath(ROOT):
            # It may be of another project.
            sys.exit(
                f"{folder} is not whole or of another Python, and outside of this checkout: remove "
                "it, or name another folder: VENV=.venv"
            )
        sys.stderr.write(f"{folder} is not whole or of another Python: it is made again\n")
    base = getattr(sys, "_base_executable", None) or sys.executable
    done = subprocess.run([base, "-m", "venv", "--clear", folder], capture_output=True, text=True)
    if done.returncode:
        shutil.rmtree(folder, ignore_errors=True)
        reason = ((done.stdout + done.stderr).strip().splitlines() or ["no reason"])[0]
        sys.exit(
            f"{name} makes no environment ({reason}); on Debian and Ubuntu: sudo apt install "
            f"python3.{own[1]}-venv"
        )


def allowed():
    """First minor version of Python 3 that is allowed, and the first that is not."""
    with open(os.path.join(ROOT, "pyproject.toml"), encoding="utf-8") as stream:
        found = re.search(r'requires-python = ">=3\.(\d+),<3\.(\d+)"', stream.read())
    return int(found.group(1)), int(found.group(2))


def version_of(folder):
    """Version (major, minor) of a whole environment; None of any other."""
    scripts = os.path.join(folder, "bin")
    whole = all(os.path.exists(os.path.join(scripts, name)) for name in ("python", ".installed"))
    try:
        with open(os.path.join(folder, "pyvenv.cfg"), encoding="utf-8") as stream:
            found = re.search(r"^version\w* *= *(\d+)\.(\d+)", stream.read(), re.M)
    except OSError:
        return None
    return tuple(map(int, found.groups())) if whole and found else None


if __name__ == "__main__":
    main(*sys.argv[1:])
