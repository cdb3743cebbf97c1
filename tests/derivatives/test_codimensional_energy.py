"""Membranes and rods: three-dimensional laws at the stretches of a cell, against finite differences and eigenvalues.

The loops run uncompiled here (``py_func``): compiling fourteen variants would take minutes. One test compares the
compiled ones with them.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenario import (
    body,
    build,
    cell_matrices,
    difference_gradient,
    difference_matrix,
    material,
    rotation,
    scene,
    term_gradient,
)

from femdeform.fem import codimensional, energies
from femdeform.fem.discretization import ElementGroup
from femdeform.fem.energies import ElasticEnergy
from femdeform.materials import LAWS, dispatch, lame_parameters, law_class, supports_codimension

MU, LMBDA = lame_parameters(1.0, 0.35)
CODIMENSIONAL = tuple(name for name in LAWS if name != "linear")
KINDS = pytest.mark.parametrize("n_nodes", [2, 3], ids=["rod", "membrane"])
ALL_LAWS = pytest.mark.parametrize("name", CODIMENSIONAL)


@pytest.fixture
def uncompiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `ElasticEnergy` run the loops of membranes and rods, and their tangent, in Python."""
    loops = SimpleNamespace(
        **{name: getattr(codimensional, name).py_func for name in ("cell_energies", "cell_forces", "cell_hessians")}
    )
    monkeypatch.setattr(energies, "codimensional", loops)
    for name in ("_tangent", "_add_mode"):
        monkeypatch.setattr(codimensional, name, getattr(codimensional, name).py_func)


def law_of(name: str) -> Any:
    return law_class(name).from_lame(MU, LMBDA, 3)


