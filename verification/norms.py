"""Errors of finite element fields in L2 and H1, by a quadrature of their own, and the rates at which they fall.

The rule and the shape functions here are independent of those a simulation integrates with: a mistake there cannot
hide itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from femdeform.types import FloatArray, IntArray

# A field of points (n, dim) -> values (n, ...).
Field = Callable[[FloatArray], FloatArray]

# Mid-edge nodes follow the vertices, in VTK's order.
_EDGES = {
    1: ((0, 1),),
    2: ((0, 1), (1, 2), (0, 2)),
    3: ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)),
}


@dataclass(frozen=True)
class ShapeTable:
    """Shape functions of straight-sided simplices at the points of a rule.

    Attributes
    ----------
    points : (n_cells, n_q, dim) float64
        Quadrature points [m].
    weights : (n_cells, n_q) float64
        Weights times volume [m^dim].
    values : (n_q, n_local) float64
        Shape functions [-], the same in every cell.
    gradients : (n_cells, n_q, n_local, dim) float64
        Their gradients [1/m].
    cells : (n_cells, n_local) int64
        Nodes of the cells.
    """

    points: FloatArray
    weights: FloatArray
    values: FloatArray
    gradients: FloatArray
    cells: IntArray

    def integrate_load(self, density: Field, n_nodes: int) -> FloatArray:
        """Nodal forces (n_nodes, dim) [N] of a force per reference volume [N/m^dim]."""
        force = density(self.points.reshape(-1, self.points.shape[2])).reshape(self.points.shape)
        return _assemble_load(self.weights, self.values, force, self.cells, n_nodes)


@dataclass(frozen=True)
class FacetTable:
    """Shape functions of flat boundary facets at the points of a rule.

    Attributes
    ----------
    points : (n_facets, n_q, dim) float64
        Quadrature points [m].
    weights : (n_facets, n_q) float64
        Weights times area [m^(dim - 1)].
    values : (n_q, n_local) float64
        Shape functions [-], the same on every facet.
    normals : (n_facets, dim) float64
        Unit normals, outward [-].
    facets : (n_facets, n_local) int64
        Nodes of the facets.
    """

    points: FloatArray
    weights: FloatArray
    values: FloatArray
    normals: FloatArray
    facets: IntArray

    def integrate_load(self, traction: Callable[[FloatArray, FloatArray], FloatArray], n_nodes: int) -> FloatArray:
        """Nodal forces (n_nodes, dim) [N] of a traction, a function of points and normals (n, dim) [N/m^(dim-1)]."""
        dim = self.points.shape[2]
        normals = np.broadcast_to(self.normals[:, None], self.points.shape).reshape(-1, dim)
        force = traction(self.points.reshape(-1, dim), normals).reshape(self.points.shape)
        return _assemble_load(self.weights, self.values, force, self.facets, n_nodes)


def _assemble_load(
    weights: FloatArray, values: FloatArray, force: FloatArray, nodes: IntArray, n_nodes: int
) -> FloatArray:
    """Nodal forces (n_nodes, dim) of a force density at quadrature points."""
    of_elements = np.einsum("eq,qa,eqc->eac", weights, values, force, optimize=True)
    load = np.zeros((n_nodes, force.shape[2]))
    np.add.at(load, nodes, of_elements)
    return load


@dataclass(frozen=True)
class ErrorNorms:
    """Errors of a displacement field.

    Attributes
    ----------
    l2 : float
        L2 norm of the error [m^(1 + dim/2)].
    h1 : float
        L2 norm of its gradient [m^(dim/2)].
    """

    l2: float
    h1: float


def tabulate(points: FloatArray, cells: IntArray, degree: int) -> ShapeTable:
    """Evaluate shape functions with a rule that is exact for polynomials of a degree.

    Parameters
    ----------
    points : (n_nodes, dim) float64
        Reference positions of all nodes [m].
    cells : (n_cells, n_local) int64
        dim + 1 nodes a cell for P1; for P2 the mid-edge nodes after them, in VTK's order.
    degree : int
        Degree that the rule integrates exactly.

    Returns
    -------
    ShapeTable
    """
    dim = points.shape[1]
    barycentric, weights = _rule(dim, degree)
    order = 1 if cells.shape[1] == dim + 1 else 2
    corners = points[cells[:, : dim + 1]]
    edges = corners[:, 1:] - corners[:, :1]  # rows are edge vectors: E_kj = dX_j/dxi_k
    inverse = np.linalg.inv(edges)
    # Gradients of the barycentric coordinates: columns of the inverse, and minus their sum for the first.
    of_barycentric = np.concatenate([-inverse.sum(axis=2)[:, None, :], np.swapaxes(inverse, 1, 2)], axis=1)
    values, slopes = _shapes(barycentric, dim, order)
    return ShapeTable(
        points=np.einsum("qk,ekc->eqc", barycentric, corners),
        weights=np.abs(np.linalg.det(edges))[:, None] * weights,
        values=values,
        gradients=np.einsum("qak,ekc->eqac", slopes, of_barycentric, optimize=True),
        cells=cells,
    )


def tabulate_facets(points: FloatArray, facets: IntArray, degree: int) -> FacetTable:
    """Evaluate shape functions on boundary facets with a rule that is exact for polynomials of a degree.

    Parameters
    ----------
    points : (n_nodes, dim) float64
        Reference positions of all nodes [m].
    facets : (n_facets, n_local) int64
        dim corners a facet, oriented outward; for P2 the mid-edge nodes after them, in VTK's order.
    degree : int
        Degree that the rule integrates exactly.

    Returns
    -------
    FacetTable
    """
    dim = points.shape[1]
    barycentric, weights = _rule(dim - 1, degree)
    corners = points[facets[:, :dim]]
    sides = corners[:, 1:] - corners[:, :1]
    if dim == 2:
        normals = np.stack([sides[:, 0, 1], -sides[:, 0, 0]], axis=1)
    else:
        normals = np.cross(sides[:, 0], sides[:, 1])
    # The rule of the unit triangle has weights that add up to a half, the normal the length of the parallelogram.
    size = np.linalg.norm(normals, axis=1)
    return FacetTable(
        points=np.einsum("qk,ekc->eqc", barycentric, corners),
        weights=size[:, None] * weights,
        values=_shapes(barycentric, dim - 1, 1 if facets.shape[1] == dim else 2)[0],
        normals=normals / size[:, None],
        facets=facets,
    )


def _rule(dim: int, degree: int) -> tuple[FloatArray, FloatArray]:
    """Barycentric points (n_q, dim + 1) and weights (n_q,) on the unit simplex."""
    from skfem.quadrature import get_quadrature
    from skfem.refdom import RefLine, RefTet, RefTri

    points, weights = get_quadrature({1: RefLine, 2: RefTri, 3: RefTet}[dim], degree)
    return np.concatenate([1.0 - points.sum(axis=0, keepdims=True), points]).T, np.asarray(weights)


def _shapes(barycentric: FloatArray, dim: int, order: int) -> tuple[FloatArray, FloatArray]:
    """Shape values (n_q, n_local) and derivatives by barycentric coordinates (n_q, n_local, dim + 1)."""
    n_q = len(barycentric)
    unit = np.eye(dim + 1)
    if order == 1:
        return barycentric, np.broadcast_to(unit, (n_q, dim + 1, dim + 1))
    first, second = np.array(_EDGES[dim]).T
    corner_slopes = (4.0 * barycentric - 1.0)[:, :, None] * unit
    edge_slopes = 4.0 * (barycentric[:, first, None] * unit[second] + barycentric[:, second, None] * unit[first])
    values = [barycentric * (2.0 * barycentric - 1.0), 4.0 * barycentric[:, first] * barycentric[:, second]]
    return np.concatenate(values, axis=1), np.concatenate([corner_slopes, edge_slopes], axis=1)


def error_norms(table: ShapeTable, displacement: FloatArray, exact: Field, exact_gradient: Field) -> ErrorNorms:
    """Distance of a finite element displacement from an exact one.

    Parameters
    ----------
    table : ShapeTable
        Of a degree high enough that its own error does not count.
    displacement : (n_nodes, dim) float64
        Nodal displacements [m].
    exact : callable
        Displacement (n, dim) at points (n, dim) [m].
    exact_gradient : callable
        Its gradient (n, dim, dim), ``du_i/dX_j`` [-].

    Returns
    -------
    ErrorNorms
    """
    n_cells, n_q, dim = table.points.shape
    places = table.points.reshape(-1, dim)
    nodal = displacement[table.cells]
    value = np.einsum("qa,eac->eqc", table.values, nodal) - exact(places).reshape(n_cells, n_q, dim)
    gradient = np.einsum("eac,eqak->eqck", nodal, table.gradients, optimize=True)
    gradient = gradient - exact_gradient(places).reshape(n_cells, n_q, dim, dim)
    return ErrorNorms(
        float(np.sqrt(np.einsum("eq,eqc,eqc->", table.weights, value, value, optimize=True))),
        float(np.sqrt(np.einsum("eq,eqck,eqck->", table.weights, gradient, gradient, optimize=True))),
    )


def observed_rates(sizes: Sequence[float], errors: Sequence[float]) -> list[float]:
    """Orders of convergence between neighbours of a sequence of meshes or time steps.

    Parameters
    ----------
    sizes : sequence of float
        Element sizes or time steps, of any common unit.
    errors : sequence of float
        Error at each.

    Returns
    -------
    list of float
        One fewer than `sizes`: log of the ratio of errors over log of the ratio of sizes.

    Raises
    ------
    ValueError
        If the lengths differ, or an error is not positive.
    """
    if len(sizes) != len(errors):
        raise ValueError(f"{len(sizes)} sizes for {len(errors)} errors")
    if any(not error > 0.0 for error in errors):
        raise ValueError("a rate needs positive errors")
    pairs = zip(pairwise(sizes), pairwise(errors), strict=True)
    return [float(np.log(e0 / e1) / np.log(h0 / h1)) for (h0, h1), (e0, e1) in pairs]
