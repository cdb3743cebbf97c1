"""Decompositions of 2x2 and 3x3 matrices, on the matrices that break naive ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from femdeform.jit import njit, prange
from femdeform.materials import small_matrix as sm
from femdeform.materials.batch import load_3d

Array = NDArray[np.float64]

entry = st.floats(-4.0, 4.0, allow_nan=False)
# Entries that make repeated, vanishing and nearly equal singular values likely.
coarse = st.sampled_from([-2.0, -1.0, 0.0, 1.0, 1.0 + 1e-15, 1.0 + 1e-8, 1e-8, 1e-16, 3.0])
# Norm below which the squares of squares underflow, and errors are absolute.
TINY = 1e-60
scale = st.sampled_from([1.0, 1e-12, 1e12])


def matrices(size: int) -> st.SearchStrategy[tuple[float, ...]]:
    tuples = st.one_of(st.tuples(*[entry] * size), st.tuples(*[coarse] * size))
    return st.builds(lambda values, factor: tuple(factor * value for value in values), tuples, scale)


def check_svd(F: Array, U: Array, s: Array, V: Array) -> None:
    dim = len(s)
    size = max(float(np.linalg.norm(F)), TINY)
    assert np.abs(U @ np.diag(s) @ V.T - F).max() <= 1e-14 * size
    for Q in (U, V):
        assert np.abs(Q.T @ Q - np.eye(dim)).max() <= 1e-14
        assert np.linalg.det(Q) == pytest.approx(1.0, abs=1e-13)
    assert np.all(s[:-1] >= -1e-14 * size)
    assert all(s[i] >= abs(s[i + 1]) - 1e-14 * size for i in range(dim - 1))
    np.testing.assert_allclose(np.abs(s), np.linalg.svd(F, compute_uv=False), rtol=0.0, atol=2e-14 * size)


def tuple_of(F: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in F.ravel())


@settings(max_examples=300, deadline=None)
@given(matrices(9))
@example((0.0,) * 9)
@example((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
@example((-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0))
@example((1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
@example((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -3.0))
@example((0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
def test_signed_svd_3d(values: tuple[float, ...]) -> None:
    F = np.array(values).reshape(3, 3)
    U, s, V = (np.array(part) for part in sm.signed_svd_3d(values))
    check_svd(F, U.reshape(3, 3), s, V.reshape(3, 3))
    R = np.array(sm.polar_rotation_3d(values)).reshape(3, 3)
    np.testing.assert_allclose(R, U.reshape(3, 3) @ V.reshape(3, 3).T, rtol=0.0, atol=2e-15)


@settings(max_examples=300, deadline=None)
@given(matrices(4))
@example((0.0,) * 4)
@example((1.0, 0.0, 0.0, -1.0))
@example((0.0, 1.0, 1.0, 0.0))
@example((0.0, -1.0, 1.0, 0.0))
def test_signed_svd_2d(values: tuple[float, ...]) -> None:
    F = np.array(values).reshape(2, 2)
    U, s, V = (np.array(part) for part in sm.signed_svd_2d(values))
    check_svd(F, U.reshape(2, 2), s, V.reshape(2, 2))
    R, trace = sm.rotation_and_trace_2d(values)
    size = max(1.0, float(np.linalg.norm(F)))
    assert trace == pytest.approx(s.sum() - 2.0, abs=1e-14 * size)
    S = np.array(R).reshape(2, 2).T @ F
    assert np.abs(S - S.T).max() <= 1e-14 * size


@njit(parallel=True)
def _svds(F: Array, U: Array, s: Array, V: Array) -> None:
    for e in prange(F.shape[0]):
        u, t, v = sm.signed_svd_3d(load_3d(F, e))
        for i in range(9):
            U[e, i] = u[i]
            V[e, i] = v[i]
        for i in range(3):
            s[e, i] = t[i]


def test_signed_svd_3d_on_many_matrices_of_prescribed_singular_values() -> None:
    rng = np.random.default_rng(0)
    n = 2000
    exponents = rng.uniform(-16.0, 0.0, (n, 3))
    families = [
        10.0**exponents,
        1.0 + 10.0**exponents,
        np.tile([2.0, 1.0, 1.0], (n, 1)),
        np.tile([2.0, 2.0, -1.0], (n, 1)),
        np.tile([1.0, 1e-9, 0.0], (n, 1)),
        np.tile([1.0, 1e-15, -1e-15], (n, 1)),
    ]
    Q = np.linalg.qr(rng.standard_normal((2, n, 3, 3)))[0]
    for wanted in families:
        F = np.einsum("eij,ej,ekj->eik", Q[0], wanted, Q[1])
        U, s, V = np.empty((n, 9)), np.empty((n, 3)), np.empty((n, 9))
        _svds(F.reshape(n, 9), U, s, V)
        U, V = U.reshape(n, 3, 3), V.reshape(n, 3, 3)
        size = np.linalg.norm(F, axis=(1, 2))
        assert (np.abs(np.einsum("eij,ej,ekj->eik", U, s, V) - F).max(axis=(1, 2)) / size).max() < 5e-15
        for W in (U, V):
            assert np.abs(np.einsum("eij,eik->ejk", W, W) - np.eye(3)).max() < 5e-15
            assert np.abs(np.linalg.det(W) - 1.0).max() < 5e-15
        given_values = -np.sort(-np.abs(wanted), axis=1)
        assert (np.abs(np.abs(s) - given_values) / size[:, None]).max() < 5e-15


@settings(max_examples=300, deadline=None)
@given(matrices(6))
@example((1.0, 1.0, 1.0, 0.0, 0.0, 0.0))
@example((0.0, 0.0, 0.0, 1.0, 1.0, 1.0))
@example((1.0, -1.0, 0.0, 0.0, 0.0, 0.0))
@example((1.2254404673230699, 1.2254404673230699, 1.0, 1.2254404673230699, 1.2254404673230699, 1.2254404673230699))
def test_symmetric_eigen_3d(values: tuple[float, ...]) -> None:
    a, b, c, d, e, f = values
    A = np.array([[a, f, e], [f, b, d], [e, d, c]])
    w, V = (np.array(part) for part in sm.symmetric_eigen_3d(values))
    V = V.reshape(3, 3)
    size = max(float(np.linalg.norm(A)), TINY)
    assert np.abs(V @ np.diag(w) @ V.T - A).max() <= 1e-14 * size
    assert np.abs(V.T @ V - np.eye(3)).max() <= 1e-14
    # LAPACK itself gives 8 digits next to an entry of 1e-159.
    expected = np.linalg.eigvalsh(np.where(np.abs(A) < 1e-100, 0.0, A))[::-1]
    np.testing.assert_allclose(w, expected, rtol=0.0, atol=1e-14 * size)

    a, b, c, d, e, f = sm.clamp_symmetric_3d(values)
    closest = V @ np.diag(np.maximum(w, 0.0)) @ V.T
    np.testing.assert_allclose([[a, f, e], [f, b, d], [e, d, c]], closest, rtol=0.0, atol=1e-14 * size)


@settings(max_examples=300, deadline=None)
@given(matrices(3))
@example((1.0, 1.0, 0.0))
@example((0.0, 0.0, -1.0))
@example((-1.0, 2.0, 0.0))
def test_symmetric_eigen_2d(values: tuple[float, ...]) -> None:
    a, b, c = values
    A = np.array([[a, c], [c, b]])
    w, V = (np.array(part) for part in sm.symmetric_eigen_2d(values))
    V = V.reshape(2, 2)
    size = max(float(np.linalg.norm(A)), TINY)
    assert np.abs(V @ np.diag(w) @ V.T - A).max() <= 1e-14 * size
    np.testing.assert_allclose(w, np.linalg.eigvalsh(A)[::-1], rtol=0.0, atol=1e-14 * size)
    a, b, c = sm.clamp_symmetric_2d(values)
    closest = V @ np.diag(np.maximum(w, 0.0)) @ V.T
    np.testing.assert_allclose([[a, c], [c, b]], closest, rtol=0.0, atol=1e-14 * size)


@settings(max_examples=100, deadline=None)
@given(st.tuples(*[entry] * 9), st.tuples(*[entry] * 9))
def test_products_and_determinants_3d(left: tuple[float, ...], right: tuple[float, ...]) -> None:
    A, B = np.array(left).reshape(3, 3), np.array(right).reshape(3, 3)
    np.testing.assert_allclose(np.reshape(sm.multiply_3d(left, right), (3, 3)), A @ B, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(np.reshape(sm.transpose_3d(left), (3, 3)), A.T)
    J, C = sm.det_3d(left), np.reshape(sm.cofactor_3d(left), (3, 3))
    np.testing.assert_allclose(J, np.linalg.det(A), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(A.T @ C, J * np.eye(3), rtol=0.0, atol=1e-12)
    x, square, rest = sm.strain_invariants_3d(left)
    D = A - np.eye(3)
    assert x == pytest.approx(J - 1.0, abs=1e-12)
    assert square == pytest.approx(np.sum(D * D), abs=1e-12)
    assert square - 2.0 * rest == pytest.approx(sm.squared_norm_3d(left) - 3.0 - 2.0 * x, abs=1e-11)


@settings(max_examples=100, deadline=None)
@given(st.tuples(*[entry] * 4), st.tuples(*[entry] * 4))
def test_products_and_determinants_2d(left: tuple[float, ...], right: tuple[float, ...]) -> None:
    A, B = np.array(left).reshape(2, 2), np.array(right).reshape(2, 2)
    np.testing.assert_allclose(np.reshape(sm.multiply_2d(left, right), (2, 2)), A @ B, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(np.reshape(sm.transpose_2d(left), (2, 2)), A.T)
    J, C = sm.det_2d(left), np.reshape(sm.cofactor_2d(left), (2, 2))
    np.testing.assert_allclose(A.T @ C, J * np.eye(2), rtol=0.0, atol=1e-13)
    x, square, rest = sm.strain_invariants_2d(left)
    assert x == pytest.approx(J - 1.0, abs=1e-13)
    assert square - 2.0 * rest == pytest.approx(sm.squared_norm_2d(left) - 2.0 - 2.0 * x, abs=1e-12)


def test_volume_change_does_not_cancel_near_rest() -> None:
    t = 3e-13
    x, _, _ = sm.strain_invariants_3d((1.0 + t, 0.0, 0.0, 0.0, 1.0 + t, 0.0, 0.0, 0.0, 1.0 + t))
    exact = 3.0 * ((1.0 + t) - 1.0)  # the strain that 1 + t really holds
    assert x == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("position", range(9))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_not_a_number_ends_and_stays_one_3d(position: int, value: float) -> None:
    F = [0.9, 0.1, 0.0, 0.0, 0.8, 0.2, 0.1, 0.0, 1.1]
    F[position] = value
    U, s, V = sm.signed_svd_3d(tuple(F))
    assert all(math.isnan(part) for part in s)
    assert any(math.isnan(part) for part in (*U, *V))
    w, _ = sm.symmetric_eigen_3d((1.0, math.nan, 2.0, 0.1, 0.2, 0.3))
    assert all(math.isnan(part) for part in w)


@pytest.mark.parametrize("position", range(4))
def test_not_a_number_ends_and_stays_one_2d(position: int) -> None:
    F = [0.9, 0.1, 0.0, 0.8]
    F[position] = math.nan
    _, s, _ = sm.signed_svd_2d(tuple(F))
    assert all(math.isnan(part) for part in s)
