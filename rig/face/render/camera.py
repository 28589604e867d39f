"""Cameras: position, target and projection."""

from dataclasses import dataclass

import numpy as np

from rig.arrays import Float64
from rig.face.geometry.mesh import unit

NEAR, FAR = 15.0, 140.0


@dataclass(frozen=True)
class View:
    """A camera at `position` looking at `target` (cm) with a vertical field of view."""

    target: tuple[float, float, float]
    position: tuple[float, float, float]
    degrees: float

    def matrix(self, aspect: float) -> Float64:
        """World to clip space, (4, 4), for column vectors; `aspect` is width / height."""
        eye, target = np.array(self.position), np.array(self.target)
        back = unit(eye - target)
        right = unit(np.cross([0.0, 1.0, 0.0], back))
        look = np.eye(4)
        look[:3, :3] = [right, np.cross(back, right), back]
        look[:3, 3] = -look[:3, :3] @ eye
        f = 1 / np.tan(np.radians(self.degrees) / 2)
        lens = np.array(
            [
                [f / aspect, 0, 0, 0],
                [0, f, 0, 0],
                [0, 0, (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)],
                [0, 0, -1, 0],
            ]
        )
        return np.asarray(lens @ look)


VIEWS = {
    "front": View((0, -3.4, 1), (0, -2.4, 66), 30),
    "three_quarter": View((0, -3.2, 1), (38, 0.9, 52), 29),
    "side": View((0, -3.2, -0.5), (66, -2.6, 2), 29),
    "face": View((0, -2.5, 3), (0, -1.9, 62), 25.5),
    "mouth": View((0, -8.1, 8), (0, -7.2, 46), 15),
    "mouth_side": View((0, -8.1, 7.5), (30, -6.3, 36), 15.5),
    "eyes": View((0, 0.6, 6), (0, 1.0, 46), 17),
    "neck": View((0, -9.5, 2), (0, -9.0, 52), 18),
    "ear": View((7, -1, -1), (42, 0, 24), 16),
}
"""Named cameras; +x (the character's left) is on the right of the picture."""
