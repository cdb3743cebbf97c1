"""Parts of the mixed Hessian: against the tested Hessians, finite differences of the stretches, and one another."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, cell_matrices, material, random_state, scene, term_gradient

from femdeform.fem.discretization import ElementGroup
from femdeform.fem.mixed_cells import MixedCells
from femdeform.scene.mixed_schema import MixedFEMSolver
from solvers.mixed.local_state import LocalState

E = 100.0
KINDS = {
    "tets": body(block([1.0, 1.0, 1.0], [1, 1, 1]), material(E=E, nu=0.35)),
    "tets P2": body(block([1.0, 1.0, 1.0], [1, 1, 1]), material(E=E, nu=0.35), element_order=2),
    "corotated tets": body(block([1.0, 1.0, 1.0], [1, 1, 1]), material("corotated", E=E, nu=0.35)),
    "triangles": body(block([1.0, 1.0], [2, 1]), material(E=E, nu=0.35)),
    "membrane": body({"recipe": "cloth", "cells": [2, 2]}, material(E=E), kind="membrane", thickness=0.1),
    "rod": body({"recipe": "rod", "cells": 3}, material(E=E), kind="rod", cross_section=0.1),
}
ALL = pytest.mark.parametrize("name", KINDS)
# From small strains to cells turned inside out.
STATES = pytest.mark.parametrize("amplitude", [0.1, 0.6])


def elastic(name: str) -> tuple[Any, Any]:
    simulation = build(scene({"b": KINDS[name]}))
    (term,) = simulation.problem.elastic
    return term, simulation.discretization.points


def matrices(cells: MixedCells, x: Any, exact: bool, split: bool) -> Any:
    """Matrices of the cells, (n_cells, k d, k d)."""

    class Term:
        def hessian(self, x: Any, project: bool, blocks: Any, first: int) -> None:
            cells.hessian(x, exact, split, blocks, first)

    term: Any = Term()
    term.cells = cells.group.cells
    return cell_matrices(term, x, False)


@ALL
@STATES
def test_exact_is_the_tested_hessian(name: str, amplitude: float) -> None:
    term, X = elastic(name)
    x = random_state(X, amplitude, seed=1)
    cells = MixedCells(term.group, 0.1)
    cells.set_twists(x, predicted=False)
    expected = cell_matrices(term, x, False)
    np.testing.assert_allclose(matrices(cells, x, True, False), expected, atol=1e-9 * np.abs(expected).max())


@ALL
@STATES
def test_definite_is_the_projected_hessian_without_a_floor(name: str, amplitude: float) -> None:
    """With the law's own twists, and with a floor of rounding; with the twists off it is smaller by them alone."""
    term, X = elastic(name)
    x = random_state(X, amplitude, seed=2)
    cells = MixedCells(term.group, 1e-13)
    cells.set_twists(x, predicted=False)
    expected = cell_matrices(term, x, True)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(matrices(cells, x, False, False), expected, atol=1e-9 * scale)
    cells.twists[:] = 0.0
    without = matrices(cells, x, False, False)
    assert np.linalg.eigvalsh(without).min() > -1e-12 * scale
    assert np.linalg.eigvalsh(expected - without).min() > -1e-11 * scale
    assert np.abs(expected - without).max() > 1e-3 * scale  # some cell is under tension


@ALL
@STATES
@pytest.mark.parametrize("exact", [False, True])
def test_rows_and_compliances_make_up_the_rest(name: str, amplitude: float, exact: bool) -> None:
    term, X = elastic(name)
    x = random_state(X, amplitude, seed=3)
    cells = MixedCells(term.group, 0.1)
    cells.set_twists(x, predicted=False)
    whole, rest = matrices(cells, x, exact, False), matrices(cells, x, exact, True)
    B, C = cells.rows(x)
    assert B.shape[2] == cells.n_modes
    assert np.linalg.eigvalsh(C).min() > 0.0
    eliminated = np.einsum("eqmk,eqml->ekl", B, np.linalg.solve(C, B))
    np.testing.assert_allclose(rest + eliminated, whole, atol=1e-10 * np.abs(whole).max())


@ALL
def test_rows_are_the_derivatives_of_the_principal_stretches(name: str) -> None:
    """The diagonal modes: V ds_i/dx against central differences of the singular values of F."""
    term, X = elastic(name)
    group: ElementGroup = term.group
    x = random_state(X, 0.1, seed=4)
    B, _ = MixedCells(group, 0.1).rows(x)
    k = {"membrane": 2, "rod": 1}.get(group.kind, X.shape[1])

    def stretches(y: Any) -> Any:
        return np.linalg.svd(np.einsum("eac,eqak->eqck", y[group.cells], group.gradients), compute_uv=False)[..., :k]

    rng = np.random.default_rng(5)
    for _ in range(3):
        step = rng.standard_normal(X.shape)
        h = 1e-6
        slope = (stretches(x + h * step) - stretches(x - h * step)) / (2.0 * h)
        rows = np.einsum("eqmk,ek->eqm", B[:, :, :k], step[group.cells].reshape(len(group.cells), -1))
        np.testing.assert_allclose(rows, group.weights[..., None] * slope, atol=1e-6 * np.abs(rows).max())


