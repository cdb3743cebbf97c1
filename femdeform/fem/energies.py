"""The terms of the incremental potential that live on cells and facets: elastic energy and pressure.

Each term writes the gradient and the Hessian of its cells into slots of shared buffers; `IncrementalPotential` sums
the slots at the nodes. A term gives its value over this rank's cells; the caller adds the ranks up.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from femdeform.fem import codimensional, fibre_kernels, kernels
from femdeform.fem.conditions import FacetPressure
from femdeform.fem.discretization import EDGES, ElementGroup
from femdeform.types import FloatArray


class CellTerm(Protocol):
    """A sum over cells; `cells` says which nodes each cell couples."""

    cells: np.ndarray

    def value(self, x: FloatArray) -> float:
        """Energy over this rank's cells [J]."""

    def gradient(self, x: FloatArray, slots: FloatArray, first: int) -> None:
        """Write each cell's gradient [N] to rows of `slots` (n_slots, dim) from `first` on."""

    def hessian(self, x: FloatArray, project: bool, blocks: FloatArray, first: int) -> None:
        """Write the upper block triangle of each cell's Hessian [N/m] to rows of `blocks` from `first` on."""


class ElasticEnergy:
    """Sum over cells of volume times energy density; one instance per element group.

    Membranes and rods use the three-dimensional law with stretch one across. Muscle fibres of the group's cells are a
    part of it; their Hessian is projected by itself, in closed form.
    """

    def __init__(self, group: ElementGroup) -> None:
        self.group = group
        self.cells = group.cells
        self._dim = (0,) * group.gradients.shape[3]
        self._nodes = (0,) * group.cells.shape[1]
        self._energies = np.empty(group.n_cells)
        self._kernels = kernels if group.kind == "solid" else codimensional

    def set_time(self, time: float) -> None:
        """Set muscles to their activation at a time [s]."""
        for fibres in self.group.fibres:
            fibres.muscle.set_time(time)

    def cell_energies(self, x: FloatArray) -> FloatArray:
        """Elastic energy of every cell [J]; a buffer that the next call overwrites."""
        g = self.group
        self._kernels.cell_energies(x, g.cells, g.gradients, g.weights, g.law, self._dim, self._nodes, self._energies)
        for f in g.fibres:
            fibre_kernels.add_energies(x, g.cells, g.weights, f.rows, f.weights, f.muscle.law, self._energies)
        return self._energies

    def value(self, x: FloatArray) -> float:
        """Elastic energy over this rank's cells [J]; infinite where the law is not defined."""
        return float(np.sum(self.cell_energies(x)))

    def gradient(self, x: FloatArray, slots: FloatArray, first: int) -> None:
        """Write the cells' nodal forces V P grad N [N], those of fibres included."""
        g = self.group
        self._kernels.cell_forces(x, g.cells, g.gradients, g.weights, g.law, self._dim, self._nodes, slots, first)
        for f in g.fibres:
            fibre_kernels.add_forces(x, g.cells, g.weights, f.rows, f.weights, f.muscle.law, slots, first)

    def hessian(self, x: FloatArray, project: bool, blocks: FloatArray, first: int) -> None:
        """Write the cells' tangent blocks [N/m], each cell positive semi-definite if `project`."""
        g = self.group
        self._kernels.cell_hessians(
            x, g.cells, g.gradients, g.weights, g.law, project, self._dim, self._nodes, blocks, first
        )
        for f in g.fibres:
            fibre_kernels.add_hessians(x, g.cells, g.weights, f.rows, f.weights, f.muscle.law, project, blocks, first)

    def add_stiffness(self, nodes: FloatArray) -> None:
        """Add to nodes (n_nodes,) the size of its rows of the tangent at rest, V (2 mu + lambda) |grad N|^2 [N/m]."""
        g = self.group
        squares = np.einsum("cq,cqna,cqna->cn", g.weights, g.gradients, g.gradients)
        nodes += (2.0 * g.law.mu + g.law.lmbda) * np.bincount(g.cells.ravel(), squares.ravel(), nodes.size)


# Quadrature on the reference facet: points and weights that integrate the pressure of quadratic facets exactly
# (degree 4 on triangles, 3 on edges). Triangle rule: Strang and Fix, degree 4, six points.
_TRIANGLE = (
    np.array(
        [
            [0.445948490915965, 0.445948490915965],
            [0.108103018168070, 0.445948490915965],
            [0.445948490915965, 0.108103018168070],
            [0.091576213509771, 0.091576213509771],
            [0.816847572980459, 0.091576213509771],
            [0.091576213509771, 0.816847572980459],
        ]
    ),
    np.array([0.223381589678011] * 3 + [0.109951743655322] * 3) / 2.0,
)
_EDGE = (np.array([[0.5 - 0.5 / np.sqrt(3.0)], [0.5 + 0.5 / np.sqrt(3.0)]]), np.array([0.5, 0.5]))


