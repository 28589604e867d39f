"""Tables of ARKit's shapes as other programs write them, all of one motion."""

import re

import numpy as np
import pytest

from deitalk.data.captures.take import read_capture
from rig import read_curves
from rig.conversion.arkit import ARKIT_ID, HEAD, arkit_controls

NAMES = arkit_controls().names
SHAPES = NAMES[:52]
HEADS = [NAMES.index(name) for name in HEAD]
SECONDS = 2.5


def motion(times):
    """Values of all columns at given seconds [shape=(T, 61)]: smooth, every shape moves."""
    peak = np.linspace(0.1, 0.9, 52)
    swing = 0.5 - 0.5 * np.cos(2 * np.pi * (0.4 + 0.1 * np.arange(52) % 1) * times[:, None])
    values = np.zeros((len(times), 61))
    values[:, :52] = peak * swing
    values[:, HEADS] = 0.3 * np.sin(times[:, None] * [1, 2, 3])  # 15 degrees
    return values


def frames(fps, seconds=SECONDS):
    times = np.arange(round(seconds * fps)) / fps
    return times, motion(times)


def apple(name):
    return name[0].lower() + name[1:]


def cells(row, digits=5):
    return (f"%.{digits}f " * len(row) % tuple(row)).split()


def table(times, values, names=SHAPES, *, head="time", stamp=lambda t: f"{t:.6f}", digits=5):
    """A CSV with commas."""
    rows = [[stamp(t), *cells(v[: len(names)], digits)] for t, v in zip(times, values, strict=True)]
    return [[head, *names], *rows]


def text(rows, separator=",", end="\n"):
    return end.join(separator.join(map(str, row)) for row in rows) + end


def live_link(times, values, count=60, *, drop=False, start=0.0, names=NAMES):
    """Rows of a Live Link CSV whose frame field counts so many frames."""
    step = count * 1000 / 1001 if drop else count
    rows = []
    for t, v in zip(times, values, strict=True):
        parts = round((t + start) * step * 1000)
        number, thousandths = divmod(parts, 1000)
        if drop:
            number = labelled(number, count)
        seconds, frame = divmod(number, count)
        h, m, s = seconds // 3600 % 24, seconds // 60 % 60, seconds % 60
        mark = ";" if drop else ":"
        rows.append([f"{h:02d}:{m:02d}:{s:02d}{mark}{frame:02d}.{thousandths:03d}", 61, *cells(v)])
    return [["Timecode", "BlendshapeCount", *names], *rows]


def labelled(number, count):
    """Number of a drop-frame code that counts all numbers, by a loop over minutes."""
    minute = 0
    left = 0
    while True:
        length = count * 60 - (left if minute % 10 else 0)
        if number < length:
            skipped = left if minute % 10 else 0
            return minute * 60 * count + number + skipped
        number -= length
        minute += 1
        left = 2 if count == 30 else 4


def sides(name, left, right):
    if name.endswith("Left") and name not in ("JawLeft", "MouthLeft"):
        return name[:-4] + left
    if name.endswith("Right") and name not in ("JawRight", "MouthRight"):
        return name[:-5] + right
    return name


def snake(name):
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


SPELLINGS = {
    "app": lambda n: n,
    "apple": apple,
    "apple_L": lambda n: apple(sides(n, "_L", "_R")),
    "Apple_L": lambda n: sides(n, "_L", "_R"),
    "apple_l": lambda n: apple(sides(n, "_l", "_r")),
    "appleL": lambda n: apple(sides(n, "L", "R")),
    "apple.L": lambda n: apple(sides(n, ".L", ".R")),
    "apple_Left": lambda n: apple(sides(n, "_Left", "_Right")),
    "apple_left": lambda n: apple(sides(n, "_left", "_right")),
    "snake": snake,
    "SNAKE": lambda n: snake(n).upper(),
    "small": str.lower,
    "large": str.upper,
    "words": lambda n: snake(n).replace("_", " "),
    "prefixed": lambda n: f"blendShapes.{apple(n)}",
}


def both(path, fps=None):
    """Curves of ARKit's shapes by `read_curves`, and the capture."""
    return read_curves(path, control_set=None, fps=fps), read_capture(path, fps=fps)


def assert_same(path, fps, *, tolerance=2e-3, given=None, columns=slice(0, 52), note=""):
    curves, capture = both(path, given)
    assert curves.control_set == ARKIT_ID
    assert curves.fps == pytest.approx(fps, abs=1e-3) == capture.curves.fps
    expected = motion(curves.times)[:, columns]
    assert np.abs(curves.values[:, columns] - expected).max() < tolerance
    jaw = capture.curves["CTRL_C_jaw.ty"]
    assert np.abs(jaw - expected[:, NAMES.index("JawOpen")]).max() < tolerance
    for notes in (curves.notes, capture.notes):
        assert note in "; ".join(notes)
    return curves, capture
