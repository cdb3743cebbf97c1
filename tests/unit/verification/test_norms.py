"""Quadrature on boundary facets: areas, outward normals, loads of linear and quadratic elements."""

from __future__ import annotations

import numpy as np
import pytest
from scenario import block, body, build, quasistatic, scene

from femdeform.fem.node_sets import NodeSets
from femdeform.types import FloatArray
from verification.norms import FacetTable, tabulate_facets

SIZE = (2.0, 1.0, 0.5)


@pytest.fixture(params=[(2, 1), (2, 2), (3, 1), (3, 2)], ids=["P1 2D", "P2 2D", "P1 3D", "P2 3D"])
def boundary(request: pytest.FixtureRequest) -> tuple[FacetTable, FloatArray]:
    """The boundary of a box, and its nodes."""
    dim, order = request.param
    data = scene({"box": body(block(SIZE[:dim], [2, 1, 1][:dim]), element_order=order)}, time=quasistatic())
    simulation = build(data)
    discretization, mesh = simulation.discretization, simulation.meshes["box"]
    facets = NodeSets(simulation.meshes, discretization.bodies).facet_nodes("box", mesh.facet_groups["boundary"])
    return tabulate_facets(discretization.points, facets, 6), discretization.points


def test_area_and_normals(boundary: tuple[FacetTable, FloatArray]) -> None:
    table, points = boundary
    a, b, c = SIZE
    area = 2.0 * (a + b) if points.shape[1] == 2 else 2.0 * (a * b + b * c + c * a)
    assert table.weights.sum() == pytest.approx(area, rel=1e-14)
    np.testing.assert_allclose(np.linalg.norm(table.normals, axis=1), 1.0, rtol=1e-14)
    middle = points.mean(axis=0)
    outward = np.einsum("ec,ec->e", table.points.mean(axis=1) - middle, table.normals)
    assert (outward > 0.0).all()


def test_load_of_a_traction(boundary: tuple[FacetTable, FloatArray]) -> None:
    """Gauss: the integral of the normal component of x^2 y e_x over the surface is that of 2 x y over the volume."""
    table, points = boundary
    dim = points.shape[1]
    direction = np.eye(dim)[0]

    def traction(x: FloatArray, normal: FloatArray) -> FloatArray:
        return (x[:, 0] ** 2 * x[:, 1] * normal[:, 0])[:, None] * direction

    load = table.integrate_load(traction, len(points))
    a, b, c = SIZE
    depth = 1.0 if dim == 2 else c
    np.testing.assert_allclose(load.sum(axis=0), direction * a**2 / 2.0 * b**2 * depth, rtol=1e-13, atol=1e-13)
    inside = ~np.isin(np.arange(len(points)), table.facets)
    assert not load[inside].any()


def test_a_constant_pressure_is_in_balance(boundary: tuple[FacetTable, FloatArray]) -> None:
    table, points = boundary
    load = table.integrate_load(lambda _, normal: normal, len(points))
    np.testing.assert_allclose(load.sum(axis=0), 0.0, atol=1e-13)
    # Its virial is the dimension times the volume.
    volume = np.prod(SIZE[: points.shape[1]])
    assert np.sum(load * points) == pytest.approx(points.shape[1] * volume, rel=1e-13)
