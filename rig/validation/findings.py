"""One finding of a check of files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """One finding.

    Parameters
    ----------
    level : str
        ``error``, ``warning`` or ``note``.
    path : Path
        The file.
    text : str
        One line.
    """

    level: Level
    path: Path
    text: str