@ALL
def test_predicted_stress_is_the_stress_and_its_rate(name: str) -> None:
    """Without a step the twists of the prediction are the law's own; with one they follow its principal stress."""
    term, X = elastic(name)
    x = random_state(X, 0.1, seed=6)
    cells = MixedCells(term.group, 1e-9)
    cells.set_twists(x, predicted=False)
    own = cells.twists.copy()
    cells.predict(x, np.zeros_like(x))
    cells.set_twists(x, predicted=True)
    np.testing.assert_allclose(cells.twists, own, atol=1e-10 * E)

    step = random_state(np.zeros_like(X), 1.0, seed=7)
    errors = []
    for h in (1e-2, 1e-3):
        cells.predict(x, h * step)
        cells.set_twists(x + h * step, predicted=True)
        predicted = cells.twists.copy()
        cells.set_twists(x + h * step, predicted=False)
        errors.append(np.abs(predicted - cells.twists).max())
    assert errors[1] < 0.02 * errors[0]  # of second order


# ------------------------------------------------------------------------------------------- alternating


@ALL
@pytest.mark.parametrize("tikhonov", [None, {"per": "compliance", "value": 1e-3}])
def test_local_state_at_a_consistent_point(name: str, tikhonov: Any) -> None:
    """At R S = F: D (-R H^-1 g) = -P without regularisation, so that the condensed force is minus the elastic one."""
    term, X = elastic(name)
    x = random_state(X, 0.1, seed=8)
    options = MixedFEMSolver.model_validate({"method": "mixed_fem", "scheme": "alternating", "tikhonov": tikhonov})
    state = LocalState(term.group, options)
    state.begin(None, x)
    state.freeze()
    state.rotate(x, 10.0)
    state.set_sides(x)
    g, d = term.group, X.shape[1]
    F = np.einsum("eac,eqak->eqck", x[g.cells], g.gradients)
    R, S = (a.reshape(F.shape) for a in (state.R, state.S))
    np.testing.assert_allclose(np.einsum("eqij,eqkj->eqik", R, R), np.broadcast_to(np.eye(d), F.shape), atol=1e-12)
    assert np.linalg.det(R).min() > 0.99
    across = state._across.reshape(-1, 1, d, d)
    np.testing.assert_allclose(R @ (S - across), F, atol=1e-12)

    n, k = g.cells.shape
    slots, blocks = np.zeros((n * k, d)), np.zeros((n * k * (k + 1) // 2, d * d))
    state.condensed(blocks, 0, slots, 0)
    forces = np.zeros_like(X)
    np.add.at(forces, g.cells.ravel(), slots)
    expected = -term_gradient(term, x)
    if tikhonov is None:
        np.testing.assert_allclose(forces, expected, atol=1e-10 * np.abs(expected).max())
    else:
        assert 1e-5 < np.abs(forces - expected).max() / np.abs(expected).max() < 1e-2

    # Rows, compliances and sides of the saddle form give the condensed form by elimination.
    B, C, b = state.saddle()
    solved = np.einsum("eqmk,eqm->ek", B, np.linalg.solve(C, b[..., None])[..., 0]).reshape(n * k, d)
    np.testing.assert_allclose(solved, slots, atol=1e-9 * np.abs(slots).max())
    full = np.einsum("eqmk,eqml->ekl", B, np.linalg.solve(C, B))
    upper = blocks.reshape(n, -1, d, d)
    i, j = np.triu_indices(k)
    np.testing.assert_allclose(
        full.reshape(n, k, d, k, d).transpose(0, 1, 3, 2, 4)[:, i, j], upper, atol=1e-9 * np.abs(upper).max()
    )

    # Both ways to the multipliers agree, and the stretch they lead to obeys the linearised law.
    step = random_state(np.zeros_like(X), 0.1, seed=9)
    state.take_condensed(step)
    by_cells = state.L.copy()
    y = np.linalg.solve(C, (np.einsum("eqmk,ek->eqm", B, step[g.cells].reshape(n, -1)) - b)[..., None])[..., 0]
    state.take_multipliers(y)
    np.testing.assert_allclose(state.L, by_cells, atol=1e-8 * np.abs(by_cells).max())
    state.update_stretch()
    S_new = state.S.reshape(F.shape)
    np.testing.assert_allclose(S_new, np.swapaxes(S_new, 2, 3), atol=1e-12)


def test_a_rod_turned_by_half_a_turn() -> None:
    term, X = elastic("rod")
    options = MixedFEMSolver.model_validate({"method": "mixed_fem", "scheme": "alternating"})
    state = LocalState(term.group, options)
    for x in (-X, X @ np.diag([-1.0, -1.0, 1.0])):
        state.begin(None, x)
        state.rotate(x, 10.0)
        R = state.R.reshape(-1, 3, 3)
        np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
        t = X[term.cells[:, 1]] - X[term.cells[:, 0]]
        np.testing.assert_allclose(np.einsum("eij,ej->ei", R, t), -t, atol=1e-12)
