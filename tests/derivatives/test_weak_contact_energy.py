"""Contact rows: energy, gradient and second derivative agree, and what they promise of the function holds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scenario import block, body, build, material, scene

from femdeform.contact.weak_contact import WeakContact
from femdeform.fem.incremental_potential import IncrementalPotential

Array = NDArray[np.float64]
RNG = np.random.default_rng(5)
PLANES = ((0, 1), (1, 2), (0, 2))


def two_blocks(dim: int, **contact: object) -> IncrementalPotential:
    """Two blocks with a gap of 0.01 m, the upper one shifted, other meshes."""
    stuff = material(E=1e3, density=10.0)
    shift = [0.13, 0.61, 0.07][:dim]
    data = scene(
        {
            "a": body(block([1.0, 0.6, 1.0][:dim], [4, 2, 3][:dim]), stuff),
            "b": body(block([1.0, 0.6, 1.0][:dim], [3, 2, 4][:dim], translate=shift), stuff),
        },
        contact={"method": "weak_constraints", "stiffness": 400.0, **contact},
    )
    return build(data).problem


def contact_of(problem: IncrementalPotential) -> WeakContact:
    contact = problem.weak_contact
    assert contact is not None
    return contact


def pressed(problem: IncrementalPotential, depth: float, noise: float = 0.02) -> Array:
    """Positions with the upper block shifted down, everything a little disturbed."""
    points = problem.points
    x = points + noise * RNG.standard_normal(points.shape)
    x[points[:, 1] > 0.605, 1] -= depth
    return x


@pytest.mark.parametrize("thickness", [0.0, 0.03])
@pytest.mark.parametrize("drag", [0.0, 150.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_derivatives(dim: int, drag: float, thickness: float) -> None:
    problem = two_blocks(dim, tangential_stiffness=drag, thickness=thickness, margin=0.2)
    contact = contact_of(problem)
    start = pressed(problem, 0.05)
    contact.begin_step(start, start)
    x = pressed(problem, 0.05)
    gaps = contact.gaps(x)
    assert (gaps < 0.0).any()
    assert (gaps > 0.0).any()
    assert (contact.tangential_stiffness > 0.0).any() == (drag > 0.0)
    gradient = np.zeros_like(x)
    contact.add_gradient(x, gradient)
    blocks = contact.hessian_blocks(x, False)
    step = RNG.standard_normal(x.shape)
    h = 1e-6
    assert np.abs(gaps).min() > 5.0 * h * np.abs(step).max()  # no row changes sides within the differences
    slope = (contact.value(x + h * step) - contact.value(x - h * step)) / (2.0 * h)
    assert np.sum(gradient * step) == pytest.approx(slope, rel=1e-7)
    ahead, behind = np.zeros_like(x), np.zeros_like(x)
    contact.add_gradient(x + h * step, ahead)
    contact.add_gradient(x - h * step, behind)
    product = np.zeros_like(x)
    K = blocks.blocks.reshape(-1, dim, dim)
    np.add.at(product, blocks.rows, np.einsum("ncd,nd->nc", K, step[blocks.columns]))
    np.add.at(product, blocks.columns, np.einsum("ndc,nd->nc", K, step[blocks.rows]))
    own = blocks.diagonal.reshape(-1, dim, dim)
    np.add.at(product, blocks.nodes, np.einsum("ncd,nd->nc", own, step[blocks.nodes]))
    np.testing.assert_allclose(product, (ahead - behind) / (2.0 * h), rtol=0.0, atol=1e-6 * np.abs(product).max())
    assert np.sum(product * step) >= 0.0


def test_the_whole_problem_has_its_derivatives() -> None:
    """Phi, its gradient and its Hessian take the rows in, whose pairs are new to the sparsity."""
    problem = two_blocks(3, margin=0.2)
    simulation_x = pressed(problem, 0.05)
    from femdeform.fem.incremental_potential import State

    problem.begin_step(State(simulation_x, np.zeros_like(simulation_x)), 0.01)
    x = simulation_x + 0.003 * RNG.standard_normal(simulation_x.shape)
    step, h = RNG.standard_normal(x.shape), 1e-6
    slope = (problem.value(x + h * step) - problem.value(x - h * step)) / (2.0 * h)
    assert np.sum(problem.gradient(x) * step) == pytest.approx(slope, rel=1e-6)
    change = (problem.gradient(x + h * step) - problem.gradient(x - h * step)) / (2.0 * h)
    product = problem.hessian(x, False).times(step)
    np.testing.assert_allclose(product, change, rtol=0.0, atol=1e-5 * np.abs(change).max())


@pytest.mark.parametrize("dim", [2, 3])
def test_it_pushes_and_never_pulls(dim: int) -> None:
    problem = two_blocks(dim, margin=0.05)
    contact = contact_of(problem)
    start = pressed(problem, 0.05, 2e-3)
    contact.begin_step(start, start)
    assert contact.count(start) >= 3
    apart = start.copy()
    apart[problem.points[:, 1] > 0.605, 1] += 0.5
    out = np.zeros_like(start)
    contact.add_gradient(apart, out)
    assert contact.value(apart) == 0.0
    assert not out.any()
    out = np.zeros_like(start)
    contact.add_gradient(start, out)
    upper = problem.points[:, 1] > 0.605
    assert (-out[upper]).sum(axis=0)[1] > 0.0  # upwards
    # A force of contact along the line between its two points: no net force, no torque where the rows were found.
    assert np.abs(out.sum(axis=0)).max() < 1e-12 * np.abs(out).sum()
    arm, force = start - start.mean(axis=0), out
    torque = np.array([np.sum(arm[:, i] * force[:, j] - arm[:, j] * force[:, i]) for i, j in PLANES[: 2 * dim - 3]])
    assert np.abs(torque).max() < 1e-12 * np.abs(out).sum()


def test_convex_along_any_line() -> None:
    problem = two_blocks(3, margin=0.2, tangential_stiffness=50.0)
    contact = contact_of(problem)
    start = pressed(problem, 0.05)
    contact.begin_step(start, start)
    for _ in range(5):
        a, b = pressed(problem, 0.0), pressed(problem, 0.1)
        values = [contact.value(a + t * (b - a)) for t in np.linspace(0.0, 1.0, 21)]
        assert np.diff(values, 2).min() >= -1e-12 * max(values)


def test_stiffness_by_node_by_area_and_default() -> None:
    by_node = contact_of(two_blocks(3))
    by_area = contact_of(two_blocks(3, per="area"))
    default = contact_of(two_blocks(3, stiffness=None))
    for contact in (by_node, by_area, default):
        x = contact._search.surface.rest
        full = np.zeros((int(contact._search.surface.nodes.max()) + 1, 3))
        full[contact._search.surface.nodes] = x
        contact.begin_step(full, full)
        assert len(contact.cells)
    assert np.all(by_node.normal_stiffness == 400.0)
    # The vertices of the two surfaces share their area.
    area = 2.0 * (2.0 * 1.0 * 1.0 + 4.0 * 1.0 * 0.6)
    assert by_area._stiffness.sum() == pytest.approx(400.0 * area)
    ratio = default._stiffness / by_area._stiffness * 400.0
    edges = [10.0 * 1e3 / value for value in (ratio[0], ratio[-1])]
    assert all(0.2 < edge < 0.6 for edge in edges)  # ten moduli over the mean edge
