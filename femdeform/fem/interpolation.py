"""Values of a finite element field at points given by their place in a cell."""

from __future__ import annotations

import numpy as np

from femdeform.fem.discretization import EDGES
from femdeform.types import FloatArray


def nodal_weights(barycentric: FloatArray, cell_type: str, n_nodes: int) -> FloatArray:
    """Shape functions of P1 or P2 simplices.

    Parameters
    ----------
    barycentric : (..., k) float64
        Barycentric coordinates of the points, one for each corner [-].
    cell_type : str
        ``line``, ``triangle`` or ``tetra``.
    n_nodes : int
        Nodes of a cell: k for P1; corners and mid-edge nodes, in VTK's order, for P2.

    Returns
    -------
    (..., n_nodes) float64
        Weight of each node of the cell [-].
    """
    if n_nodes == barycentric.shape[-1]:
        return barycentric
    pairs = np.array(EDGES[cell_type])
    middle = 4.0 * barycentric[..., pairs[:, 0]] * barycentric[..., pairs[:, 1]]
    return np.concatenate([barycentric * (2.0 * barycentric - 1.0), middle], axis=-1)
