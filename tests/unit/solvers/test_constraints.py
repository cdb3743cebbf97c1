"""Constraints of a cell, the model of its tangent and its closed inverse, against differences and dense algebra."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import svd

from femdeform.jit import njit
from femdeform.materials import LAWS, law_class
from femdeform.materials.dispatch import energy_density, pk1, tangent
from solvers.position_based import cell_algebra, chunk_numbers, chunk_rotations, constraints, piola_kernels

Array = NDArray[np.float64]
MU, LMBDA = 3.0, 7.0


@njit
def shear(F: Any, law: Any, epsilon: Any) -> Any:
    return constraints.shear_constraint(F, constraints.rotation(F), law, epsilon)


@njit
def volume(F: Any, law: Any) -> Any:
    return constraints.volume_constraint(F, law)


@njit
def stiffnesses(law: Any) -> Any:
    return constraints.stiffnesses(law)


@njit
def root(F: Any, law: Any, epsilon: Any) -> Any:
    return constraints.root_constraint(F, law, epsilon)


@njit
def stress(F: Any, law: Any) -> Any:
    return constraints.stress(F, constraints.rotation(F), law)


@njit
def rotation(F: Any) -> Any:
    return constraints.rotation(F)


@njit
def chunk_of_rotations(Fs: Any, law: Any, dim: Any) -> Any:
    """Rotations of up to `CHUNK` matrices, rows of Fs, by way of a chunk's scratch."""
    scratch = chunk_numbers.make_scratch(chunk_rotations.FURTHER)
    for j in range(len(Fs)):
        chunk_numbers.put(0, j, cell_algebra.load(j, Fs, dim), scratch)
    chunk_rotations.rotate(len(Fs), scratch, law, dim)
    out = np.empty_like(Fs)
    for j in range(len(Fs)):
        F = chunk_numbers.get_matrix(0, j, scratch, dim)
        cell_algebra.store(j, chunk_rotations.rotation_of(j, F, scratch, law), out)
    return out


@njit
def model(F: Any, law: Any) -> Any:
    return constraints.stress_model(F, law)


@njit
def model_step(F: Any, P: Any, R: Any, K: Any, s: Any, law: Any) -> Any:
    return piola_kernels.model_step(F, P, R, K, s, law)


@njit
def exact_step(F: Any, P: Any, R: Any, K: Any, s: Any, law: Any, dim: Any) -> Any:
    n = len(dim) * len(dim)
    H, A, r = np.empty((n, n)), np.empty((n, n)), np.empty((2, n))
    return piola_kernels.exact_step(F, P, R, K, s, law, dim, H, A, r)


@njit
def times(A: Any, K: Any) -> Any:
    return cell_algebra.times(A, K)


def make(word: str, dim: int) -> Any:
    return law_class(word).from_lame(MU, LMBDA, dim)


def matrices(dim: int, inverted: bool = True) -> list[Array]:
    rng = np.random.default_rng(3)
    out = [np.eye(dim) + a * rng.standard_normal((dim, dim)) for a in (0.02, 0.2, 0.4) for _ in range(5)]
    found = [F for F in out if np.linalg.det(F) > 0.2]
    if inverted:
        mirrored = found[-1].copy()
        mirrored[:, 0] *= -1.0
        found.append(mirrored)
    return found


def flat(A: Array) -> tuple[float, ...]:
    return tuple(float(a) for a in np.ravel(A))


def closest_rotation(F: Array) -> Array:
    U, _, Vt = svd(F)
    sign = np.ones(len(F))
    sign[-1] = np.sign(np.linalg.det(U @ Vt))
    return np.asarray(U @ np.diag(sign) @ Vt)


def differences(value: Any, F: Array, step: float = 1e-6) -> Array:
    out = np.empty_like(F)
    for index in np.ndindex(F.shape):
        E = np.zeros_like(F)
        E[index] = step
        out[index] = (value(flat(F + E)) - value(flat(F - E))) / (2.0 * step)
    return out


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("word", ["fixed_corotated", "arap", "neo_hookean"])
def test_gradients_of_the_pair_by_differences(word: str, dim: int) -> None:
    law = make(word, dim)
    for F in matrices(dim):
        for value in (lambda F: shear(F, law, 1e-10), lambda F: volume(F, law)):
            C, D = value(flat(F))
            expected = differences(lambda F, value=value: value(F)[0], F)
            np.testing.assert_allclose(np.reshape(D, F.shape), expected, rtol=1e-6, atol=1e-7)
            assert np.isfinite(C)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("word", ["fixed_corotated", "arap", "neo_hookean"])
