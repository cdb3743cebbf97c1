"""The matrix of a step of the heat equation, for solvers that are made for pressures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.pressure_system import AIR, FLUID, GridArray, PressureSystem


class HeatSystem(PressureSystem):
    """(I + k L) T = T_0 of a backward Euler step, divided by k: T is given in the layer of air around the grid.

    L is the matrix of the pressure, k = diffusivity dt/h^2 the diffusion number of the step [-]. The matrix is definite
    and its condition number about 1 + 4 dim k, up to that of the grid.

    Parameters
    ----------
    cells : int
        Voxels along an edge, one layer of given temperatures on each side included.
    dim : int
    number : float
        k.
    """

    def __init__(self, cells: int, dim: int, number: float) -> None:
        labels: NDArray[np.uint8] = np.full((cells,) * dim, AIR, dtype=np.uint8)
        labels[(slice(1, -1),) * dim] = FLUID
        super().__init__(labels, 1.0 / number)

    def hot_ball(self, number: float) -> GridArray:
        """Right-hand side of a ball at temperature 1 that loses its heat to walls at 0."""
        places = np.moveaxis(np.indices(self.padded_shape) - 0.5, 0, -1)[..., : self.dim] / self.shape[0]
        middle = np.array((0.5, 0.3, 0.45)[: self.dim])
        inside = ((places - middle) ** 2).sum(axis=-1) < 0.2**2
        return np.where(self.unknown & inside, 1.0 / number, 0.0)
