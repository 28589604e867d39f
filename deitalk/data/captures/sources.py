"""Files and folders to takes: a file of curves, and the recording beside it.

A Live Link Face take is a folder as the app leaves it: ``<Slate>_<Take>_<Device>.csv`` beside a
``.mov`` of the same name. Of a calibrated take the ``_cal`` file is read, not ``_raw``; its
``_neutral`` file, ``frame_log.csv`` and the app's JSON files are no takes. A file ``anna_neutral``
that lies beside no take ``anna``, or has a recording of its name, is a take in that emotion.

A video is a take of its own where it is given by name, or its folder holds no curves.
"""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import Path

from deitalk.data.captures.take import VIDEOS, kind_of
from deitalk.errors import DataError
from rig import ControlSet
from rig.errors import UserError, quoted
from rig.formats.table import FORMATS
from rig.formats.wide_csv import read_header

CURVES = (".csv", ".json", ".npz", ".txt", ".tsv")
SOUNDS = (
    ".wav", ".flac", ".mov", ".mp4", ".m4v", ".m4a", ".mp3", ".ogg", ".opus", ".aac", ".webm",
    ".mkv", ".aif", ".aiff", ".wma",
)  # fmt: skip
"""Recordings and videos with sound, the best kind first."""
SIDE_FILES = (
    "frame_log.csv", "take.json", "video_metadata.json", "audio_metadata.json",
    "depth_metadata.json", "thumbnail.json", "clips.csv", "intensity.csv", "map.csv",
)  # fmt: skip
VARIANTS = ("_cal", "", "_raw")
"""Ends of the names of one take's files, the one to read first."""
SOUND_FOLDERS = ("audio", "sound", "sounds", "wav", "video")


@dataclass(frozen=True)
class Source:
    """One take: its curves, and its place below the given file or folder."""

    curves: Path
    place: str
    """Path below the given folder without suffix, with ``/``; labels are taken from it."""

    @property
    def stem(self) -> str:
        """Name of the take without variant."""
        return _stem(self.curves)


def find_takes(
    sources: Sequence[Path], columns: ControlSet | AbstractSet[str] | None = None
) -> tuple[list[Source], list[Path]]:
    """Find the takes of files and folders.

    Parameters
    ----------
    sources : sequence of Path
        Files of curves, videos, or folders that are searched to any depth.
    columns : ControlSet, set of str or None
        Names of another rig: tables that have some of them are the takes.

    Returns
    -------
    takes : list of Source
        In order of their paths.
    skipped : list of Path
        Files of a folder that could be curves and are none.

    Raises
    ------
    DataError
        If a source does not exist or holds no takes.
    """
    takes: list[Source] = []
    skipped: list[Path] = []
    for source in sources:
        if not source.exists():
            raise DataError(f"{source} does not exist; name a file or a folder of takes")
        if source.is_file():
            takes.append(Source(source, _place(source, source.absolute().parent.parent)))
            continue
        files = find_files(source)
        curves = [p for p in files if _holds_curves(p, columns)]
        skipped += [p for p in files if p not in set(curves)]
        # One file of each take: the best variant, and of equal names the exact format.
        best: dict[tuple[Path, str], Path] = {}

        def rank(path: Path) -> tuple[int, int]:
            ending = _without_suffix(path)[len(_stem(path)) :]
            formats = (".npz", ".json", ".csv", ".txt", ".tsv")
            return VARIANTS.index(ending), formats.index(path.suffix.lower())

        for path in curves:
            key = (path.parent, _stem(path))
            if key not in best or rank(path) < rank(best[key]):
                best[key] = path
        chosen = sorted(best.values())
        if not chosen and columns is None:
            chosen = [
                path
                for path in sorted(source.rglob("*"))
                if path.suffix.lower() in VIDEOS and not _is_hidden(path, source) and path.is_file()
            ]
        if not chosen and columns is not None:
            names = columns.names if isinstance(columns, ControlSet) else columns
            raise DataError(
                f"{source} holds no takes: no file of {', '.join(CURVES)} has a column of the map "
                f"or rig, such as {quoted(min(names))}"
            )
        if not chosen:
            raise DataError(
                f"{source} holds no takes: no file of {', '.join(CURVES)} with known curves and no "
                "video; for another rig give `mapping`, a table, or the name of its rig",
                parameter="mapping",
            )
        takes += [Source(path, _place(path, source.parent)) for path in chosen]
    return list(dict.fromkeys(takes)), skipped


