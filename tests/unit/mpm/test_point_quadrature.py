"""Points by cells: every point once, and sums at the nodes that are those of the points."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.mpm import cell_kernels
from femdeform.mpm.grid import Grid
from femdeform.mpm.point_quadrature import PointCells, Quadrature

CELL = 0.125


@pytest.mark.parametrize("n_carriers", [None, 40])
@pytest.mark.parametrize("dim", [2, 3])
def test_forces_through_cells(dim: int, n_carriers: int | None) -> None:
    rng = np.random.default_rng(dim)
    points = rng.random((300, dim))
    # On a knot some weights vanish, and points beyond the carriers' nodes have none at all.
    points[:20] = np.round(points[:20] / CELL) * CELL + 0.5 * CELL
    n = 280
    stencils = Grid(CELL, "quadratic").stencils(points, n_carriers)
    identity = np.tile(np.eye(dim), (n, 1, 1))
    q = Quadrature.of(stencils, n, identity, np.empty(0, dtype=np.int64))
    cells = q.cells
    np.testing.assert_array_equal(np.sort(cells.points), np.arange(n))
    assert (np.diff(cells.offsets) > 0).all()
    assert cells.offsets[0] == 0
    assert cells.offsets[-1] == n
    if n_carriers is None:
        lowest = np.floor(points[:n] / CELL - 0.5)
        assert cells.offsets.size - 1 <= len(np.unique(lowest, axis=0)) < n
        for first, last in zip(cells.offsets[:-1], cells.offsets[1:], strict=True):
            own = stencils.nodes[cells.points[first:last]]
            held = stencils.weights[cells.points[first:last]] > 0.0
            for place in range(own.shape[1]):
                assert len(set(own[held[:, place], place])) <= 1
    P = rng.standard_normal((n, dim * dim))
    at_cells = cells.empty(dim)
    cell_kernels.forces(P, q.gradients, cells.offsets, cells.points, (0,) * dim, (0,) * 3**dim, at_cells)
    expected = np.zeros((stencils.n_nodes, dim))
    of_points = np.einsum("qcb,qkb->qkc", P.reshape(n, dim, dim), q.gradients[:, 0])
    np.add.at(expected, stencils.nodes[:n], of_points)
    np.testing.assert_allclose(cells.gather(at_cells), expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())


def test_no_points() -> None:
    stencils = Grid(CELL, "quadratic").stencils(np.random.default_rng(0).random((5, 2)))
    cells = PointCells.of(stencils, 0)
    np.testing.assert_array_equal(cells.gather(cells.empty(2)), np.zeros((stencils.n_nodes, 2)))
