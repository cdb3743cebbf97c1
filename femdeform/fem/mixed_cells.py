"""The cells of an element group as the mixed method sees them: twist values, switched Hessians, rows, compliances."""

from __future__ import annotations

import numpy as np

from femdeform.fem import mixed_codimensional, mixed_kernels
from femdeform.fem.discretization import ElementGroup
from femdeform.types import FloatArray


class MixedCells:
    """Elastic cells with the principal stretches as unknowns of their own.

    Parameters
    ----------
    group : ElementGroup
    floor : float
        Smallest stiffness of a mode of the stretch over mu [-].

    Attributes
    ----------
    twists : (n_cells, n_q, n) float64
        Values of the modes that turn a cell, for `hessian` [Pa].
    n_modes : int
        Symmetric modes a point: 6, 3 in 2D and in membranes, 1 in rods.
    """

    def __init__(self, group: ElementGroup, floor: float) -> None:
        self.group = group
        self.floor = floor
        is_plane = group.kind == "solid" and group.gradients.shape[3] == 2
        self.twists = np.zeros((*group.weights.shape, 1 if is_plane else 3))
        self._stress = np.zeros((*group.weights.shape, group.gradients.shape[3] ** 2))
        self._dim = (0,) * group.gradients.shape[3]
        self._nodes = (0,) * group.cells.shape[1]
        self._kernels = mixed_kernels if group.kind == "solid" else mixed_codimensional
        d = group.gradients.shape[3] if group.kind == "solid" else group.cells.shape[1] - 1
        self.n_modes = d * (d + 1) // 2

    def predict(self, x: FloatArray, step: FloatArray) -> None:
        """Keep the stress that the model linear at `x` has at x + step: the multipliers of a mixed step."""
        g = self.group
        self._kernels.cell_stresses(
            x, step, g.cells, g.gradients, g.weights, g.law, self.floor, self._dim, self._nodes, self._stress
        )

    def set_twists(self, x: FloatArray, predicted: bool) -> None:
        """Set `twists` at `x` from the predicted stresses, or from the law's own."""
        g = self.group
        self._kernels.cell_twists(
            x, g.cells, g.gradients, g.weights, g.law, self._stress, predicted, self._dim, self._nodes, self.twists
        )

    def hessian(self, x: FloatArray, exact: bool, split: bool, blocks: FloatArray, first: int) -> None:
        """Write the cells' blocks [N/m]; see `mixed_kernels.cell_hessians`."""
        g = self.group
        self._kernels.cell_hessians(
            x,
            g.cells,
            g.gradients,
            g.weights,
            g.law,
            self.twists,
            self.floor,
            exact,
            split,
            self._dim,
            self._nodes,
            blocks,
            first,
        )

    def rows(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (B, C) of `mixed_kernels.cell_rows`."""
        g = self.group
        n_q, k = g.weights.shape[1], len(self._nodes) * len(self._dim)
        B = np.empty((g.n_cells, n_q, self.n_modes, k))
        C = np.empty((g.n_cells, n_q, self.n_modes, self.n_modes))
        self._kernels.cell_rows(x, g.cells, g.gradients, g.weights, g.law, self.floor, self._dim, self._nodes, B, C)
        return B, C
