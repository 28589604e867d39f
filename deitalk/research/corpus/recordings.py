"""Recordings of people: folders of speech with transcripts."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.audio.load import load_audio
from deitalk.errors import ConfigError, DataError

LONGEST_SECONDS = 600
"""Longest recording, seconds."""
AUDIO_SUFFIXES = (".flac", ".wav", ".mp3", ".opus", ".ogg")


@dataclass(frozen=True)
class Recording:
    """One recorded utterance, not yet read.

    Attributes
    ----------
    path : Path
        The audio file.
    text : str
        Transcript.
    speaker : str
        ``<source>:<name>``; the same for all recordings of one person.
    canonical_phones : tuple of str, optional
        Dictionary phones of the text (ARPABET without stress), where the source gives them.
    age : int, optional
        Years, where the source gives it.
    """

    path: Path
    text: str
    speaker: str
    canonical_phones: tuple[str, ...] | None = None
    age: int | None = None


def recordings(folder: Path | str, layout: str = "auto") -> list[Recording]:
    """Recordings of a folder, in a fixed order.

    Parameters
    ----------
    folder : Path
        One of the layouts below.
    layout : str
        ``librispeech``: ``<speaker>/<chapter>/*.trans.txt`` beside flac files;
        ``tsv``: tables ``<source>.tsv`` with the columns path, speaker, text and optionally age
        and phones; ``clips``: ``clips.csv`` with the columns audio, transcript and optionally clip,
        speaker and age; ``auto``: whichever of them is there.

    Returns
    -------
    recordings : list of Recording

    Raises
    ------
    DataError
        If the folder has no recordings, a column is missing, or a row names a missing file.
    ConfigError
        If `layout` is unknown.
    """
    folder = Path(folder)
    if layout not in (*_READERS, "auto"):
        raise ConfigError(f"layout={layout!r} must be one of {', '.join((*_READERS, 'auto'))}")
    if not folder.is_dir():
        raise DataError(f"{folder} is not a folder; give the folder of the recordings")
    for name in _READERS if layout == "auto" else (layout,):
        found = list(_READERS[name](folder))
        if found:
            return found
    raise DataError(
        f"{folder} has no recordings with transcripts; it needs clips.csv (audio, transcript, "
        "speaker), tables *.tsv (path, speaker, text) or LibriSpeech's *.trans.txt"
    )


def read_waveform(path: Path | str) -> np.ndarray:
    """Audio file as 16 kHz mono, read as `deitalk.audio.load.load_audio` reads it for animation.

    Parameters
    ----------
    path : Path
        Any format of that function.

    Returns
    -------
    waveform : float32 array [shape=(S,), 16 kHz, range -1 to 1]

    Raises
    ------
    AudioError
        If the file cannot be read, is empty or longer than `LONGEST_SECONDS`.
    """
    waveform = load_audio(Path(path), max_seconds=LONGEST_SECONDS).waveform
    return np.asarray(np.clip(waveform, -1, 1), np.float32)


def _librispeech(folder: Path) -> Iterator[Recording]:
    """``1272-128104-0000 MISTER QUILTER ...`` lines beside 1272-128104-0000.flac."""
    for transcript in sorted(folder.rglob("*.trans.txt")):
        for line in transcript.read_text(encoding="utf-8").splitlines():
            key, _, text = line.strip().partition(" ")
            if not text:
                continue
            audio = _beside(transcript.parent, key)
            yield Recording(audio, text, f"librispeech:{key.split('-')[0]}")


def _beside(folder: Path, key: str) -> Path:
    """The audio file named `key` with any known suffix."""
    for suffix in AUDIO_SUFFIXES:
        if (audio := folder / f"{key}{suffix}").is_file():
            return audio
    raise DataError(f"{folder / key}.flac is missing, its transcript exists")


def _tables(folder: Path) -> Iterator[Recording]:
    """Recordings of every <source>.tsv of the folder."""
    for table in sorted(folder.glob("*.tsv")):
        for row in _rows(table, ("path", "speaker", "text"), is_tsv=True):
            yield Recording(
                path=_existing(folder / row["path"], table),
                text=row["text"],
                speaker=f"{table.stem}:{row['speaker']}",
                canonical_phones=_canonical(row.get("phones") or ""),
                age=_age(row),
            )


def _clips(folder: Path) -> Iterator[Recording]:
    """Recordings of a clips.csv."""
    table = folder / "clips.csv"
    if not table.is_file():
        return
    for row in _rows(table, ("audio", "transcript"), is_tsv=False):
        if row["transcript"]:
            speaker = row.get("speaker") or "unnamed"
            audio = _existing(folder / row["audio"], table)
            name = f"{folder.resolve().name}:{speaker}"
            yield Recording(audio, row["transcript"], name, age=_age(row))


_READERS = {"clips": _clips, "tsv": _tables, "librispeech": _librispeech}


def _rows(table: Path, needed: tuple[str, ...], *, is_tsv: bool) -> Iterator[dict[str, str]]:
    """Rows of a table that must have the columns `needed`."""
    with table.open(encoding="utf-8-sig", newline="") as file:
        reader = (
            csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE)
            if is_tsv
            else csv.DictReader(file)
        )
        absent = [name for name in needed if name not in (reader.fieldnames or ())]
        if absent:
            raise DataError(f"{table} lacks the column(s) {', '.join(absent)} in its first line")
        for row in reader:
            yield {key: (value or "").strip() for key, value in row.items() if key is not None}


def _age(row: dict[str, str]) -> int | None:
    """Age of a row in years, or None."""
    text = row.get("age") or ""
    return int(text) if text.isdecimal() else None


def _existing(path: Path, table: Path) -> Path:
    """Return `path`, named in `table`, if it exists."""
    if not path.is_file():
        raise DataError(f"{table} names {path}, which does not exist")
    return path


def _canonical(phones: str) -> tuple[str, ...] | None:
    """``W_B IY0_E | K_B AO0_I L_E`` as (W, IY, K, AO, L); None if the table gives nothing."""
    names = [token.split("_")[0].rstrip("012") for token in phones.split() if token != "|"]
    return tuple(names) or None
