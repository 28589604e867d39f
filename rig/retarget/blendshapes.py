"""Curves to a user's blendshapes and bones: by name, then bounded least squares.

Every shape is taken as a pose of the 251 raw MetaHuman curves. Names of `rig.conversion.avatars`,
ARKit, Live Link Face, ICT-FaceKit, MetaHuman's raw curves and its board are known in the spellings
of exporters; other names come with a mapping file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import KDTree

from rig.arrays import Float64
from rig.controls import default_controls
from rig.conversion.arkit import arkit_controls
from rig.conversion.avatars import ShapeFit, ShapePoses, poses_of
from rig.conversion.convert import convert
from rig.conversion.raw import RAW_ID, raw_controls
from rig.curves import RigCurves
from rig.errors import ControlError, MeshError
from rig.mesh.shapes import ShapeSet
from rig.retarget.bake import Driver
from rig.retarget.correctives import (
    arkit_halves,
    driver_poses,
    driver_weights,
    half_weight,
    own_drivers,
)
from rig.retarget.landmarks import nearest


@dataclass(frozen=True, eq=False)
class FacePoses(ShapePoses):
    """Shapes of a mesh, some of them correctives of our own exports.

    Parameters
    ----------
    drivers : mapping of int to Driver
        Shapes of our own export, which are driven and not fitted.
    """

    drivers: Mapping[int, Driver] = field(default_factory=dict)

    @property
    def driven(self) -> set[str]:
        """Names of shapes that are driven and not fitted."""
        return {self.names[i] for i in (*self.drivers, *arkit_halves(self.names))}

    @property
    def understood(self) -> tuple[str, ...]:
        """Names with a known meaning."""
        known = self.driven.union(super().understood)
        return tuple(name for name in self.names if name in known)

    def mapping(self) -> dict[str, dict[str, float]]:
        """Return the raw curves of each shape by name, but for those that are driven."""
        return {name: pose for name, pose in super().mapping().items() if name not in self.driven}

    def weights(self, curves: RigCurves, *, linear: bool = False) -> ShapeFit:
        """Weights of every frame of board, raw, ARKit or avatar curves; see `ShapePoses.fit`."""
        given = driver_weights(self.drivers, curves) if self.drivers else None
        fit = self.fit(convert(curves, RAW_ID), given, linear=linear)
        weights = fit.weights.copy()
        for half, driving in arkit_halves(self.names).items():
            weights[:, half] = half_weight([weights[:, k] for k in driving])
        return replace(fit, weights=weights)


def match_shapes(
    names: Sequence[str],
    *,
    mapping: Mapping[str, Mapping[str, float]] | None = None,
    shapes: ShapeSet | None = None,
) -> FacePoses:
    """Interpret the names of a blendshape set.

    Parameters
    ----------
    names : sequence of str
        Shape names as exported; prefixes up to the last ``.``, ``:`` or ``|`` do not count,
        ``_L``, ``Left`` and ``left`` are the same.
    mapping : mapping of str to mapping of str to float, optional
        Own shapes: the controls (board, raw or ARKit names) each stands for, and their values.
        Comes before the known names.
    shapes : ShapeSet, optional
        The geometry, from which the weight of `mouthClose` that just closes the lips is measured.

    Raises
    ------
    MeshError
        If no name is known, or the mapping names a shape that the set has not.
    ControlError
        If the mapping names an unknown control.
    """
    own = dict(mapping or {})
    missing = [name for name in own if name not in names]
    if missing:
        raise MeshError(f"the mapping names shape {missing[0]!r}, which the mesh does not have")
    drivers = own_drivers(["" if name in own else name for name in names])
    poses, visemes = poses_of(names)
    for i, name in enumerate(names):
        if name in own:
            poses[i], visemes[i] = _own_pose(own[name]), False
    for i, pose in enumerate(driver_poses(drivers, len(names))):
        poses[i] = pose if i in drivers else poses[i]
    found = FacePoses(tuple(names), poses, visemes, drivers=drivers)
    if not found.understood:
        raise MeshError(
            f"none of the shapes ({', '.join(names[:6])} ...) has a known name; "
            "give a mapping file with rows shape,control,value"
        )
    if shapes is None or found.closing is None:
        return found
    close, jaw = (names[i] for i in found.closing)
    return replace(found, close_gain=closing_weight(shapes, jaw, close))


def closing_weight(shapes: ShapeSet, jaw_open: str, mouth_close: str) -> float:
    """Weight of the closing corrective at which the lips meet as in the neutral face.

    Pairs across the slit are vertices close together that the jaw parts and the corrective
    brings together; the weight is the median over the pairs. (ICT's corrective at 1 overlaps
    the lips by 5 mm.) 1 if there are no such pairs.
    """
    jaw, close = shapes.delta(jaw_open), shapes.delta(mouth_close)
    rest, size = shapes.neutral.vertices, shapes.neutral.size
    motion = np.linalg.norm(jaw, axis=1)
    moved = np.flatnonzero(motion > 0.5 * motion.max())
    still = np.flatnonzero(motion < 0.3 * motion.max())
    if motion.max() == 0 or len(moved) == 0 or len(still) == 0:
        return 1.0
    distance, index = nearest(KDTree(rest[still]), rest[moved])
    near = distance < 0.02 * size
    low, high = moved[near], still[index[near]]
    torn, closed = jaw[low] - jaw[high], close[low] - close[high]
    strength = np.einsum("pc,pc->p", torn, torn)
    back = -np.einsum("pc,pc->p", closed, torn)
    useful = back > 0.3 * strength
    if useful.sum() < 4:
        return 1.0
    return float(np.clip(np.median(strength[useful] / back[useful]), 0.0, 1.0))


def _own_pose(controls: Mapping[str, float]) -> Float64:
    """Raw change for controls given by board, raw or ARKit names."""
    change = np.zeros(len(raw_controls()))
    known = default_controls(), raw_controls(), arkit_controls()
    for name, value in controls.items():
        owner = next((controls for controls in known if name in controls), None)
        if owner is None:
            raise ControlError(
                f"the mapping names control {name!r}, which is no board channel, raw curve or "
                "ARKit shape"
            )
        values = owner.rest.copy()[None]
        values[0, owner.index(name)] += value
        raw = convert(RigCurves(values, owner.names, control_set=owner.id), RAW_ID)
        change += raw.reorder(raw_controls()).values[0] - raw_controls().rest
    return change
