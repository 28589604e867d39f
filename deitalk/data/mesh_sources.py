"""Where mesh sequences come from: VOCASET's folders, or our own head acting a dataset folder.

The layout of VOCASET (Cudeiro et al. 2019), as it unpacks; any other corpus may be laid out so::

    templates/<speaker>.ply                              expressionless, aligned
    unposedcleaneddata/<speaker>/<sentence>/*.ply        frames in the order of their names, 60 fps
    audio/<speaker>/<sentence>.wav
    splits.csv                                           speaker, split; ours, optional

Without ``splits.csv`` speakers are taken in the order of their names: two thirds to train, then a
sixth to validate, the rest to test (8 : 2 : 2 of VOCASET's twelve, as SDFA §4.1 has it).
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from deitalk.audio import SAMPLE_RATE, load_audio
from deitalk.config import MeshDataConfig
from deitalk.data.folder import SPLITS, Clip, read_clips
from deitalk.data.mesh_folder import (
    MeshFolder,
    MeshSequence,
    read_mesh_folder,
    write_mesh_folder,
)
from deitalk.errors import DataError
from rig import default_controls, read_curves
from rig.face import build_head
from rig.mesh import TriMesh, read_ply, read_ply_sequence

VOCASET_FRAMES = "unposedcleaneddata"
VOCASET_UNIT_MM = 1000.0
"""VOCASET is in metres."""
HEAD_UNIT_MM = 10.0
"""The embedded head is in centimetres."""


def open_meshes(data: Path, config: MeshDataConfig, built: Path) -> MeshFolder:
    """Mesh folder of any source, built first where there is none.

    Parameters
    ----------
    data : Path
        A mesh folder, a folder in VOCASET's layout, or a dataset folder (`deitalk.data.folder`).
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


def build_meshes(data: Path, config: MeshDataConfig, out: Path) -> None:
    """Write the mesh folder of a folder in VOCASET's layout or of a dataset folder."""
    out.parent.mkdir(parents=True, exist_ok=True)
    if (data / VOCASET_FRAMES).is_dir():
        templates = vocaset_templates(data)
        sequences, unit = vocaset_sequences(data, templates), VOCASET_UNIT_MM
    elif (data / "clips.csv").is_file():
        templates = head_templates(config.identities)
        sequences, unit = head_sequences(data, config), HEAD_UNIT_MM
    else:
        raise DataError(
            f"{data}: holds neither mesh.json, {VOCASET_FRAMES}/ nor clips.csv; "
            "name a mesh folder, a folder laid out as VOCASET, or a dataset folder"
        )
    write_mesh_folder(out, templates, sequences, fps=config.fps, unit_mm=unit)


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


def vocaset_sequences(folder: Path, templates: dict[str, TriMesh]) -> Iterator[MeshSequence]:
    """Every sentence with its recording, one at a time.

    Raises
    ------
    DataError
        If a speaker has no template, a sentence no recording, or ``splits.csv`` is wrong.
    """
    speakers = sorted(p.name for p in (folder / VOCASET_FRAMES).iterdir() if p.is_dir())
    splits = _splits(folder, speakers)
    for speaker in speakers:
        if speaker not in templates:
            raise DataError(f"{folder}/templates: lacks {speaker}.ply; add it")
        for frames in sorted((folder / VOCASET_FRAMES / speaker).iterdir()):
            if not frames.is_dir():
                continue
            audio = folder / "audio" / speaker / f"{frames.name}.wav"
            if not audio.is_file():
                raise DataError(f"{audio}: missing; every sentence needs its recording")
            mesh, vertices = read_ply_sequence(frames)
            if not np.array_equal(mesh.faces, templates[speaker].faces):
                raise DataError(f"{frames}: other triangles than templates/{speaker}.ply")
            waveform = load_audio(audio).waveform
            name = f"{speaker}.{frames.name}"
            yield MeshSequence(name, speaker, splits[speaker], waveform, vertices)


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
    """Skin of the embedded heads, neutral, by the identities' names."""
    heads = [build_head(identity) for identity in identities]
    return {h.identity.name: TriMesh(h.skin.vertices, h.skin.faces) for h in heads}


def head_sequences(data: Path, config: MeshDataConfig) -> Iterator[MeshSequence]:
    """Curves of a dataset folder acted by the embedded heads' skins, one clip at a time.

    Clip k of a split is acted by identity k, then round again: every head speaks as much. All of a
    clip is kept, so emotions too move the mesh; SDFA has no input for them, so a dataset of one
    emotion (neutral) suits it best.
    """
    for split in SPLITS:
        for i, clip in enumerate(read_clips(data, split)[: config.clips]):
            yield _acted(clip, config.identities[i % len(config.identities)], config.fps)


def _acted(clip: Clip, identity: int, fps: float) -> MeshSequence:
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
    vertices = head.pose(held)[:, head.slices["skin"]]
    name = clip.name.replace("/", "_")
    return MeshSequence(name, head.identity.name, clip.split, waveform, vertices)