def find_files(source: Path) -> list[Path]:
    """Files of a folder, to any depth, that may hold curves; a file itself."""
    if source.is_file():
        return [source]
    return [
        path
        for path in sorted(source.rglob("*"))
        if path.suffix.lower() in CURVES
        and path.name.lower() not in SIDE_FILES
        and not _is_calibration(path)
        and not _is_hidden(path, source)
        and path.is_file()
    ]


def find_sound(
    source: Source, named: str, folders: Sequence[Path], takes: Sequence[Source]
) -> Path:
    """Find the recording of a take.

    Parameters
    ----------
    source : Source
        The take.
    named : str
        Name of the recording that the file of curves holds; may be empty.
    folders : sequence of Path
        Folders of recordings, searched to any depth.
    takes : sequence of Source
        All takes: a folder with one take and one recording needs no equal names.

    Raises
    ------
    DataError
        If there is none.
    """
    beside = source.curves.parent
    places = [
        beside,
        *(beside / n for n in SOUND_FOLDERS),
        *(beside.parent / n for n in SOUND_FOLDERS),
    ]
    near = [p for place in places for p in _sounds(place)]
    far = [p for folder in folders for p in _sounds(folder, deep=True)]
    stems = {source.stem.lower(), _without_suffix(source.curves).lower()}
    if named:
        stems = {Path(named.replace("\\", "/")).stem.lower(), *stems}
    for group in (far, near):
        found = [p for p in group if _stem(p).lower() in stems or p.stem.lower() in stems]
        if found:
            return min(found, key=lambda p: SOUNDS.index(p.suffix.lower()))
    alone = [take for take in takes if take.curves.parent == beside]
    own = _sounds(beside)
    if len(alone) == 1 and len(own) == 1:
        return own[0]
    wanted = f"{source.stem}.wav, .mov or .mp4"
    raise DataError(
        f"{source.curves}: no audio beside the take; lay {wanted} there or give `audio`, a folder; "
        "`deitalk data voice` takes silent ones, for the traits of an actor",
        parameter="audio",
    )


def _sounds(folder: Path, *, deep: bool = False) -> list[Path]:
    if not folder.is_dir():
        return []
    paths = folder.rglob("*") if deep else folder.iterdir()
    return sorted(p for p in paths if p.suffix.lower() in SOUNDS and p.is_file())


def _is_calibration(path: Path) -> bool:
    """Whether it is the resting face of a take beside it, as Live Link Face writes one."""
    name = _without_suffix(path)
    take = name.removesuffix("_neutral")
    if take == name:
        return False
    beside = list(path.parent.iterdir())
    has_take = any(
        _without_suffix(p) != name and _stem(p) == take
        for p in beside
        if p.suffix.lower() in CURVES
    )
    return has_take and not any(p.stem == name for p in beside if p.suffix.lower() in SOUNDS)


def _is_hidden(path: Path, top: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(top).parts)


def _holds_curves(path: Path, columns: ControlSet | AbstractSet[str] | None) -> bool:
    try:
        if columns is not None:
            is_csv = path.suffix.lower() in (".csv", ".tsv")
            return not is_csv or any(name in columns for name in read_header(path))
        return kind_of(path) is not None
    except UserError:
        return True  # its error is reported with the take


def _stem(path: Path) -> str:
    """Name of a take: of its file without the format's suffix and without variant."""
    name = _without_suffix(path)
    for variant in VARIANTS:
        if variant and name.endswith(variant):
            return name.removesuffix(variant)
    return name


def _without_suffix(path: Path) -> str:
    """Name of a file without the longest suffix of a format: ``a.unreal.json`` is ``a``."""
    endings = [s for f in FORMATS for s in f.suffixes if path.name.lower().endswith(s)]
    longest = max((len(s) for s in endings), default=len(path.suffix))
    return path.name[: len(path.name) - longest] or path.name


def _place(path: Path, top: Path) -> str:
    path = path.absolute()
    inside = path.relative_to(top.absolute()) if path.is_relative_to(top.absolute()) else path
    return inside.with_name(_without_suffix(path)).as_posix()
