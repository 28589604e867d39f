"""Where mesh sequences come from: VOCASET's folders, or our own head acting a dataset folder.

The layout of VOCASET (Cudeiro et al. 2019), as it unpacks; any other corpus may be laid out so::

    templates/<speaker>.ply                         expressionless, aligned
    unposedcleaneddata/<speaker>/<sentence>/*.ply   frames in the order of their names, 60 fps
    audio/<speaker>/<sentence>.wav
    splits.csv                                      speaker, split; ours, optional

Without ``splits.csv`` speakers are taken in the order of their names: two thirds to train, then a
sixth to validate, the rest to test (8 : 2 : 2 of VOCASET's twelve, as SDFA §4.1 has it).
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.data.clips import SPLITS, Clip, read_clips, spread_clips
from deitalk.errors import DataError
from deitalk.research.config import MeshDataConfig
from deitalk.research.meshes.folder import (
    LIPS_FILE,
    Lips,
    MeshFolder,
    MeshSequence,
    read_mesh_folder,
    write_mesh_folder,
)
from deitalk.research.meshes.frames import read_ply_sequence
from rig import default_controls, read_curves
from rig.arrays import Float32
from rig.face import build_head
from rig.face.head import UNIT_MM
from rig.face.identity import resolve_identity
from rig.mesh import TriMesh, read_ply

VOCASET_FRAMES = "unposedcleaneddata"
VOCASET_UNIT_MM = 1000.0
"""VOCASET is in metres."""


def open_meshes(data: Path, config: MeshDataConfig, built: Path) -> MeshFolder:
    """Mesh folder of any source, built first where there is none.

    Parameters
    ----------
    data : Path
        A mesh folder, a folder in VOCASET's layout, or a dataset folder (`deitalk.data.clips`).
    config : MeshDataConfig
        Frame rate, and for a dataset folder heads and number of clips.
    built : Path
        Where to build; taken as it is if a mesh folder is there.

    Raises
    ------
    DataError
        If `data` is none of the three, or its frame rate is not the configured one.
    """
    if (data / "mesh.json").is_file():
        folder = read_mesh_folder(data)
    elif built.exists():
        folder = read_mesh_folder(built)
    else:
        build_meshes(data, config, built)
        folder = read_mesh_folder(built)
    if folder.fps != config.fps:
        raise DataError(
            f"{data}: {folder.fps:g} frames per second, data.fps is {config.fps:g}; "
            f"set data.fps={folder.fps:g}"
        )
    return folder


def has_lips(data: Path, built: Path) -> bool:
    """Whether `open_meshes` will find lips: those of embedded heads, before they are built.

    What is neither kind of folder is left for `open_meshes` to refuse.
    """
    for folder in (data, built):
        if (folder / "mesh.json").is_file():
            return (folder / LIPS_FILE).is_file()
    return not (data / VOCASET_FRAMES).is_dir()


def build_meshes(data: Path, config: MeshDataConfig, out: Path) -> None:
    """Write the mesh folder of a folder in VOCASET's layout or of a dataset folder."""
    out.parent.mkdir(parents=True, exist_ok=True)
    lips = None
    if (data / VOCASET_FRAMES).is_dir():
        templates = vocaset_templates(data)
        sequences, unit = vocaset_sequences(data, templates), VOCASET_UNIT_MM
    elif (data / "clips.csv").is_file():
        templates = head_templates(config.identities)
        sequences, unit, lips = head_sequences(data, config), UNIT_MM, head_lips()
    else:
        raise DataError(
            f"{data}: holds neither mesh.json, {VOCASET_FRAMES}/ nor clips.csv; "
            "name a mesh folder, a folder laid out as VOCASET, or a dataset folder"
        )
    write_mesh_folder(
        out,
        templates,
        sequences,
        fps=config.fps,
        unit_mm=unit,
        lips=lips,
        basis_frames=config.basis_frames,
        basis_error_mm=config.basis_error_mm,
        basis_variance=config.basis_variance,
        weigh_triangles=config.weigh_triangles,
    )


def vocaset_templates(folder: Path) -> dict[str, TriMesh]:
    """Templates by speaker.

    Raises
    ------
    DataError
        If there is none.
    """
    found = {path.stem: read_ply(path) for path in sorted((folder / "templates").glob("*.ply"))}
    if not found:
        raise DataError(f"{folder}/templates: holds no .ply; it needs one a speaker")
    return found