def test_the_pair_is_the_energy_up_to_a_constant(word: str, dim: int) -> None:
    law = make(word, dim)
    k1, k2 = stiffnesses(law)
    excess = []
    for F in matrices(dim):
        C1, C2 = shear(flat(F), law, 0.0)[0], volume(flat(F), law)[0]
        excess.append(0.5 * (k1 * C1**2 + k2 * C2**2) - energy_density(flat(F), law))
    np.testing.assert_allclose(excess, excess[0], rtol=0.0, atol=1e-12 * (MU + LMBDA))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("word", [word for word in LAWS if word != "linear"])
def test_gradient_of_the_root_by_differences(word: str, dim: int) -> None:
    law = make(word, dim)
    for F in matrices(dim, inverted=False):
        C, D = root(flat(F), law, 1e-10)
        expected = differences(lambda F: root(F, law, 1e-10)[0], F)
        np.testing.assert_allclose(np.reshape(D, F.shape), expected, rtol=1e-6, atol=1e-6)
        assert pytest.approx(energy_density(flat(F), law), rel=1e-9) == 0.5 * MU * (C**2 - 1e-10)


def test_at_rest_the_shear_constraint_has_no_direction() -> None:
    """Neither a division by zero nor a push in the direction of rounding."""
    law = make("fixed_corotated", 3)
    for Q in (np.eye(3), closest_rotation(np.random.default_rng(1).standard_normal((3, 3)))):
        C, D = shear(flat(Q), law, 1e-10)
        assert pytest.approx(1e-5) == C
        assert np.abs(D).max() < 1e-9
    C, D = shear(flat(np.eye(2)), make("arap", 2), 0.0)
    assert C == 0.0
    assert not np.any(D)


@pytest.mark.parametrize("dim", [2, 3])
def test_rotation_is_the_closest_one(dim: int) -> None:
    rng = np.random.default_rng(0)
    Fs = [rng.standard_normal((dim, dim)) for _ in range(300)] + matrices(dim)
    Fs += [Q @ np.diag([1.0, 1.0, 1.0][:dim]) for Q in map(closest_rotation, Fs[:20])]
    Fs += [closest_rotation(F) @ np.diag([5.0, 1e-3, 1e-3][:dim]) for F in Fs[:20]]
    for F in Fs:
        s = np.linalg.svd(F, compute_uv=False)
        gap = s[-2] + np.sign(np.linalg.det(F)) * s[-1]
        if gap > 1e-3 * s[0]:
            np.testing.assert_allclose(
                np.reshape(rotation(flat(F)), F.shape), closest_rotation(F), rtol=0.0, atol=4e-15 * s[0] / gap + 2e-13
            )


@pytest.mark.parametrize("dim", [2, 3])
def test_rotations_of_a_chunk_are_those_of_its_cells(dim: int) -> None:
    """Small strains, which the steps made for all settle, among large ones and mirrored cells, which they do not."""
    rng = np.random.default_rng(2)
    law = make("fixed_corotated", dim)
    Fs = [closest_rotation(rng.standard_normal((dim, dim))) for _ in range(chunk_numbers.CHUNK - 3)]
    Fs = [
        Q @ (np.eye(dim) + a * rng.standard_normal((dim, dim))) for Q, a in zip(Fs, np.linspace(0, 2, 61), strict=True)
    ]
    Fs.append(Fs[0] @ np.diag([50.0, 1.0, 0.5][:dim]))
    Fs.append(Fs[0] @ np.diag([*[1.0, 0.8][: dim - 1], -0.3]))
    given = np.array([F.ravel() for F in Fs])
    for F, R in zip(Fs, chunk_of_rotations(given, law, (0,) * dim), strict=True):
        s = np.linalg.svd(F, compute_uv=False)
        gap = s[-2] + np.sign(np.linalg.det(F)) * s[-1]
        if gap > 1e-3 * s[0]:
            np.testing.assert_allclose(np.reshape(R, F.shape), closest_rotation(F), atol=4e-15 * s[0] / gap + 2e-13)
            np.testing.assert_allclose(R, rotation(flat(F)), rtol=0.0, atol=4e-15 * s[0] / gap + 2e-13)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("word", list(LAWS))
def test_stress_is_that_of_the_law(word: str, dim: int) -> None:
    law = make(word, dim)
    for F in matrices(dim, inverted=word != "logarithmic_neo_hookean"):
        np.testing.assert_allclose(stress(flat(F), law), pk1(flat(F), law), rtol=1e-12, atol=1e-12)


def affine_cell(dim: int) -> tuple[Array, Array, float, Array]:
    """Reference corners, gradients, volume and masses of a random cell."""
    rng = np.random.default_rng(5)
    X = np.concatenate([np.zeros((1, dim)), np.eye(dim)]) + 0.2 * rng.standard_normal((dim + 1, dim))
    edges = (X[1:] - X[0]).T
    V = abs(float(np.linalg.det(edges))) / (2.0 if dim == 2 else 6.0)
    B = np.linalg.inv(edges)
    return X, np.concatenate([-B.sum(axis=0, keepdims=True), B]), V, rng.uniform(0.5, 2.0, dim + 1)


