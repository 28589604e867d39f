"""The mesh folder: recordings, templates and gradients of mesh sequences, ready to train on.

::

    mesh.json                   frames per second, millimetres in a unit
    clips.csv                   clip, speaker, split
    templates/<speaker>.ply     the expressionless mesh; all have the same triangles
    audio/<clip>.flac           16 kHz
    gradients/<clip>.s.npy      packed stretch, float16 [shape=(T, 6 N)]
    gradients/<clip>.r.npy      packed rotation, float16 [shape=(T, 3 N)]

Frame i is at i / fps seconds of the recording. Gradients are computed once, when the folder is
written: they cost some thousand times a training step's arithmetic on the same frame.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deitalk.audio import SAMPLE_RATE, load_audio
from deitalk.data.folder import SPLITS
from deitalk.errors import DataError
from rig.files import atomic_write
from rig.mesh import TriMesh, pack_vertices, read_ply, write_ply

FORMAT_VERSION = 1


@dataclass(frozen=True, eq=False)
class MeshSequence:
    """A recording and the meshes that go with it.

    Parameters
    ----------
    name : str
        Of the clip; no path separators.
    speaker, split : str
        Whose template it moves; train, validation or test.
    waveform : array [shape=(S,), float32]
        16 kHz.
    vertices : array [shape=(T, V, 3)]
        Frame i is at i / fps seconds.
    """

    name: str
    speaker: str
    split: str
    waveform: NDArray[np.float32]
    vertices: NDArray[np.float32]


@dataclass(frozen=True)
class MeshClip:
    """One row of the mesh folder."""

    folder: Path
    name: str
    speaker: str
    split: str

    def waveform(self) -> NDArray[np.float32]:
        """The recording as it was stored [shape=(S,)]."""
        return load_audio(self.folder / "audio" / f"{self.name}.flac").waveform

    def gradients(self) -> tuple[NDArray[np.float16], NDArray[np.float16]]:
        """Packed s [shape=(T, 6 N)] and r [shape=(T, 3 N)], mapped from the disk.

        Raises
        ------
        DataError
            If a file is missing or damaged, or the two do not belong together.
        """
        s, r = (self._array(kind) for kind in "sr")
        if len(s) != len(r) or s.shape[1] != 2 * r.shape[1] or len(s) < 2:
            raise DataError(
                f"{self.folder}: gradients of {self.name!r} have shapes {s.shape} and {r.shape}; "
                "at least two frames of (T, 6 N) and (T, 3 N) are needed; build the folder again"
            )
        return s, r

    def _array(self, kind: str) -> NDArray[np.float16]:
        path = self.folder / "gradients" / f"{self.name}.{kind}.npy"
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise DataError(f"{path}: cannot be read ({error}); build the folder again") from None
        if array.ndim != 2 or array.dtype != np.float16:
            raise DataError(f"{path}: holds {array.dtype} {array.shape}; build the folder again")
        return np.asarray(array)


@dataclass(frozen=True, eq=False)
class MeshFolder:
    """What a mesh folder holds.

    Parameters
    ----------
    fps : float
        Frames per second of every sequence.
    unit_mm : float
        Millimetres in a unit of the templates.
    templates : dict of str to TriMesh
        By speaker, in alphabetical order.
    clips : tuple of MeshClip
        In the table's order.
    """

    fps: float
    unit_mm: float
    templates: dict[str, TriMesh]
    clips: tuple[MeshClip, ...]

    def split(self, name: str) -> list[MeshClip]:
        """Clips of one split."""
        return [clip for clip in self.clips if clip.split == name]

    @property
    def training_speakers(self) -> tuple[str, ...]:
        """Speakers of the training split: the places of a one-hot label."""
        return tuple(sorted({clip.speaker for clip in self.split("train")}))


def write_mesh_folder(
    out: Path,
    templates: Mapping[str, TriMesh],
    sequences: Iterable[MeshSequence],
    *,
    fps: float,
    unit_mm: float,
) -> None:
    """Compute the gradients of sequences and write them, all or nothing.

    Parameters
    ----------
    out : Path
        Folder to make; its parent must exist.
    templates : mapping of str to TriMesh
        Expressionless mesh of every speaker.
    sequences : iterable of MeshSequence
        Read one at a time.
    fps : float
        Of all sequences.
    unit_mm : float
        Millimetres in the templates' unit.

    Raises
    ------
    DataError
        If `out` is there already, templates differ in their triangles, or a sequence has no
        template, an unknown split, a doubled name or fewer than two frames; or there is none.
    rig.errors.MeshError
        If a triangle has no area.
    """
    import soundfile

    if out.exists():
        raise DataError(f"{out}: exists already; name another folder or remove it")
    _check_templates(templates)
    rows: list[dict[str, str]] = []
    with atomic_write(out) as beside:
        for name in ("templates", "audio", "gradients"):
            (beside / name).mkdir(parents=True)
        for speaker, template in templates.items():
            write_ply(beside / "templates" / f"{speaker}.ply", template)
        for sequence in sequences:
            _check_sequence(sequence, templates, rows)
            s, r = pack_vertices(templates[sequence.speaker], sequence.vertices)
            for kind, numbers in (("s", s), ("r", r)):
                largest = np.finfo(np.float16).max
                half = np.clip(numbers, -largest, largest).astype(np.float16)
                np.save(beside / "gradients" / f"{sequence.name}.{kind}.npy", half)
            quiet = sequence.waveform / max(1.0, float(np.abs(sequence.waveform).max(initial=0)))
            soundfile.write(beside / "audio" / f"{sequence.name}.flac", quiet, SAMPLE_RATE)
            rows.append(
                {"clip": sequence.name, "speaker": sequence.speaker, "split": sequence.split}
            )
        if not rows:
            raise DataError(f"{out}: no sequences to write; check the source's clips and splits")
        pd.DataFrame(rows).to_csv(beside / "clips.csv", index=False)
        about = {"format_version": FORMAT_VERSION, "fps": fps, "unit_mm": unit_mm}
        (beside / "mesh.json").write_text(json.dumps(about) + "\n")


def _check_templates(templates: Mapping[str, TriMesh]) -> None:
    first = next(iter(templates.values()), None)
    for speaker, template in templates.items():
        assert first is not None
        if len(template.vertices) != len(first.vertices) or not np.array_equal(
            template.faces, first.faces
        ):
            raise DataError(
                f"the template of {speaker!r} has other triangles than that of "
                f"{next(iter(templates))!r}; all speakers must share one topology"
            )


def _check_sequence(
    sequence: MeshSequence, templates: Mapping[str, TriMesh], rows: list[dict[str, str]]
) -> None:
    name = sequence.name
    if not name or Path(name).name != name or name.startswith("."):
        raise DataError(f"clip {name!r}: the name must be usable as a file's")
    if any(row["clip"] == name for row in rows):
        raise DataError(f"clip {name!r} appears twice; names must differ")
    if sequence.speaker not in templates:
        raise DataError(f"clip {name!r}: speaker {sequence.speaker!r} has no template; add one")
    if sequence.split not in SPLITS:
        raise DataError(
            f"clip {name!r}: split {sequence.split!r} is unknown; known are {', '.join(SPLITS)}"
        )
    if len(sequence.vertices) < 2:
        raise DataError(f"clip {name!r}: {len(sequence.vertices)} frames; at least 2 are needed")


def read_mesh_folder(folder: Path | str) -> MeshFolder:
    """Read what `write_mesh_folder` wrote; gradients stay on the disk.

    Raises
    ------
    DataError
        If a file is missing or damaged, or a clip's speaker has no template.
    """
    folder = Path(folder)
    try:
        about = json.loads((folder / "mesh.json").read_text(encoding="utf-8"))
        version = about["format_version"]
        fps, unit_mm = float(about["fps"]), float(about["unit_mm"])
        table = pd.read_csv(folder / "clips.csv", dtype=str, keep_default_na=False)
        rows = list(zip(table["clip"], table["speaker"], table["split"], strict=True))
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise DataError(f"{folder}: no mesh folder ({reason}); build it again") from None
    if version != FORMAT_VERSION:
        raise DataError(f"{folder}: format version {version}; this deitalk reads {FORMAT_VERSION}")
    if not (np.isfinite([fps, unit_mm]).all() and fps > 0 and unit_mm > 0):
        raise DataError(f"{folder}/mesh.json: fps {fps:g} and unit_mm {unit_mm:g} must be above 0")
    if any(Path(word).name != word for row in rows for word in row):
        raise DataError(f"{folder}/clips.csv: a name is empty or leaves the folder; mend the row")
    templates = {p.stem: read_ply(p) for p in sorted((folder / "templates").glob("*.ply"))}
    _check_templates(templates)
    missing = sorted({speaker for _, speaker, _ in rows} - templates.keys())
    if missing:
        raise DataError(f"{folder}: speaker {missing[0]!r} has no template; build it again")
    return MeshFolder(fps, unit_mm, templates, tuple(MeshClip(folder, *row) for row in rows))
