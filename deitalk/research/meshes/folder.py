"""The mesh folder: recordings, templates and the motion of mesh sequences, ready to train on.

::

    mesh.json              format version, frames per second, millimetres in a unit
    clips.csv              clip, speaker, split, emotion (empty where it is not known)
    templates/<speaker>.ply    the expressionless mesh; all have the same triangles
    audio/<clip>.flac      16 kHz
    bases.npz              bases of stretch s and rotation r (`gradient_bases.py`)
    offsets.npz            basis of vertex offsets
    bases.csv              what each size of them costs on held-out frames
    lips.npz               upper, lower: facing vertices of the lips' rims; optional
    motion/<clip>.npz      stretch (T, Ks), rotation (T, Kr), offsets (T, Ko): coefficients, float16
                           lips (T, 2 P, 3): offsets of upper and lower rims, float32

Frame i is at i / fps seconds of the recording. Gradients cost some thousand times a training step's
arithmetic on the same frame, so they are computed once, and only their coefficients are kept: the
frozen last layer can give nothing else, and an hour is 0.1 GB instead of 16.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.data.clips import SPLITS
from deitalk.errors import DataError
from deitalk.research.meshes.mesh_bases import (
    MeshBases,
    fit_mesh_bases,
    read_mesh_bases,
    write_mesh_bases,
)
from deitalk.research.meshes.packing import pack_vertices
from rig.arrays import Bool, Float32, Float64, Int64
from rig.files import output_folder
from rig.mesh import TriMesh, read_ply, write_ply

FORMAT_VERSION = 2
MOTION = ("stretch", "rotation", "offsets", "lips")
"""Arrays of a clip's motion."""
LIPS_FILE = "lips.npz"
"""Where the rims are, if they are known."""

Load = Callable[[], tuple[Float32, Float32]]


@dataclass(frozen=True, eq=False)
class MeshSequence:
    """A recording and the meshes that go with it, loaded when needed.

    Parameters
    ----------
    name : str
        Of the clip; no path separators.
    speaker, split : str
        Whose template it moves; train, validation or test.
    load : callable
        Gives the waveform [shape=(S,), float32, 16 kHz] and the vertices [shape=(T, V, 3)],
        frame i at i / fps seconds.
    emotion : str
        What is acted; empty if not known.
    """

    name: str
    speaker: str
    split: str
    load: Load
    emotion: str = ""


@dataclass(frozen=True)
class Lips:
    """Vertices that face one another across the closed mouth: upper[i] over lower[i]."""

    upper: Int64
    lower: Int64

    @property
    def both(self) -> Int64:
        """Upper rim, then lower rim [shape=(2 P,)]."""
        return np.concatenate([self.upper, self.lower])


