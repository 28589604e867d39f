"""Detection scores of lip contacts, bite and rounding, by phone.

The protocol is that of `deitalk.evaluation.validation`: the highest value of a curve within a
phone widened by two frames, against the same in phones that are 67 ms away from all phones of
the gesture. Letters: T frames.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.evaluation.scores import area_under_curve, hit_rate
from deitalk.evaluation.validation import is_clear
from deitalk.postprocess.phones import (
    BILABIALS,
    CLEAR_SECONDS,
    LABIODENTALS,
    SILENCE,
    VOWELS,
    WIDEN_FRAMES,
    Phones,
)
from rig import ControlSet
from rig.arrays import Float32

MAX_LAG_FRAMES = 4
CONTACTS = BILABIALS | LABIODENTALS
SHUT = 0.5
"""Least value of the lips-together controls of lips that count as shut."""


@dataclass(frozen=True)
class Gesture:
    """A gesture of the lips, the phones that require it and its counter-examples."""

    controls: tuple[str, ...]
    """Parts of control names; the gesture's curve is the mean of these controls."""
    phones: tuple[str, ...]
    against: frozenset[str]
    near: frozenset[str]
    """Phones whose neighbourhood is excluded from the counter-examples."""
    widen: int = WIDEN_FRAMES


CLOSURE = Gesture(("lipsTogether",), ("P", "B", "M"), VOWELS, frozenset("P B M F V W".split()))
BITE = Gesture(("lipBiteD",), ("F", "V"), VOWELS, frozenset("P B M F V".split()))
ROUND = frozenset("UW OW UH AO OY AW ER R W SH ZH CH JH".split())
ROUNDING = Gesture(
    ("mouth_funnel", "mouth_purse"), ("UW", "OW", "W", "SH"),
    frozenset("IY IH EH EY AE AH S Z T D N L".split()), ROUND, widen=0,
)  # fmt: skip
GESTURES = {"closure": CLOSURE, "bite": BITE, "rounding": ROUNDING}

Peaks = dict[str, list[float]]


def gesture_curve(curves: Float32, controls: ControlSet, gesture: Gesture) -> Float32:
    """Mean of a gesture's controls [shape=(T,)]."""
    names = controls.names
    places = [i for i, n in enumerate(names) if any(part in n for part in gesture.controls)]
    mean: Float32 = curves[:, places].mean(axis=1)
    return mean


def gesture_peaks(curve: Float32, phones: Phones, gesture: Gesture) -> Peaks:
    """Highest value within every phone of interest, by name; ``-`` holds the counter-examples.

    Parameters
    ----------
    curve : ndarray [shape=(T,)]
        At 30 frames per second.
    phones : sequence of (start, end, name)
        Seconds.
    gesture : Gesture
        Gesture to find.
    """
    times = np.arange(len(curve)) / FRAME_RATE
    busy = [(start, end) for start, end, name in phones if name in gesture.near]
    peaks: Peaks = defaultdict(list)
    slack = gesture.widen / FRAME_RATE + 1e-9
    for start, end, name in phones:
        if name in gesture.phones:
            window = curve[(times >= start - slack) & (times <= end + slack)]
            if len(window):
                peaks[name].append(float(window.max()))
        elif name in gesture.against:
            window = curve[(times >= start) & (times < end)]
            if len(window) and is_clear(start, end, busy):
                peaks["-"].append(float(window.max()))
    return dict(peaks)


def phone_table(collected: Sequence[Peaks], gesture: Gesture) -> dict[str, dict[str, float]]:
    """Per phone: number, hit rate at 5 % false alarms over the counter-examples, and AUC."""
    pooled: Peaks = defaultdict(list)
    for peaks in collected:
        for name, values in peaks.items():
            pooled[name] += values
    others = np.array(pooled["-"])
    return {
        name: {
            "n": len(pooled[name]),
            "hits": hit_rate(np.array(pooled[name]), others),
            "auc": area_under_curve(np.array(pooled[name]), others),
        }
        for name in gesture.phones
    }


def shut_frames(lips: Float32, phones: Phones) -> dict[str, tuple[int, int]]:
    """Frames of every sound that needs no contact of the lips, and how many of them are shut.

    Only frames that are `CLEAR_SECONDS` away from every p, b, m, f and v count, for the lips are on
    their way there before and after; silence does not.

    Parameters
    ----------
    lips : ndarray [shape=(T,)]
        Mean of the lips-together controls, shut at `SHUT` and above.
    phones : sequence of (start, end, name)
        Seconds.

    Returns
    -------
    dict
        Phone: frames, and shut frames.
    """
    times = np.arange(len(lips)) / FRAME_RATE
    near = np.zeros(len(lips), bool)
    for start, end, name in phones:
        if name in CONTACTS:
            near |= (times > start - CLEAR_SECONDS) & (times < end + CLEAR_SECONDS)
    counts: dict[str, tuple[int, int]] = {}
    for start, end, name in phones:
        if name in CONTACTS or name == SILENCE:
            continue
        within = (times >= start) & (times < end) & ~near
        frames, shut = counts.get(name, (0, 0))
        counts[name] = frames + int(within.sum()), shut + int((lips[within] >= SHUT).sum())
    return counts


def shut_table(collected: Sequence[dict[str, tuple[int, int]]]) -> dict[str, dict[str, float]]:
    """Per phone, and for ``all``: number of frames ``n``, and share that is ``shut``."""
    total: dict[str, list[int]] = {"all": [0, 0]}
    for counts in collected:
        for name, (frames, shut) in counts.items():
            for key in (name, "all"):
                pair = total.setdefault(key, [0, 0])
                pair[0] += frames
                pair[1] += shut
    return {
        name: {"n": frames, "shut": shut / frames if frames else float("nan")}
        for name, (frames, shut) in sorted(total.items())
    }


def jaw_in_contact(lips: Float32, jaw: Float32, level: float = 0.9) -> float:
    """Mean opening of the jaw while the lips are together; NaN if they never are."""
    held = lips >= level
    return float(jaw[held].mean()) if held.any() else float("nan")