def one_cell(name: str, n_nodes: int) -> tuple[ElasticEnergy, Any]:
    """A skew cell somewhere in space with area or length 1 (times 1), and its reference positions."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, 2.0, 0.0]])[:n_nodes]
    X = corners @ rotation(3, seed=4).T + np.array([0.3, -0.2, 0.5])
    T = (X[1:] - X[0]).T
    rows = np.linalg.pinv(T)
    gradients = np.concatenate([-rows.sum(axis=0, keepdims=True), rows])[None, None]
    kind = "rod" if n_nodes == 2 else "membrane"
    cells = np.arange(n_nodes, dtype=np.int32)[None]
    group = ElementGroup("b", kind, law_of(name), cells, gradients, np.array([[0.7]]), np.array([0]))
    return ElasticEnergy(group), X


STRETCHES = {
    "rest": (1.0, 1.0),
    "equal": (1.3, 1.3),
    "tension": (1.6, 1.2),
    "compression": (0.8, 0.6),
    "mixed": (1.5, 0.5),
    "flattened": (1.2, 0.05),
    "nearly equal": (1.1, 1.1 - 1e-9),
}


def placed(X: Any, s: tuple[float, float], seed: int) -> Any:
    """Positions of a cell with these principal stretches, in directions of its own, turned in space."""
    if len(X) == 2:
        return X[0] + (X - X[0]) @ rotation(3, seed).T * s[0]
    normal = np.cross(X[1] - X[0], X[2] - X[0])
    normal /= np.linalg.norm(normal)
    first = X[1] - X[0] + 0.3 * (X[2] - X[0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    F = s[0] * np.outer(first, first) + s[1] * np.outer(second, second)
    return X[0] + (X - X[0]) @ (rotation(3, seed) @ F).T


@pytest.mark.usefixtures("uncompiled")
@KINDS
@ALL_LAWS
@pytest.mark.parametrize("state", STRETCHES)
def test_forces_and_exact_hessian(name: str, n_nodes: int, state: str) -> None:
    term, X = one_cell(name, n_nodes)
    x = placed(X, STRETCHES[state], seed=len(state))
    h = 1e-6 if state == "flattened" else 1e-5
    scale = max(MU, float(np.abs(term_gradient(term, x)).max()))
    np.testing.assert_allclose(term_gradient(term, x), difference_gradient(term.value, x, h), atol=1e-8 * scale)
    (K,) = cell_matrices(term, x, False)
    reference = difference_matrix(lambda y: term_gradient(term, y), x, h)
    np.testing.assert_allclose(K, reference, atol=1e-6 * np.abs(reference).max())


@pytest.mark.usefixtures("uncompiled")
@KINDS
@ALL_LAWS
@pytest.mark.parametrize("state", STRETCHES)
def test_projection_clamps_the_eigenvalues_over_deformation_gradients(name: str, n_nodes: int, state: str) -> None:
    """The closed form holds every mode of the Hessian in F, so clamping it is clamping the eigenvalues."""
    law, k = law_of(name), n_nodes - 1
    s0, s1 = STRETCHES[state][0], STRETCHES[state][1] if k == 2 else 1.0
    u, v = rotation(3, seed=1), rotation(3, seed=2)
    Q, exact, projected = np.empty((3, 3)), np.empty((9, 9)), np.empty((9, 9))
    codimensional._tangent(s0, s1, k, u, v, law, False, Q, exact)
    codimensional._tangent(s0, s1, k, u, v, law, True, Q, projected)
    values, vectors = np.linalg.eigh(exact)
    clamped = (vectors * np.maximum(values, 0.0)) @ vectors.T
    np.testing.assert_allclose(projected, clamped, atol=1e-10 * np.abs(values).max())
    if state == "compression":
        # Out of the plane, or across the rod, a compressed cell has negative stiffness.
        assert values.min() < -1e-3 * np.abs(values).max()


@pytest.mark.usefixtures("uncompiled")
@KINDS
@ALL_LAWS
def test_projected_cells_are_positive(name: str, n_nodes: int) -> None:
    term, X = one_cell(name, n_nodes)
    for state, s in STRETCHES.items():
        x = placed(X, s, seed=3)
        (exact,), (projected,) = cell_matrices(term, x, False), cell_matrices(term, x, True)
        scale = np.abs(projected).max()
        assert np.linalg.eigvalsh(projected).min() > -1e-12 * scale, state
        assert np.linalg.eigvalsh(projected - exact).min() > -1e-10 * scale, state


@pytest.mark.usefixtures("uncompiled")
@KINDS
@ALL_LAWS
def test_energy_is_that_of_the_law_with_the_thickness_kept(name: str, n_nodes: int) -> None:
    term, X = one_cell(name, n_nodes)
    x = placed(X, (1.4, 0.7), seed=6)
    s1 = 0.7 if n_nodes == 3 else 1.0
    F = (1.4, 0.0, 0.0, 0.0, s1, 0.0, 0.0, 0.0, 1.0)
    assert term.value(x) == pytest.approx(0.7 * dispatch.energy_density(F, law_of(name)), rel=1e-12)
    # Turning and shifting it changes nothing but the direction of the forces.
    R = rotation(3, seed=9)
    turned = x @ R.T + 2.0
    assert term.value(turned) == pytest.approx(term.value(x), rel=1e-12)
    np.testing.assert_allclose(term_gradient(term, turned), term_gradient(term, x) @ R.T, atol=1e-13)
    np.testing.assert_allclose(term_gradient(term, x).sum(axis=0), 0.0, atol=1e-14)


@pytest.mark.usefixtures("uncompiled")
@pytest.mark.parametrize("name", [n for n in CODIMENSIONAL if n != "logarithmic_neo_hookean"])
@KINDS
def test_collapsed_cells_stay_finite(name: str, n_nodes: int) -> None:
    term, X = one_cell(name, n_nodes)
    point = np.tile(X[0], (n_nodes, 1))
    line = np.outer(np.arange(n_nodes), [1.0, 2.0, 0.5]) if n_nodes == 3 else point
    for x in (point, line):
        assert np.isfinite(term.value(x))
        assert np.isfinite(term_gradient(term, x)).all()
        for project in (False, True):
            assert np.isfinite(cell_matrices(term, x, project)).all()


@ALL_LAWS
def test_small_strain_moduli(name: str) -> None:
    """The thickness is frozen, so this is plane strain across it, not plane stress."""
    psi, A, _, _ = dispatch.stretch_derivatives((1.0, 1.0, 1.0), law_of(name))
    lmbda = 0.0 if name == "arap" else LMBDA
    assert A[0] == pytest.approx(lmbda + 2.0 * MU, rel=1e-12)  # a rod, or a membrane held across
    assert A[5] == pytest.approx(lmbda, rel=1e-12)
    assert psi[0] == pytest.approx(0.0, abs=1e-14)


def test_linear_elasticity_is_refused() -> None:
    assert not supports_codimension(law_of("linear"))
    assert all(supports_codimension(law_of(name)) for name in CODIMENSIONAL)


def test_compiled_loops_agree_with_the_uncompiled_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    cloth = {"recipe": "cloth", "size": [1.0, 1.0], "cells": [2, 2]}
    rod = {"recipe": "rod", "cells": 3}
    stuff = material(E=10.0, nu=0.35)
    simulation = build(
        scene(
            {
                "cloth": body(cloth, stuff, kind="membrane", thickness=0.1),
                "rod": body(rod, stuff, kind="rod", cross_section=0.1),
            }
        )
    )
    points = simulation.discretization.points
    x = 0.8 * points + 0.05 * np.random.default_rng(0).standard_normal(points.shape)
    for term in simulation.problem.elastic:
        results = [(term.value(x), term_gradient(term, x), cell_matrices(term, x, True), cell_matrices(term, x, False))]
        with monkeypatch.context() as patch:
            for name in ("cell_energies", "cell_forces", "cell_hessians"):
                patch.setattr(term._kernels, name, getattr(codimensional, name).py_func)
            patch.setattr(codimensional, "_tangent", codimensional._tangent.py_func)
            patch.setattr(codimensional, "_add_mode", codimensional._add_mode.py_func)
            results.append(
                (term.value(x), term_gradient(term, x), cell_matrices(term, x, True), cell_matrices(term, x, False))
            )
        for compiled, plain in zip(*results, strict=True):
            np.testing.assert_allclose(compiled, plain, atol=1e-12 * np.abs(plain).max())
        assert results[0][0] > 0.0