def packed(K: Array) -> tuple[float, ...]:
    if len(K) == 2:
        return (K[0, 0], K[1, 1], K[0, 1])
    return (K[0, 0], K[1, 1], K[2, 2], K[1, 2], K[0, 2], K[0, 1])


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("held", ["nothing", "two corners", "components"])
@pytest.mark.parametrize("word", list(LAWS))
def test_a_step_of_a_cell_is_that_of_the_full_system(word: str, held: str, dim: int, exact: bool) -> None:
    """Against Newton's step on ``m/2 |x - b|^2 + s Psi`` over the free components of all corners, solved densely."""
    law = make(word, dim)
    X, G, V, m = affine_cell(dim)
    s = 0.3 * V
    rng = np.random.default_rng(7)
    F = np.eye(dim) + 0.1 * rng.standard_normal((dim, dim))
    x = X @ F.T + 0.3
    free = np.ones((dim + 1, dim), dtype=bool)
    if held == "two corners":
        free[[0, 2]] = False
    elif held == "components":
        free[0, 0] = free[1, 1] = free[2] = False
    b = np.where(free, x + 0.1 * rng.standard_normal(x.shape), x)
    # Dense: the residual m (x - b) + s P g, the matrix m + s g.C g.
    P = np.reshape(pk1(flat(F), law), F.shape)
    if exact:
        C = np.empty((dim * dim, dim * dim))
        tangent(flat(F), law, True, C)
    else:
        a, c, W = model(flat(F), law)
        C = a * np.eye(dim * dim) + c * np.outer(W, W)
    J = np.einsum("ib,ac->abic", G, np.eye(dim)).reshape(dim * dim, -1)
    matrix = np.diag(np.repeat(m, dim)) + s * J.T @ C @ J
    residual = (m[:, None] * (x - b) + s * G @ P.T).ravel()
    f = free.ravel()
    step = np.zeros(x.size)
    step[f] = -np.linalg.solve(matrix[np.ix_(f, f)], residual[f])
    # In F.
    w = free / m[:, None]
    K = np.einsum("ia,ib,ic->abc", w, G, G)
    if held == "components":
        K_given: Any = tuple(packed(k) for k in K)
    else:
        K_given = packed(K[0])
    R = b.T @ G - F - s * np.reshape(times(flat(P), K_given), F.shape)
    arguments = (flat(F), flat(P), flat(R), K_given, s, law)
    dF, ahead = exact_step(*arguments, (0,) * dim) if exact else model_step(*arguments)
    np.testing.assert_allclose(np.reshape(dF, F.shape), step.reshape(x.shape).T @ G, rtol=0.0, atol=1e-12)
    moved = b - w * (s * G @ np.reshape(ahead, F.shape).T)
    np.testing.assert_allclose(moved - x, step.reshape(x.shape), rtol=0.0, atol=1e-12)


def test_a_step_of_a_free_cell_is_the_published_one() -> None:
    """In the affine basis (b, dF) about the centre of mass, with the Sherman-Morrison inverse and c = h^2 V lambda."""
    law = make("fixed_corotated", 3)
    X, G, V, m = affine_cell(3)
    s = 0.3 * V
    rng = np.random.default_rng(11)
    F = np.eye(3) + 0.2 * rng.standard_normal((3, 3))
    x = X @ F.T
    away = 0.1 * rng.standard_normal((4, 3))
    P = np.reshape(pk1(flat(F), law), (3, 3))
    g = m[:, None] * away + s * G @ P.T
    D = X - (m @ X) / m.sum()
    np.testing.assert_allclose(D.T @ G, np.eye(3), atol=1e-13)
    Gamma = g.T @ D
    inertia = np.einsum("i,ia,ib->ab", m, D, D)
    Z = np.linalg.inv(inertia + 2.0 * MU * s * np.eye(3))
    W = np.reshape(volume(flat(F), law)[1], (3, 3))
    c = s * LMBDA
    expected = -(Gamma @ Z - c * W @ Z * np.sum(W * (Gamma @ Z)) / (1.0 + c * np.sum(W * (W @ Z))))
    K = np.einsum("i,ib,ic->bc", 1.0 / m, G, G)
    R = (x - away).T @ G - F - s * P @ K
    dF, _ = model_step(flat(F), flat(P), flat(R), packed(K), s, law)
    np.testing.assert_allclose(np.reshape(dF, (3, 3)), expected, rtol=0.0, atol=1e-12)
