"""Every law against finite differences, invariance, linear elasticity and closed forms, in 2D and 3D."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import lambertw

from femdeform.materials import LAWS, batch, dispatch, lame_parameters, law_class
from femdeform.materials.dispatch import Law

Array = NDArray[np.float64]

MU, LMBDA = lame_parameters(1.0, 0.3)
NAMES = tuple(LAWS)
ISOTROPIC = tuple(name for name in NAMES if name != "linear")
POLAR = ("arap", "corotated", "fixed_corotated")

ALL_LAWS = pytest.mark.parametrize("name", NAMES)
ISOTROPIC_LAWS = pytest.mark.parametrize("name", ISOTROPIC)
BOTH_DIMENSIONS = pytest.mark.parametrize("dim", [2, 3])


def law_of(name: str, dim: int, mu: float = MU, lmbda: float = LMBDA) -> Law:
    return law_class(name).from_lame(mu, lmbda, dim)


def rotations(n: int, dim: int, rng: np.random.Generator) -> Array:
    Q, R = np.linalg.qr(rng.standard_normal((n, dim, dim)))
    Q *= np.sign(np.einsum("eii->ei", R))[:, None, :]
    Q[:, :, -1] *= np.linalg.det(Q)[:, None]
    return Q


STRETCHES_3D = {
    "stretched": [(1.8, 1.4, 1.1), (2.5, 1.0, 0.9)],
    "compressed": [(0.9, 0.6, 0.3), (0.5, 0.4, 0.3)],
    "mixed": [(2.0, 0.8, 0.4), (1.3, 1.1, 0.7)],
    "repeated": [(1.0, 1.0, 1.0), (1.4, 1.4, 1.4), (1.5, 0.8, 0.8), (1.5, 1.5, 0.6), (1.2, 1.2 - 1e-9, 0.7)],
    "nearly rest": [(1.0 + 1e-5, 1.0, 1.0 - 1e-5)],
    "singular": [(1.3, 0.7, 0.0), (1.2, 1.2, 0.0)],
    "inverted": [(1.2, 0.9, -0.5), (0.8, 0.7, -0.3), (1.5, 0.7, -0.1), (1.1, 1.1, -0.4)],
    "rank one": [(1.3, 0.0, 0.0)],
    "zero": [(0.0, 0.0, 0.0)],
}


def states(name: str, dim: int) -> Array:
    """Deformation gradients (n, dim, dim) of every kind the law is defined and smooth at."""
    rng = np.random.default_rng(7)
    stretches = []
    for kind, listed in STRETCHES_3D.items():
        if name == "logarithmic_neo_hookean" and kind in ("singular", "inverted", "rank one", "zero"):
            continue
        # The polar rotation jumps where the two smallest signed stretches add up to 0.
        if name in POLAR and kind in ("rank one", "zero"):
            continue
        stretches += [s if dim == 3 else (s[0], s[2]) for s in listed]
    s = np.repeat(np.array(stretches), 2, axis=0)
    U, V = rotations(len(s), dim, rng), rotations(len(s), dim, rng)
    F = np.einsum("eij,ej,ekj->eik", U, s, V)
    F[::2] = np.einsum("ei,ij->eij", s[::2], np.eye(dim))  # once without rotations, once with
    return F


def random_states(n: int, dim: int, positive: bool, amplitude: float = 0.4) -> Array:
    rng = np.random.default_rng(3)
    F = np.eye(dim) + amplitude * rng.standard_normal((n, dim, dim))
    return F[np.linalg.det(F) > 0.05] if positive else F


def central_difference(function: Callable[[Array], Array], F: Array, step: float) -> Array:
    """Return d function / dF with the two indices of F appended."""
    dim = F.shape[1]
    columns = []
    for a in range(dim):
        for b in range(dim):
            D = np.zeros((dim, dim))
            D[a, b] = step
            columns.append((function(F + D) - function(F - D)) / (2.0 * step))
    result = np.stack(columns, axis=-1)
    return result.reshape(*result.shape[:-1], dim, dim)


def as_matrices(H: Array) -> Array:
    size = H.shape[1] ** 2
    return H.reshape(-1, size, size)


def clamped(H: Array) -> Array:
    w, Q = np.linalg.eigh(as_matrices(H))
    return np.einsum("eik,ek,ejk->eij", Q, np.maximum(w, 0.0), Q)


def linear_tangent(mu: float, lmbda: float, dim: int) -> Array:
    d = np.eye(dim)
    return (
        mu * (np.einsum("ac,bd->abcd", d, d) + np.einsum("ad,bc->abcd", d, d))
        + lmbda * np.einsum("ab,cd->abcd", d, d)
    )  # fmt: skip


# ---------------------------------------------------------------------------------------- derivatives


@ALL_LAWS
@BOTH_DIMENSIONS
def test_stress_is_the_derivative_of_the_energy(name: str, dim: int) -> None:
    law, F = law_of(name, dim), states(name, dim)
    P = batch.pk1(F, law)
    reference = central_difference(lambda G: batch.energy_density(G, law), F, 1e-5)
    scale = np.maximum(MU, np.abs(P).max(axis=(1, 2)))[:, None, None]
    np.testing.assert_allclose(P / scale, reference / scale, rtol=0.0, atol=1e-6)


@ALL_LAWS
@BOTH_DIMENSIONS
def test_tangent_is_the_derivative_of_the_stress(name: str, dim: int) -> None:
    law, F = law_of(name, dim), states(name, dim)
    H = as_matrices(batch.tangent(F, law))
    reference = as_matrices(central_difference(lambda G: batch.pk1(G, law), F, 1e-6))
    scale = np.maximum(MU, np.abs(H).max(axis=(1, 2)))[:, None, None]
    np.testing.assert_allclose(H / scale, reference / scale, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(H / scale, np.swapaxes(H, 1, 2) / scale, rtol=0.0, atol=1e-14)


@ALL_LAWS
@BOTH_DIMENSIONS
@pytest.mark.parametrize("nu", [-0.3, 0.0, 0.3, 0.49])
def test_projection_clamps_the_negative_eigenvalues(name: str, dim: int, nu: float) -> None:
    mu, lmbda = lame_parameters(1.0, nu)
    law = law_of(name, dim, mu, lmbda)
    positive = name == "logarithmic_neo_hookean"
    F = np.concatenate(
        [
            states(name, dim),
            random_states(500, dim, positive),
            random_states(500, dim, positive, amplitude=0.05),
        ]
    )
    exact = batch.tangent(F, law)
    projected = as_matrices(batch.tangent(F, law, projected=True))
    scale = np.maximum(mu, np.abs(as_matrices(exact)).max(axis=(1, 2)))
    error = np.abs(projected - clamped(exact)).max(axis=(1, 2)) / scale
    assert error.max() < 1e-6
    smallest = np.linalg.eigvalsh(projected)[:, 0] / scale
    assert smallest.min() > -1e-13
    if name != "linear":
        indefinite = np.linalg.eigvalsh(as_matrices(exact))[:, 0] / scale < -1e-6
        assert 0.05 < indefinite.mean() < 1.0, "both the projected and the unprojected branch must be met"


# ---------------------------------------------------------------------------------------- at rest


@ALL_LAWS
@BOTH_DIMENSIONS
def test_rest_state_is_that_of_linear_elasticity(name: str, dim: int) -> None:
    law = law_of(name, dim)
    rest = np.eye(dim)[None]
    assert batch.energy_density(rest, law)[0] == 0.0
    np.testing.assert_allclose(batch.pk1(rest, law), 0.0, rtol=0.0, atol=1e-15)
    expected = linear_tangent(MU, 0.0 if name == "arap" else LMBDA, dim)
    for projected in (False, True):
        np.testing.assert_allclose(batch.tangent(rest, law, projected)[0], expected, rtol=0.0, atol=1e-14)


@ALL_LAWS
@BOTH_DIMENSIONS
def test_energy_keeps_its_accuracy_near_rest(name: str, dim: int) -> None:
    # At a strain of 1e-6 the energy is 1e-12 of the moduli: formed from |F|^2 - d it would have four digits.
    law = law_of(name, dim)
    D = 1e-6 * random_states(20, dim, positive=False)
    D = 0.5 * (D + np.swapaxes(D, 1, 2))
    expected = 0.5 * np.einsum("eab,abcd,ecd->e", D, linear_tangent(MU, law.lmbda, dim), D)
    np.testing.assert_allclose(batch.energy_density(np.eye(dim) + D, law), expected, rtol=1e-5)


# ---------------------------------------------------------------------------------------- invariance


@ISOTROPIC_LAWS
@BOTH_DIMENSIONS
def test_objectivity_and_isotropy(name: str, dim: int) -> None:
    law, F = law_of(name, dim), states(name, dim)
    Q = rotations(len(F), dim, np.random.default_rng(1))
    psi, P = batch.energy_density(F, law), batch.pk1(F, law)
    size = 1.0 + np.abs(P).max(axis=(1, 2))
    assert (np.abs(batch.energy_density(Q @ F, law) - psi) / size).max() < 1e-13
    assert (np.abs(batch.energy_density(F @ Q, law) - psi) / size).max() < 1e-13
    assert (np.abs(batch.pk1(Q @ F, law) - Q @ P).max(axis=(1, 2)) / size).max() < 1e-13
    assert (np.abs(batch.pk1(F @ Q, law) - P @ Q).max(axis=(1, 2)) / size).max() < 1e-13
    for projected in (False, True):
        H = batch.tangent(F, law, projected)
        rotated = np.einsum("eia,eabcd,ekc->eibkd", Q, H, Q)
        error = np.abs(batch.tangent(Q @ F, law, projected) - rotated).max(axis=(1, 2, 3, 4))
        assert (error / np.maximum(MU, np.abs(H).max(axis=(1, 2, 3, 4)))).max() < 1e-12


@BOTH_DIMENSIONS
def test_linear_elasticity_is_not_objective(dim: int) -> None:
    rotated = rotations(1, dim, np.random.default_rng(1))
    assert batch.energy_density(rotated, law_of("linear", dim))[0] > 1e-2 * MU


@ALL_LAWS
def test_plane_strain_is_the_law_in_space(name: str) -> None:
    F2 = random_states(200, 2, positive=True)
    F3 = np.zeros((len(F2), 3, 3))
    F3[:, :2, :2], F3[:, 2, 2] = F2, 1.0
    flat, space = law_of(name, 2), law_of(name, 3)
    energy = batch.energy_density(F2, flat) - batch.energy_density(F3, space)
    stress = batch.pk1(F2, flat) - batch.pk1(F3, space)[:, :2, :2]
    tangent = batch.tangent(F2, flat) - batch.tangent(F3, space)[:, :2, :2, :2, :2]
    if name == "stable_neo_hookean":
        # The invariant |F|^2 + 1 of the law counts the dimensions: the 2D law is another one away from rest.
        assert np.abs(energy).max() > 1e-3
        return
    size = 1.0 + np.abs(batch.tangent(F2, flat)).max(axis=(1, 2, 3, 4))
    assert (np.abs(energy) / size).max() < 1e-14
    assert (np.abs(stress).max(axis=(1, 2)) / size).max() < 1e-13
    assert (np.abs(tangent).max(axis=(1, 2, 3, 4)) / size).max() < 1e-12


# ---------------------------------------------------------------------------------------- closed forms


def uniaxial(law: Law, stretch: float) -> tuple[float, float]:
    """Return lateral stretch and axial stress of a bar free to contract."""

    def stress(lateral: float) -> Array:
        result: Array = batch.pk1(np.diag([stretch, lateral, lateral])[None], law)[0]
        return result

    lateral = brentq(lambda b: stress(b)[1, 1], 0.3, 1.5, xtol=1e-15, rtol=1e-14)
    return lateral, stress(lateral)[0, 0]


def expected_uniaxial(name: str, a: float, E: float, nu: float) -> tuple[float, float]:
    """Return the same from the one-dimensional equilibrium of each law, written out by hand."""
    mu, lam = lame_parameters(E, nu)
    if name == "arap":
        return 1.0, 2.0 * mu * (a - 1.0)
    if name in ("linear", "corotated"):
        return 1.0 - nu * (a - 1.0), E * (a - 1.0)
    if name == "saint_venant_kirchhoff":
        return np.sqrt(1.0 - nu * (a * a - 1.0)), 0.5 * E * a * (a * a - 1.0)
    if name == "neo_hookean":
        b2 = (1.0 + mu / (lam + mu) * (1.0 - 1.0 / a)) / a
        return np.sqrt(b2), mu * (a - b2 / a)
    if name == "logarithmic_neo_hookean":
        J = lam / mu * np.real(lambertw(mu / lam * np.exp(mu / lam) / a))
        return np.sqrt(J), mu * (a - J / a)
    if name == "fixed_corotated":
        # 2 mu (b - 1) + lam (a b^2 - 1) a b = 0
        b = max(np.roots([lam * a * a, 0.0, 2.0 * mu - lam * a, -2.0 * mu]).real)
        return b, 2.0 * mu * (a - 1.0) + lam * (a * b * b - 1.0) * b * b
    # stable neo-Hookean: with q = b^2, m(q) + lam' (a q - alpha) a = 0, quadratic in q after clearing I + 1.
    mu_c, lam_c = 4.0 / 3.0 * mu, lam + 5.0 / 6.0 * mu
    alpha = 1.0 + 0.75 * mu_c / lam_c
    # mu_c (c + 2 q - 1) + lam_c a (a q - alpha) (c + 2 q) = 0 with c = a^2 + 1
    c = a * a + 1.0
    q = max(
        np.roots(
            [
                2.0 * lam_c * a * a,
                2.0 * mu_c + lam_c * a * (a * c - 2.0 * alpha),
                mu_c * (c - 1.0) - lam_c * a * alpha * c,
            ]
        ).real
    )
    m = mu_c * (1.0 - 1.0 / (c + 2.0 * q))
    return np.sqrt(q), m * a + lam_c * (a * q - alpha) * q


@ALL_LAWS
@pytest.mark.parametrize("stretch", [0.8, 1.0, 1.2, 1.5])
def test_uniaxial_stretch_against_the_closed_form(name: str, stretch: float) -> None:
    E, nu = 1.0e5, 0.45
    lateral, stress = uniaxial(law_of(name, 3, *lame_parameters(E, nu)), stretch)
    b, P11 = expected_uniaxial(name, stretch, E, nu)
    assert lateral == pytest.approx(b, abs=1e-8)
    assert stress == pytest.approx(P11, rel=1e-8, abs=1e-8 * E)


@pytest.mark.parametrize(
    ("name", "b", "P11"),
    [
        ("arap", 1.0, 0.344828),
        ("corotated", 0.775, 0.5),
        ("fixed_corotated", 0.828888, 0.410038),
        ("neo_hookean", 0.829993, 0.358876),
        ("logarithmic_neo_hookean", 0.830679, 0.358614),
        ("stable_neo_hookean", 0.828994, 0.375428),
    ],
)
def test_uniaxial_stretch_against_tabulated_values(name: str, b: float, P11: float) -> None:
    lateral, stress = uniaxial(law_of(name, 3, *lame_parameters(1.0, 0.45)), 1.5)
    assert lateral == pytest.approx(b, abs=5e-7)
    assert stress == pytest.approx(P11, abs=5e-7)


# ---------------------------------------------------------------------------------------- in stretches


@ISOTROPIC_LAWS
@BOTH_DIMENSIONS
def test_stretch_functions_agree_with_those_of_F(name: str, dim: int) -> None:
    law = law_of(name, dim)
    kinds = ("stretched", "compressed", "mixed", "repeated", "nearly rest")
    listed = [s[:dim] for kind in kinds for s in STRETCHES_3D[kind]] + [
        (1.4, 1.0, 1.0)[:dim],
        (0.6, 1.2, 1.0)[:dim],
    ]
    if name != "logarithmic_neo_hookean":
        listed += [(1.2, 0.9, -0.5)[3 - dim :]]
    pairs = [(1, 2), (2, 0), (0, 1)] if dim == 3 else [(0, 1)]
    for s in listed:
        F = np.diag(s)[None]
        assert dispatch.energy_from_stretches(s, law) == pytest.approx(batch.energy_density(F, law)[0], abs=1e-14)
        gradient, hessian, twist, flip = dispatch.stretch_derivatives(s, law)
        P, H = batch.pk1(F, law)[0], batch.tangent(F, law)[0]
        np.testing.assert_allclose(gradient, np.diag(P), rtol=0.0, atol=1e-13)
        own = [H[i, i, i, i] for i in range(dim)]
        across = [H[i, i, j, j] for i, j in pairs]
        np.testing.assert_allclose(hessian, [*own, *across], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(twist, [H[i, j, i, j] - H[i, j, j, i] for i, j in pairs], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(flip, [H[i, j, i, j] + H[i, j, j, i] for i, j in pairs], rtol=1e-12, atol=1e-12)


@ISOTROPIC_LAWS
def test_twist_and_flip_are_the_quotients_they_stand_for(name: str) -> None:
    s = (1.7, 1.1, 0.6)
    gradient, _, twist, flip = dispatch.stretch_derivatives(s, law_of(name, 3))
    for k, (i, j) in enumerate([(1, 2), (2, 0), (0, 1)]):
        assert twist[k] == pytest.approx((gradient[i] + gradient[j]) / (s[i] + s[j]), rel=1e-12, abs=1e-14)
        assert flip[k] == pytest.approx((gradient[i] - gradient[j]) / (s[i] - s[j]), rel=1e-12, abs=1e-14)


# ---------------------------------------------------------------------------------------- out of bounds


@BOTH_DIMENSIONS
def test_logarithmic_law_refuses_inversion(dim: int) -> None:
    law = law_of("logarithmic_neo_hookean", dim)
    flat, inverted = np.eye(dim), np.eye(dim)
    flat[0, 0], inverted[0, 0] = 0.0, -0.5
    assert np.isposinf(batch.energy_density([flat, inverted], law)).all()
    assert dispatch.energy_from_stretches(tuple(np.diag(inverted)), law) == np.inf
    assert not np.isfinite(batch.pk1([flat, inverted], law)).all(axis=(1, 2)).any()


@ALL_LAWS
@BOTH_DIMENSIONS
def test_nan_comes_out_as_nan(name: str, dim: int) -> None:
    law = law_of(name, dim)
    F = np.tile(np.eye(dim) * 0.8, (dim * dim + 1, 1, 1))
    for k in range(dim * dim):
        F[k].flat[k] = np.nan
    F[-1] = np.nan
    assert np.isnan(batch.energy_density(F, law)).all()
    assert np.isnan(batch.pk1(F, law)).any(axis=(1, 2)).all()
    if name != "linear":  # whose tangent does not depend on F
        for projected in (False, True):
            assert np.isnan(batch.tangent(F, law, projected)).any(axis=(1, 2, 3, 4)).all()


@pytest.mark.parametrize("name", ["saint_venant_kirchhoff", "fixed_corotated", "neo_hookean"])
def test_single_precision_is_close(name: str) -> None:
    law = law_of(name, 3)
    F = random_states(200, 3, positive=False)
    single = F.astype(np.float32)
    for function in (batch.energy_density, batch.pk1, batch.tangent):
        result, expected = function(single, law), function(single.astype(np.float64), law)
        assert result.dtype == np.float32
        axes = tuple(range(1, expected.ndim))
        size = 1.0 + np.abs(expected).max(axis=axes, keepdims=True)
        assert (np.abs(result - expected) / size).max() < 2e-5
