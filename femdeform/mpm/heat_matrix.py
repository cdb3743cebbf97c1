"""The symmetric matrix of a step of conduction on the grid, and its solution by conjugate gradients."""

from __future__ import annotations

import numpy as np

from femdeform.mpm import heat_kernels as kernels
from femdeform.mpm.grid import Stencils
from femdeform.mpm.heat_walls import HeldTemperatures
from femdeform.types import FloatArray, IntArray


def _places(dim: int) -> IntArray:
    """Place in a row of 5^dim offsets for each pair of the 3^dim nodes of a stencil."""
    shift = np.stack(np.meshgrid(*[np.arange(3)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    return np.asarray((shift[None, :] - shift[:, None] + 2) @ 5 ** np.arange(dim), dtype=np.int64)


class ConductionMatrix:
    """``C/dt delta_ij + sum_p conductance_p G_i . G_j + sum_p exchange_p N_i N_j``.

    Parameters
    ----------
    stencils : Stencils
        Quadratic, of the quadrature points.
    conductance, exchange : (n_points,) float64
        K V [W m/K], h |dA| [W/K].
    inertia : (n_nodes,) float64
        C/dt [W/K].

    Attributes
    ----------
    own : (n_nodes,) float64
        The diagonal; zero where neither mass nor exchange reaches.

    References
    ----------
    J. Chen, dissertation (2024), section 3.2.3.2, with the masses of points that are not split; conjugate gradients
    with the diagonal: Y. Saad, Iterative methods for sparse linear systems (2003), section 9.2.

    Limitations
    -----------
    Rows have 5^dim places whatever the points reach. Iterations grow with the square root of K dt/(rho c dx^2).
    """

    def __init__(self, stencils: Stencils, conductance: FloatArray, exchange: FloatArray, inertia: FloatArray) -> None:
        dim = stencils.positions.shape[1]
        width = 5**dim
        self._neighbours = np.empty((stencils.n_nodes, width), dtype=np.int32)
        self._values = np.empty((stencils.n_nodes, width))
        self._inertia = inertia
        kernels.conduction_rows(
            stencils.nodes,
            stencils.weights,
            stencils.gradients,
            stencils.offsets,
            stencils.entries,
            conductance,
            exchange,
            _places(dim),
            self._neighbours,
            self._values,
        )
        self.own = inertia + self._values[:, width // 2]
        # 1^T A 1: conduction drops out.
        self._whole = float(inertia.sum() + exchange.sum())

    def times(self, x: FloatArray, without_inertia: bool = False) -> FloatArray:
        """A x, or without C/dt."""
        out = np.empty_like(x)
        diagonal = np.zeros_like(self._inertia) if without_inertia else self._inertia
        kernels.rows_times(self._neighbours, self._values, diagonal, x, out)
        return out

    def solve(
        self,
        b: FloatArray,
        scale: float,
        tolerance: float,
        max_iterations: int,
        start: FloatArray | None = None,
        held: HeldTemperatures | None = None,
    ) -> tuple[FloatArray, int, float, bool]:
        """Solve A x = b by conjugate gradients with the diagonal as preconditioner.

        The solution is then shifted so that the residuals add up to nothing: that is the budget of heat. Where walls
        hold nodes, what residuals add up to is what enters through the walls.

        Parameters
        ----------
        b : (n_nodes,) float64
            Right-hand side, zero where the diagonal is.
        scale : float
            Size of the terms of b in the norm below: a residual of their rounding counts as solved.
        tolerance : float
            Norm of the residual over that of b; the norm is that of the diagonal's inverse.
        max_iterations : int
            Iterations at most.
        start : (n_nodes,) float64, optional
            x to begin with; default zero.
        held : HeldTemperatures, optional
            Nodes whose changes follow those of others: x - start is what `HeldTemperatures.spread` makes of free ones.

        Returns
        -------
        x, iterations, reduction, converged
        """
        inverse = np.divide(1.0, self.own, out=np.zeros_like(self.own), where=self.own > 0.0)
        x, r = np.zeros_like(b), b.copy()
        if start is not None:
            x = start.copy()
            r -= self.times(x)
        if held is not None:
            inverse[held.nodes] = 0.0
            r = held.collect(r)
        z = inverse * r
        p = z.copy()
        rz = float(np.einsum("i,i->", r, z))
        first, floor = np.sqrt(rz), 4.0 * np.finfo(float).eps * scale
        iteration = 0
        while np.sqrt(rz) > max(tolerance * first, floor) and iteration < max_iterations:
            # Of held nodes p is zero: they follow.
            Ap = self.times(p) if held is None else held.collect(self.times(held.spread(p)))
            curvature = float(np.einsum("i,i->", p, Ap))
            if not curvature > 0.0:
                break
            step = rz / curvature
            x += step * p
            r -= step * Ap
            z = inverse * r
            rz, previous = float(np.einsum("i,i->", r, z)), rz
            p = z + (rz / previous) * p
            iteration += 1
        reached = np.sqrt(rz)
        converged = bool(reached <= max(tolerance * first, floor))
        if held is not None:
            x = held.spread(x) if start is None else start + held.spread(x - start)
        elif converged and self._whole > 0.0:
            x += np.where(self.own > 0.0, float((b - self.times(x)).sum()) / self._whole, 0.0)
        return x, iteration, float(reached / first) if first > 0.0 else 0.0, converged
