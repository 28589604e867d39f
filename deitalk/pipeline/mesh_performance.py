"""Result of `deitalk.animate_mesh`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from deitalk.audio.load import Recording
from rig.arrays import Float32, Float64
from rig.files import check_folder

if TYPE_CHECKING:
    from rig.mesh import TriMesh


GLB_TOLERANCE_MM = 0.02
"""Furthest a vertex of a GLB may be from where the model put it."""


@dataclass(frozen=True, eq=False, repr=False)
class MeshPerformance:
    """A mesh that speaks a recording.

    Parameters
    ----------
    mesh : TriMesh
        The face at rest.
    vertices : array [shape=(T, V, 3)]
        In the mesh's unit; frame i is at i / fps seconds.
    fps : float
        Frames per second.
    unit_mm : float
        Millimetres in the mesh's unit.
    recording : Recording
        Its speech.
    landmarks : mapping of str to int or None
        Named vertices, where they are known: the embedded heads.
    colours : array [shape=(V, 3), range 0 to 1] or None
        Linear vertex colours, where there are any.
    """

    mesh: "TriMesh"
    vertices: Float32
    fps: float
    unit_mm: float
    recording: Recording
    landmarks: Mapping[str, int] | None = None
    colours: Float64 | None = None

    def save(self, target: str | Path, *, force: bool = False) -> Path:
        """Write the sequence: ``.glb``, ``.npz`` (vertices), or a folder of PLY files.

        Parameters, result and errors are those of `Performance.save`. A GLB's vertices are within
        0.02 mm of the model's.
        """
        from rig.files import check_file
        from rig.mesh.sequence import check_out, write_sequence

        inputs = (self.recording.source,)
        if check_out(target) == "folder":
            check_folder(target, kind="frames", force=force, inputs=inputs)
        else:
            check_file(target, force=force, inputs=inputs)
        write_sequence(
            target,
            self.mesh,
            self.vertices,
            fps=self.fps,
            tolerance=GLB_TOLERANCE_MM / self.unit_mm,
            unit_metres=self.unit_mm / 1000,
            colours=self.colours,
        )
        return Path(target)

    def __repr__(self) -> str:
        frames, vertices, _ = self.vertices.shape
        return (
            f"<MeshPerformance of {self.recording.source!r}: {frames} frames at {self.fps:g} fps, "
            f"{frames / self.fps:.2f} s, {vertices} vertices>"
        )
