"""Measured lips of which only half of the words are known, to test on words that were never taught.

::

    python -m deitalk.research.lips.vocabulary LIPS 0 -o lips_0           # one half, and the pauses
    python -m deitalk.research.lips.vocabulary LIPS 1 --alone -o words_1  # the other half alone

A model that is trained on the first folder has heard the other words and never seen lips say them;
``python -m deitalk.research evaluate MODEL --lips words_1`` scores it on those.
"""

import argparse
import shutil
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from deitalk.errors import DataError
from deitalk.research.lips.measured import MISSING, RATE, SOUNDS, read_lips, read_rows
from rig import limits
from rig.arrays import Bool, Float64
from rig.errors import UserError, one_line
from rig.files import output_folder
from rig.files.reading import read_npz

Words = Sequence[tuple[float, float, str]]


def halves(words: Iterable[str]) -> dict[str, int]:
    """Half of each word, 0 or 1: every second one in the order of the alphabet."""
    return {word: place % 2 for place, word in enumerate(sorted(set(words)))}


def keep_half(folder: Path, out: Path, half: int, *, alone: bool = False) -> float:
    """Write a copy of measured lips in which the frames of other words are missing.

    Parameters
    ----------
    folder : Path
        As in `deitalk.research.lips.measured`, with words.
    out : Path
        Folder to write.
    half : int
        0 or 1, as `halves` divides the words of the folder.
    alone : bool
        Frames outside all words are missing too.

    Returns
    -------
    float
        Share of the frames that are kept.

    Raises
    ------
    DataError
        If `folder` is no such folder, is damaged, or has less than two words.
    rig.errors.TargetError
        If `out` exists.
    """
    read_lips(folder, eye_distance=1.0)  # refuses a damaged folder before anything is written
    rows = list(read_rows(folder / "clips.csv"))
    half_of = halves(word for _, _, words in rows for _, _, word in words)
    if len(half_of) < 2:
        raise DataError(f"{folder}: has {len(half_of)} words; two halves need two")
    files = {path.name: path for path in sorted(folder.rglob("*")) if path.is_file()}
    shares = []
    with output_folder(out, kind="measured lips", force=False) as beside:
        for name in ("clips.csv", "columns.json"):
            shutil.copyfile(folder / name, beside / name)
        for clip, _, words in rows:
            chosen = [word for word in words if half_of[word[2]] == half]
            others = [word for word in words if half_of[word[2]] != half]
            shares.append(_copy(files, clip, beside, chosen, None if alone else others))
    return float(np.mean(shares))


def _copy(
    files: dict[str, Path], clip: str, out: Path, chosen: Words, others: Words | None
) -> float:
    """Write one clip, without `others` the chosen words alone; returns the share that is kept."""
    for name in (clip + suffix for suffix in SOUNDS):
        if name in files:
            shutil.copyfile(files[name], out / name)
    table = read_npz(files[f"{clip}.npz"], limit=limits.MESH_BYTES, error=DataError)["meas"]
    times: Float64 = (np.arange(len(table), dtype=np.float64) + 0.5) / RATE
    kept = _within(times, chosen) if others is None else ~_within(times, others)
    np.savez(out / f"{clip}.npz", meas=np.where(kept[:, None], table, MISSING).astype(np.int16))
    return float(kept.mean())


def _within(times: Float64, words: Words) -> Bool:
    inside = np.zeros(len(times), bool)
    for start, end, _ in words:
        inside |= (times >= start) & (times < end)
    return inside


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("lips", type=Path, help="folder of measured lips")
    parser.add_argument("half", type=int, choices=(0, 1), help="words that stay known")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--alone", action="store_true", help="pauses are missing too")
    options = parser.parse_args(arguments)
    try:
        share = keep_half(options.lips, options.out, options.half, alone=options.alone)
    except UserError as error:
        sys.stderr.write(f"deitalk: {one_line(str(error))}\n")
        return 1
    sys.stdout.write(f"{options.out}: {100 * share:.0f} % of the frames are kept\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
