"""Errors a user can cause, one line each: the value, the rule, the way out.

::

    ValueError
    └── RigError          anything about controls, curves, meshes
        ├── ControlError  an unknown, missing or doubled control
        ├── CurveError    values, shapes or times that make no curves
        ├── FormatError   a file that is not what its name says
        └── MeshError     vertices, triangles or shapes that make no mesh
            └── TopologyError  triangles that name wrong vertices, meshes that do not match
"""


class RigError(ValueError):
    """Something about a face that the caller can mend; the message says how."""


class ControlError(RigError):
    """A control name that is unknown, missing or doubled."""


class CurveError(RigError):
    """Values, shapes or times that do not make curves."""


class FormatError(RigError):
    """A file that is not what its name says."""


class MeshError(RigError):
    """Vertices, triangles or shapes that make no mesh."""


class TopologyError(MeshError):
    """Triangles that name wrong vertices, or meshes that do not share their triangles."""
