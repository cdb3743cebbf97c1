"""What the alternating scheme keeps at the quadrature points of one element group."""

from __future__ import annotations

import numpy as np

from femdeform.fem.discretization import ElementGroup
from femdeform.scene.mixed_schema import MixedFEMSolver
from femdeform.types import FloatArray
from solvers.mixed import local_kernels

# Stress over mu below which a multiplier is rounding.
_ROUNDING = 1e-9


class LocalState:
    """Stretches, rotations and multipliers of one group, and the model of psi at the stretch of the outer iteration.

    Parameters
    ----------
    group : ElementGroup
    options : MixedFEMSolver

    Attributes
    ----------
    S, R, L : (n_cells, n_q, d*d) float64
        Stretch, rotation and multiplier [-], [-], [Pa], row-major.
    """

    def __init__(self, group: ElementGroup, options: MixedFEMSolver) -> None:
        self.group = group
        self.options = options
        d = group.gradients.shape[3]
        self.d = d
        points = group.weights.shape
        self.S = np.zeros((*points, d * d))
        self.R = np.zeros_like(self.S)
        self.L = np.zeros_like(self.S)
        self.frozen = np.zeros_like(self.S)
        self._sides = np.zeros_like(self.S)
        self._frames = np.zeros_like(self.S)
        self._inverse = np.zeros((*points, d * (d + 1) // 2))
        self._flips = np.zeros((*points, d * (d - 1) // 2))
        self._psi = np.zeros((*points, d))
        self._dim = (0,) * d
        self._nodes = (0,) * group.cells.shape[1]
        self._rank = d if group.kind == "solid" else group.cells.shape[1] - 1
        self._across = _projectors(group)
        self._counts = np.zeros(group.n_cells, dtype=np.int64)
        self.eps = self._regularisation()
        self._rows: FloatArray | None = None

    def _regularisation(self) -> FloatArray:
        """Epsilon on densities at every point [1/Pa]."""
        weights, choice = self.group.weights, self.options.tikhonov
        if choice is None:
            return np.zeros_like(weights)
        if choice.per == "density":
            return np.full_like(weights, choice.value)
        # On multipliers that are stress times volume, epsilon [1/(Pa m^3)] is epsilon times volume on densities.
        if choice.per == "volume":
            return np.asarray(choice.value * weights)
        return np.full_like(weights, choice.value / (2.0 * self.group.law.mu))

    @property
    def is_symmetric(self) -> bool:
        """Whether the multipliers are those of the symmetric stress alone."""
        return self.options.tikhonov is None

    def begin(self, S: FloatArray | None, x: FloatArray) -> None:
        """Start a step: the stretch of the last one, or that of positions; multipliers at zero."""
        g = self.group
        if S is None:
            local_kernels.stretches_at(
                x, g.cells, g.gradients, g.weights, self._across, self._rank, self._dim, self._nodes, self.S
            )
        else:
            self.S[:] = S
        self.L[:] = 0.0

    def freeze(self) -> None:
        """Make the quadratic model of psi at the present stretch, for an outer iteration."""
        self.frozen[:] = self.S
        local_kernels.freeze(
            self.S,
            self.group.law,
            self.options.floor,
            self._dim,
            self._frames,
            self._inverse,
            self._flips,
            self._psi,
        )

    def rotate(self, x: FloatArray, alpha: float) -> None:
        """Fit the rotations to positions, stretches and multipliers."""
        g = self.group
        local_kernels.rotate(
            x,
            g.cells,
            g.gradients,
            g.weights,
            self.S,
            self.L,
            alpha,
            _ROUNDING * self.group.law.mu,
            self._across,
            self._rank,
            self._dim,
            self._nodes,
            self.R,
        )

    def set_sides(self, x: FloatArray) -> None:
        """Right-hand side of the constraint row at positions x."""
        g = self.group
        proximal = self.options.tikhonov is not None and self.options.tikhonov.proximal
        local_kernels.constraint_sides(
            x,
            g.cells,
            g.gradients,
            g.weights,
            self.frozen,
            self.R,
            self._frames,
            self._inverse,
            self._flips,
            self._psi,
            self._across,
            self.eps,
            self.L,
            proximal,
            self._dim,
            self._nodes,
            self._sides,
        )

    def condensed(self, blocks: FloatArray, first_block: int, slots: FloatArray, first_slot: int) -> None:
        """Write the cells' blocks and forces of the system with the multipliers eliminated."""
        g = self.group
        local_kernels.condensed_blocks(
            g.cells,
            g.gradients,
            g.weights,
            self.R,
            self._frames,
            self._inverse,
            self._flips,
            self.eps,
            self._sides,
            self._dim,
            self._nodes,
            blocks,
            first_block,
            slots,
            first_slot,
        )

    def take_condensed(self, step: FloatArray) -> None:
        """Multipliers that belong to a solution of the condensed system."""
        g = self.group
        local_kernels.condensed_multipliers(
            step,
            g.cells,
            g.gradients,
            g.weights,
            self.R,
            self._frames,
            self._inverse,
            self._flips,
            self.eps,
            self._sides,
            self._dim,
            self._nodes,
            self.L,
        )

    def saddle(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rows B, compliances C and right-hand side b of the saddle system."""
        g, d = self.group, self.d
        n, n_q = g.weights.shape
        k = len(self._nodes) * d
        if self.is_symmetric:
            m = d * (d + 1) // 2
            B, C, b = np.empty((n, n_q, m, k)), np.empty((n, n_q, m, m)), np.empty((n, n_q, m))
            local_kernels.symmetric_rows(
                g.cells,
                g.gradients,
                g.weights,
                self.R,
                self._frames,
                self._inverse,
                self._flips,
                self._sides,
                self._dim,
                self._nodes,
                B,
                C,
                b,
            )
            return B, C, b
        C = np.empty((n, n_q, d * d, d * d))
        local_kernels.full_compliances(
            g.weights, self.R, self._frames, self._inverse, self._flips, self.eps, self._dim, C
        )
        return self._constant_rows(), C, g.weights[..., None] * self._sides

    def constant_compliances(self) -> FloatArray:
        """V / (2 mu) I: the compliances of the preconditioner that never changes."""
        m = self.d * self.d
        scale = self.group.weights / (2.0 * self.group.law.mu)
        return np.asarray(scale[..., None, None] * np.eye(m))

    def _constant_rows(self) -> FloatArray:
        """V J of nine multipliers a point: component (a, b) of F from component a of a node."""
        if self._rows is None:
            g, d = self.group, self.d
            n, n_q = g.weights.shape
            rows = np.zeros((n, n_q, d, d, len(self._nodes), d))
            for a in range(d):
                rows[:, :, a, :, :, a] = np.swapaxes(g.gradients, 2, 3) * g.weights[..., None, None]
            self._rows = rows.reshape(n, n_q, d * d, -1)
        return self._rows

    def take_multipliers(self, y: FloatArray) -> None:
        """Multipliers that the saddle system gave."""
        if self.is_symmetric:
            local_kernels.symmetric_multipliers(y, self.R, self._frames, self._dim, self.L)
        else:
            self.L[:] = y

    def update_stretch(self) -> None:
        """S = S^k + H^-1 (sym(R^T L) - g)."""
        local_kernels.update_stretches(
            self.frozen,
            self.R,
            self.L,
            self._frames,
            self._inverse,
            self._flips,
            self._psi,
            self._dim,
            self.S,
        )

    def n_undefined(self, S: FloatArray) -> int:
        """Points at which the law is not defined."""
        local_kernels.count_undefined(S, self.group.law, self._dim, self._counts)
        return int(self._counts.sum())


def _projectors(group: ElementGroup) -> FloatArray:
    """Projectors on the directions across each cell, (n_cells, d*d): zero in solids."""
    n, d = group.n_cells, group.gradients.shape[3]
    if group.kind == "solid":
        return np.zeros((n, d * d))
    # The gradients of the nodes but the first span the cell.
    Q, _ = np.linalg.qr(np.swapaxes(group.gradients[:, 0, 1:], 1, 2))
    return np.asarray((np.eye(d) - Q @ np.swapaxes(Q, 1, 2)).reshape(n, d * d))
