"""Displacements given at a few vertices, spread over the skin as a thin plate would."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from rig.arrays import Bool, Float64
from rig.face.geometry.mesh import adjacency
from rig.face.geometry.skin import Skin


class ThinPlate:
    """Solves the biharmonic equation on the skin.

    It follows the surface and so separates the lips, unlike a distance in space.

    Factorisations are kept, one for each set of fixed vertices.
    """

    def __init__(self, skin: Skin) -> None:
        n = len(skin.vertices)
        graph = adjacency(skin.faces, n).tocoo()
        length = np.linalg.norm(skin.vertices[graph.row] - skin.vertices[graph.col], axis=1)
        weight = sp.coo_matrix((1 / np.maximum(length, 0.05), (graph.row, graph.col)), (n, n))
        laplacian = sp.diags(np.asarray(weight.sum(1)).ravel()) - weight.tocsr()
        self._matrix = (laplacian.T @ laplacian + 1e-9 * sp.eye(n)).tocsc()
        self._factors: dict[bytes, tuple[SuperLU, sp.csc_matrix]] = {}

    def spread(self, fixed: Bool, values: Float64) -> Float64:
        """Keep `values` (V, k) where `fixed` (V,), and fill the rest in smoothly."""
        free = ~fixed
        key = np.packbits(fixed).tobytes()
        if key not in self._factors:
            rows = self._matrix[free]
            self._factors[key] = (splu(rows[:, free].tocsc()), rows[:, fixed])
        factor, coupling = self._factors[key]
        filled = values.astype(float).copy()
        filled[free] = factor.solve(-(coupling @ values[fixed]))
        return filled