def facet_shapes(n_corners: int, n_nodes: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Shape values (n_q, n_nodes), derivatives (n_q, n_nodes, n_corners - 1) and weights (n_q,) of a facet."""
    points, weights = _EDGE if n_corners == 2 else _TRIANGLE
    corner = np.concatenate([1.0 - points.sum(axis=1, keepdims=True), points], axis=1)
    slope = np.concatenate([-np.ones((1, n_corners - 1)), np.eye(n_corners - 1)])
    if n_nodes == n_corners:
        return corner, np.broadcast_to(slope, (len(points), *slope.shape)), weights
    pairs = [(0, 1)] if n_corners == 2 else EDGES["triangle"]
    values = [corner * (2.0 * corner - 1.0)]
    slopes = [(4.0 * corner - 1.0)[..., None] * slope]
    for a, b in pairs:
        values.append(4.0 * corner[:, a : a + 1] * corner[:, b : b + 1])
        slopes.append((4.0 * (corner[:, a, None] * slope[b] + corner[:, b, None] * slope[a]))[:, None])
    return np.concatenate(values, axis=1), np.concatenate(slopes, axis=1), weights


class FollowerPressure:
    """Pressure on the deformed surface, pointing against the outward normal.

    The force on an open surface has no potential, so `value` is minus the work done along the straight line from a
    reference state (`set_reference`): its derivative along any line through that state is the force exactly, which is
    all a line search needs. The Hessian is the symmetric part of the force's derivative.
    """

    def __init__(self, load: FacetPressure) -> None:
        self.load = load
        self.cells = load.facets.astype(np.int32)
        self.pressure = 0.0
        self._shape, self._slope, self._weights = facet_shapes(load.n_corners, load.facets.shape[1])
        self._reference: FloatArray | None = None
        # Force is a polynomial of degree dim - 1 in the position along a line: the rule is exact.
        self._line = ((0.0, 1.0), (0.5, 0.5)) if load.n_corners == 2 else ((0.0, 0.5, 1.0), (1 / 6, 4 / 6, 1 / 6))

    def set_time(self, time: float) -> None:
        """Set the pressure to that of a time."""
        self.pressure = self.load.pressure * self.load.curve(time)

    def set_reference(self, x: FloatArray) -> None:
        """State (n_local, dim) from which `value` measures the work."""
        self._reference = x[self.load.facets]

    def _gradient(self, corners: FloatArray) -> FloatArray:
        """Minus the nodal forces, (n, n_nodes, dim)."""
        tangents = np.einsum("fac,qak->fqck", corners, self._slope)
        if self.load.n_corners == 2:
            normal = np.stack([tangents[..., 1, 0], -tangents[..., 0, 0]], axis=-1)
        else:
            normal = np.cross(tangents[..., 0], tangents[..., 1])
        return np.asarray(self.pressure * np.einsum("q,qa,fqc->fac", self._weights, self._shape, normal))

    def value(self, x: FloatArray) -> float:
        """Minus the work of the pressure from the reference state to `x` [J]."""
        if self._reference is None:
            raise RuntimeError("set_reference comes before value")
        end = x[self.load.facets]
        step = end - self._reference
        return float(
            sum(w * np.vdot(self._gradient(self._reference + t * step), step) for t, w in zip(*self._line, strict=True))
        )

    def gradient(self, x: FloatArray, slots: FloatArray, first: int) -> None:
        """Write minus the nodal forces [N]."""
        forces = self._gradient(x[self.load.facets])
        slots[first : first + forces.shape[0] * forces.shape[1]] = forces.reshape(-1, forces.shape[2])

    def hessian(self, x: FloatArray, project: bool, blocks: FloatArray, first: int) -> None:
        """Write the symmetric part of the derivative of the force [N/m], clamped to PSD per facet if `project`."""
        corners = x[self.load.facets]
        n, k, d = corners.shape
        if self.load.n_corners == 2:
            # normal = (t_y, -t_x) per unit slope
            turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
            K = np.einsum("q,qa,qb,ce->acbe", self._weights, self._shape, self._slope[:, :, 0], turn)
            K = np.broadcast_to(self.pressure * K, (n, k, d, k, d))
        else:
            tangents = np.einsum("fac,qak->fqck", corners, self._slope)
            cross = np.zeros((3, 3, 3))
            for i, j, m in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
                cross[i, j, m], cross[i, m, j] = 1.0, -1.0
            # d(t0 x t1)/dx_b = slope_b0 (e x t1) + slope_b1 (t0 x e)
            first_part = np.einsum("cem,fqm,qb->fqcbe", cross, tangents[..., 1], self._slope[:, :, 0])
            second_part = np.einsum("cme,fqm,qb->fqcbe", cross, tangents[..., 0], self._slope[:, :, 1])
            K = self.pressure * np.einsum("q,qa,fqcbe->facbe", self._weights, self._shape, first_part + second_part)
        square = K.reshape(n, k * d, k * d)
        square = 0.5 * (square + np.swapaxes(square, 1, 2))
        if project:
            values, vectors = np.linalg.eigh(square)
            square = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        a, b = np.triu_indices(k)
        upper = square.reshape(n, k, d, k, d).transpose(0, 1, 3, 2, 4)[:, a, b]
        blocks[first : first + n * a.size] = upper.reshape(-1, d * d)
