"""Print pip's option for PyTorch's CPU wheels, or nothing for the wheels of PyPI.

``python torch_index.py auto`` chooses the CPU wheels where there is no NVIDIA GPU and their index
answers within `SECONDS`; ``cpu`` always does, ``pypi`` never. The second argument is another index.
"""

import shutil
import subprocess
import sys
from pathlib import Path

INDEX = "https://download.pytorch.org/whl/cpu"
SECONDS = 5
"""Longest time to wait for the index: names, connection and answer."""
OPEN = "import sys, urllib.request as u; u.urlopen(sys.argv[1] + '/torch/', timeout=30).read(1)"


def main(wish: str = "auto", index: str = INDEX) -> str:
    """Return the option, and say on stderr what it means."""
    if wish not in ("auto", "cpu", "pypi"):
        sys.exit(f"TORCH={wish} must be auto, cpu or pypi")
    reason = {"auto": _obstacle, "cpu": lambda _: "", "pypi": lambda _: "TORCH=pypi"}[wish](index)
    kind = f"PyPI's wheels, on Linux with CUDA ({reason})" if reason else f"CPU wheels of {index}"
    sys.stderr.write(f"torch: {kind}; TORCH=cpu or TORCH=pypi overrules\n")
    return "" if reason else f"--extra-index-url {index}"


def _obstacle(index: str) -> str:
    """Why the CPU wheels are not to be taken; empty if they are."""
    if shutil.which("nvidia-smi") or Path("/proc/driver/nvidia/version").exists():
        return "an NVIDIA GPU"
    try:
        command = [sys.executable, "-c", OPEN, index]
        subprocess.run(command, timeout=SECONDS, check=True, capture_output=True)
    except (OSError, subprocess.SubprocessError):
        return f"{index} does not answer"
    return ""


if __name__ == "__main__":
    sys.stdout.write(main(*sys.argv[1:]))
