"""Pictures of the articulation and emotion tables: ``python -m deitalk.research corpus sheet``.

`plot_channels` draws the articulation of a sentence channel by channel; `draw_faces` draws phones
by emotions on the embedded head.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deitalk.emotions import EMOTIONS
from deitalk.errors import DataError
from deitalk.evaluation.figures import drawing
from deitalk.postprocess.phones import PHONES
from deitalk.research.corpus.articulation import CHANNELS, articulate
from deitalk.research.corpus.rig_targets import act
from deitalk.research.corpus.utterance import Phone
from rig import default_controls

SENTENCE = "SIL B OY Z F IY V AA M T UH N SH UW SIL DH AX W AO M P S L IY P IH NG F AE M L IY SIL"
"""Phones of the default picture: contacts, rounding, fricatives and diphthongs."""
SHEET_PHONES = ("SIL", "AA", "IY", "UW", "OW", "M", "F", "SH", "S", "TH", "L", "W")
SOUND_SECONDS, SILENCE_SECONDS = 0.11, 0.35
FPS = 120.0
STEADY_SECONDS = 0.4
"""Duration of a phone of the contact sheet between two vowels, seconds."""


def evenly_timed(names: Sequence[str]) -> list[Phone]:
    """Phones one after another, 0.11 s each, silences 0.35 s.

    Raises
    ------
    DataError
        If a name is no phone, or the list is empty.
    """
    unknown = [name for name in names if name not in PHONES]
    if unknown or not names:
        what = repr(unknown[0]) if unknown else "an empty list"
        raise DataError(f"{what} is no phone; phones are {' '.join(PHONES)}")
    lengths = [SILENCE_SECONDS if name == "SIL" else SOUND_SECONDS for name in names]
    ends = np.cumsum(lengths)
    return [
        Phone(float(end - length), float(end), name)
        for name, length, end in zip(names, lengths, ends, strict=True)
    ]


def plot_channels(phones: Sequence[Phone], path: Path) -> None:
    """Draw the articulation channels of a sentence, a row each, phones marked.

    Parameters
    ----------
    phones : sequence of Phone
        In time order.
    path : Path
        .png, .svg or .pdf.

    Raises
    ------
    MissingError
        If matplotlib is not installed.
    """
    n_frames = int(np.ceil(phones[-1].end * FPS))
    channels = articulate(phones, n_frames, FPS)
    times = np.arange(n_frames) / FPS
    with drawing(path, (14, 0.75 * len(CHANNELS) + 0.8)) as figure:
        axes = figure.subplots(len(CHANNELS), 1, sharex=True)
        for axis, name, values in zip(axes, CHANNELS, channels.T, strict=True):
            axis.fill_between(times, values, color="C0", alpha=0.4, lw=0)
            axis.plot(times, values, color="C0", lw=1)
            axis.set_ylim(0, 1.05)
            axis.set_yticks([])
            axis.set_ylabel(name, rotation=0, ha="right", va="center")
            for phone in phones:
                axis.axvline(phone.start, color="0.85", lw=0.6, zorder=0)
        for phone in phones:
            middle = (phone.start + phone.end) / 2
            axes[0].text(middle, 1.12, phone.name, ha="center", fontsize=8)
        axes[-1].set_xlabel("seconds")


def phone_pose(name: str, emotion: str, intensity: float) -> np.ndarray:
    """Control values of a phone held between two schwas, with an emotion [shape=(C,)].

    Parameters
    ----------
    name : str
        A phone; of a diphthong, its first part.
    emotion : str
        One of `deitalk.emotions.EMOTIONS`.
    intensity : float, range 0 to 1
        e(t) throughout.
    """
    side = 0.1
    phones = [
        Phone(0.0, side, "AX"),
        Phone(side, side + STEADY_SECONDS, name),
        Phone(side + STEADY_SECONDS, 2 * side + STEADY_SECONDS, "AX"),
    ]
    n_frames = round((2 * side + STEADY_SECONDS) * FPS)
    channels = articulate(phones, n_frames, FPS)
    weights = np.eye(len(EMOTIONS))[EMOTIONS.index(emotion)]
    curves = act(channels, weights, np.full(n_frames, intensity), FPS, default_controls())
    pose: np.ndarray = curves[round((side + 0.4 * STEADY_SECONDS) * FPS)]
    return pose


SHEET_INTENSITY = 0.8
"""e(t) of every picture of `draw_faces`."""


def draw_faces(
    path: Path,
    *,
    phones: Sequence[str] = SHEET_PHONES,
    emotions: Sequence[str] = EMOTIONS,
    tile: int = 220,
) -> None:
    """Draw a contact sheet of the embedded head: phones in rows, emotions in columns.

    Parameters
    ----------
    path : Path
        .png.
    phones, emotions : sequence of str
        Rows and columns.
    tile : int
        Height of a picture, pixels.
    """
    from deitalk.research.contact_sheet import Tile, draw_sheet, write_png
    from rig.face import build_head

    evenly_timed(phones)  # raises for unknown names
    tiles = [
        Tile(f"{phone} {emotion}", phone_pose(phone, emotion, SHEET_INTENSITY), "face")
        for phone in phones
        for emotion in emotions
    ]
    picture = draw_sheet(
        build_head(0),
        tiles,
        columns=len(emotions),
        size=(round(tile * 1.12), tile),
    )
    write_png(path, picture)