@dataclass(frozen=True)
class MeshClip:
    """One row of the mesh folder."""

    folder: Path
    name: str
    speaker: str
    split: str
    emotion: str = ""
    """Empty if not known."""

    def waveform(self) -> Float32:
        """The recording as it was stored [shape=(S,)]."""
        return load_audio(self.folder / "audio" / f"{self.name}.flac").waveform

    def motion(self) -> dict[str, Float32]:
        """The arrays of `MOTION` that the folder has, by name, each [shape=(T, ...)].

        Raises
        ------
        DataError
            If the file is missing or damaged, or its arrays do not belong together.
        """
        path = self.folder / "motion" / f"{self.name}.npz"
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: np.asarray(file[name], np.float32) for name in MOTION[:3]}
                if "lips" in file:
                    arrays["lips"] = np.asarray(file["lips"], np.float32)
        except (OSError, ValueError, KeyError, EOFError) as error:
            raise DataError(f"{path}: cannot be read ({error}); build the folder again") from None
        lengths = {len(rows) for rows in arrays.values()}
        if len(lengths) != 1 or min(lengths) < 2:
            raise DataError(
                f"{path}: holds arrays of {sorted(lengths)} frames; one length of at least 2 is "
                "needed; build the folder again"
            )
        return arrays


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
    bases : MeshBases
        What the coefficients belong to.
    lips : Lips or None
        Rims of the lips, where they are known.
    """

    fps: float
    unit_mm: float
    templates: dict[str, TriMesh]
    clips: tuple[MeshClip, ...]
    bases: MeshBases
    lips: Lips | None

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
    sequences: Sequence[MeshSequence],
    *,
    fps: float,
    unit_mm: float,
    lips: Lips | None = None,
    basis_frames: int = 400,
    basis_error_mm: float = 0.5,
    basis_variance: float | None = None,
    weigh_triangles: bool = True,
) -> None:
    """Fit bases to the training sequences and write the coefficients of all, or nothing.

    Parameters
    ----------
    out : Path
        Folder to make; its parent must exist.
    templates : mapping of str to TriMesh
        Expressionless mesh of every speaker.
    sequences : sequence of MeshSequence
        Loaded one at a time.
    fps : float
        Of all sequences.
    unit_mm : float
        Millimetres in the templates' unit.
    lips : Lips, optional
        Rims of the lips, the same vertices on every template.
    basis_frames, basis_error_mm, basis_variance, weigh_triangles
        As for `deitalk.research.meshes.mesh_bases.fit_mesh_bases`.

    Raises
    ------
    DataError
        If `out` is there already, templates differ in their triangles, or a sequence has no
        template, an unknown split, a doubled name or fewer than two frames; or there is none to
        train on.
    rig.errors.MeshError
        If a triangle has no area.
    """
    if out.exists():
        raise DataError(f"{out}: exists already; name another folder or remove it")
    _check_templates(templates)
    _check_sequences(sequences, templates, out)
    with output_folder(out, kind="meshes") as beside:
        for name in ("templates", "audio", "motion"):
            (beside / name).mkdir()
        for speaker, template in templates.items():
            write_ply(beside / "templates" / f"{speaker}.ply", template)
        drawn = {
            split: [(q.speaker, lambda q=q: _loaded(q)[1]) for q in sequences if q.split == split]
            for split in ("train", "validation")
        }
        bases = fit_mesh_bases(
            templates,
            drawn["train"],
            drawn["validation"] or drawn["train"],
            n_frames=basis_frames,
            error_mm=basis_error_mm,
            unit_mm=unit_mm,
            variance=basis_variance,
            weigh_triangles=weigh_triangles,
        )
        write_mesh_bases(beside, bases)
        if lips is not None:
            np.savez(beside / LIPS_FILE, upper=lips.upper, lower=lips.lower)
        for sequence in sequences:
            _write_clip(beside, sequence, templates[sequence.speaker], bases, lips)
        rows = [(q.name, q.speaker, q.split, q.emotion) for q in sequences]
        table = pd.DataFrame(rows, columns=["clip", "speaker", "split", "emotion"])
        table.to_csv(beside / "clips.csv", index=False)
        about = {"format_version": FORMAT_VERSION, "fps": fps, "unit_mm": unit_mm}
        (beside / "mesh.json").write_text(json.dumps(about) + "\n")


def _write_clip(
    folder: Path, sequence: MeshSequence, template: TriMesh, bases: MeshBases, lips: Lips | None
) -> None:
    import soundfile

    waveform, vertices = _loaded(sequence)
    offsets = vertices.astype(np.float64) - template.vertices
    s, r = _packed(template, vertices)
    arrays: dict[str, Any] = {
        "stretch": bases.stretch.project(s).astype(np.float16),
        "rotation": bases.rotation.project(r).astype(np.float16),
        "offsets": bases.offsets.project(offsets.reshape(len(offsets), -1)).astype(np.float16),
    }
    if lips is not None:
        arrays["lips"] = offsets[:, lips.both].astype(np.float32)
    np.savez(folder / "motion" / f"{sequence.name}.npz", **arrays)
    quiet = waveform / max(1.0, float(np.abs(waveform).max(initial=0)))
    soundfile.write(folder / "audio" / f"{sequence.name}.flac", quiet, SAMPLE_RATE)


def _packed(template: TriMesh, vertices: Float32) -> tuple[Float64, Float64]:
    """As `pack_vertices`; triangles that stay where they are, most of a head, cost nothing."""
    is_off = np.abs(vertices - template.vertices) > 1e-7 * template.size
    is_moved: Bool = np.asarray(is_off.any(axis=(0, 2)))
    moved = np.flatnonzero(is_moved[template.faces].any(axis=1))
    packed = []
    for rows in pack_vertices(TriMesh(template.vertices, template.faces[moved]), vertices):
        whole = np.zeros((len(rows), len(template.faces), rows.shape[1] // max(len(moved), 1)))
        whole[:, moved] = rows.reshape(len(rows), len(moved), -1)
        packed.append(whole.reshape(len(rows), -1))
    return packed[0], packed[1]


def _loaded(sequence: MeshSequence) -> tuple[Float32, Float32]:
    waveform, vertices = sequence.load()
    if len(vertices) < 2:
        raise DataError(f"clip {sequence.name!r}: {len(vertices)} frames; at least 2 are needed")
    return waveform, vertices


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


def _check_sequences(
    sequences: Sequence[MeshSequence], templates: Mapping[str, TriMesh], out: Path
) -> None:
    seen: set[str] = set()
    for sequence in sequences:
        name = sequence.name
        if not name or Path(name).name != name or name.startswith("."):
            raise DataError(f"clip {name!r}: the name must be usable as a file's")
        if name in seen:
            raise DataError(f"clip {name!r} appears twice; names must differ")
        if sequence.speaker not in templates:
            raise DataError(f"clip {name!r}: speaker {sequence.speaker!r} has no template; add one")
        if sequence.split not in SPLITS:
            raise DataError(
                f"clip {name!r}: split {sequence.split!r} is unknown; known are {', '.join(SPLITS)}"
            )
        seen.add(name)
    if not any(sequence.split == "train" for sequence in sequences):
        raise DataError(f"{out}: no sequences to train on; check the source's clips and splits")


def read_mesh_folder(folder: Path | str) -> MeshFolder:
    """Read what `write_mesh_folder` wrote; motion and recordings stay on the disk.

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
        emotions = list(table.get("emotion", [""] * len(rows)))
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
    clips = tuple(
        MeshClip(folder, *row, emotion) for row, emotion in zip(rows, emotions, strict=True)
    )
    return MeshFolder(fps, unit_mm, templates, clips, read_mesh_bases(folder), _read_lips(folder))


def _read_lips(folder: Path) -> Lips | None:
    path = folder / LIPS_FILE
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            return Lips(file["upper"].astype(np.int64), file["lower"].astype(np.int64))
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise DataError(f"{path}: cannot be read ({error}); build the folder again") from None
