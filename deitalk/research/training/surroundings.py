"""Folders of recordings of noise and rooms, for the augmentation of trainings."""

from pathlib import Path

from deitalk.audio.load import load_audio
from deitalk.data.augment_waveform import Surroundings
from deitalk.errors import DataError
from rig.arrays import Float32

SUFFIXES = (".flac", ".wav", ".ogg")


def read_surroundings(noise_folder: str | None, room_folder: str | None) -> Surroundings:
    """Read every audio file of two folders; None for no such folder."""
    noises, rooms = (
        () if folder is None else tuple(sound for _, sound in read_recordings(folder))
        for folder in (noise_folder, room_folder)
    )
    return Surroundings(noises, rooms)


def read_recordings(folder: Path | str, most: int | None = None) -> list[tuple[str, Float32]]:
    """File names without suffix and recordings of a folder, in alphabetical order.

    Parameters
    ----------
    folder : Path or str
        Only its own files are read, not those of subfolders.
    most : int, optional
        Number of files to read; all without it.

    Raises
    ------
    DataError
        If the folder holds no recording.
    """
    files = sorted(f for f in Path(folder).glob("*") if f.suffix.lower() in SUFFIXES)
    if not files:
        raise DataError(f"{folder}: holds no {', '.join(SUFFIXES)}; name a folder of recordings")
    return [(file.stem, load_audio(file).waveform) for file in files[:most]]