def vocaset_sequences(folder: Path, templates: dict[str, TriMesh]) -> list[MeshSequence]:
    """Every sentence with its recording.

    Raises
    ------
    DataError
        If a speaker has no template, a sentence no recording, or ``splits.csv`` is wrong.
    """
    speakers = sorted(p.name for p in (folder / VOCASET_FRAMES).iterdir() if p.is_dir())
    splits = _splits(folder, speakers)
    sequences = []
    for speaker in speakers:
        if speaker not in templates:
            raise DataError(f"{folder}/templates: lacks {speaker}.ply; add it")
        for frames in sorted((folder / VOCASET_FRAMES / speaker).iterdir()):
            if not frames.is_dir():
                continue
            audio = folder / "audio" / speaker / f"{frames.name}.wav"
            if not audio.is_file():
                raise DataError(f"{audio}: missing; every sentence needs its recording")
            load = partial(_scanned, frames, audio, templates[speaker])
            sequences.append(
                MeshSequence(f"{speaker}.{frames.name}", speaker, splits[speaker], load)
            )
    return sequences


def _scanned(frames: Path, audio: Path, template: TriMesh) -> tuple[Float32, Float32]:
    """Recording and vertices of one sentence."""
    mesh, vertices = read_ply_sequence(frames)
    if not np.array_equal(mesh.faces, template.faces):
        raise DataError(f"{frames}: other triangles than the speaker's template")
    return load_audio(audio).waveform, vertices


def _splits(folder: Path, speakers: list[str]) -> dict[str, str]:
    path = folder / "splits.csv"
    if not path.is_file():
        train, validation = -(-len(speakers) * 2 // 3), -(-len(speakers) // 6)
        names = ["train"] * train + ["validation"] * validation + ["test"] * len(speakers)
        return dict(zip(speakers, names, strict=False))
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
        given = dict(zip(table["speaker"], table["split"], strict=True))
    except (OSError, ValueError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise DataError(f"{path}: needs the columns speaker, split ({reason})") from None
    for speaker in speakers:
        if given.get(speaker) not in SPLITS:
            raise DataError(
                f"{path}: split {given.get(speaker)!r} of {speaker!r} is not one of "
                f"{', '.join(SPLITS)}; mend the row"
            )
    return given


def head_templates(identities: tuple[int, ...]) -> dict[str, TriMesh]:
    """Cage of the skin of the embedded heads, neutral, by the identities' names."""
    heads = [build_head(identity) for identity in identities]
    return {h.identity.name: TriMesh(h.cage.vertices, h.cage.faces) for h in heads}


def head_lips() -> Lips:
    """Rims of the embedded heads' lips; every identity has the same vertices there."""
    return Lips(*build_head(0).lip_rims)


def head_sequences(data: Path, config: MeshDataConfig) -> list[MeshSequence]:
    """Curves of a dataset folder acted by the embedded heads' skins.

    Clip k of a split is acted by identity k modulo their number, so that all act as much. SDFA has
    no input for emotions, so `config.emotions` had best name one; the mesh head takes all.
    """
    sequences = []
    for split, most in (("train", config.clips), ("validation", config.validation_clips)):
        for i, clip in enumerate(acted_clips(data, split, config.emotions, most)):
            identity = config.identities[i % len(config.identities)]
            sequences.append(
                MeshSequence(
                    clip.name.replace("/", "_"),
                    resolve_identity(identity).name,
                    split,
                    partial(act, clip, identity, config.fps),
                    clip.emotion,
                )
            )
    return sequences


def acted_clips(
    data: Path, split: str, emotions: Sequence[str] | None, most: int | None
) -> list[Clip]:
    """Clips of a dataset folder's split with one of the emotions, at most so many, spread."""
    clips = [c for c in read_clips(data, split) if emotions is None or c.emotion in emotions]
    return spread_clips(clips, most)


def act(clip: Clip, identity: int | str, fps: float) -> tuple[Float32, Float32]:
    """Recording (S,) of a clip and the skin (T, V, 3) of an embedded head that acts its curves.

    Raises
    ------
    DataError
        If the curves lack controls.
    """
    controls, head = default_controls(), build_head(identity)
    curves = read_curves(clip.curves)
    missing = sorted(set(controls.names) - set(curves.names))
    if missing:
        raise DataError(
            f"{clip.curves}: lacks {len(missing)} controls of {controls.id}, such as {missing[0]}; "
            "convert the curves first"
        )
    waveform = load_audio(clip.audio).waveform
    values = curves.select(controls.names).resample(fps).values
    n_frames = max(int(np.ceil(len(waveform) / SAMPLE_RATE * fps)), 2)
    # Curves may start after the recording; before and after them their ends hold.
    place = np.arange(n_frames) - round(clip.offset_seconds * fps)
    held = values[np.clip(place, 0, len(values) - 1)]
    return waveform, head.pose(held)[:, head.slices["cage"]]
