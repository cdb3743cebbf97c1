"""The law of muscle fibres: curves, continuity at the joints, stress and tangent against finite differences."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.materials.muscle_fibre import (
    MuscleFibre,
    energy_density,
    fibre_derivatives,
    fibre_energy,
    pk1,
    tangent,
)

Array = NDArray[np.float64]

FIBRES = {
    "passive": MuscleFibre(3.0, 1.2, 0.0),
    "half": MuscleFibre(3.0, 1.2, 0.5),
    "active": MuscleFibre(2.0, 0.9, 1.0),
}
JOINTS = (0.4, 0.6, 1.0, 1.4, 1.6)
ALL = pytest.mark.parametrize("fibre", FIBRES.values(), ids=FIBRES)
DIMS = pytest.mark.parametrize("dim", [2, 3])


def gradients(dim: int, fibre: MuscleFibre, n: int = 60) -> tuple[Array, Array, Array]:
    """F, v and q, stretches of fibres from 0.2 l_o to 1.9 l_o but away from the joints."""
    rng = np.random.default_rng(7)
    v = rng.normal(size=(n, dim))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    F = rng.normal(size=(n, dim, dim))
    q = np.linspace(0.2, 1.9, n)
    nearest = np.min(np.abs(q[:, None] - np.array(JOINTS)), axis=1)
    q = np.where(nearest < 1e-3, q + 2e-3, q)
    F *= (q * fibre.optimal_stretch / np.linalg.norm(np.einsum("nij,nj->ni", F, v), axis=1))[:, None, None]
    return F, v, q


@DIMS
@ALL
def test_stress_is_derivative_of_energy(fibre: MuscleFibre, dim: int) -> None:
    F, v, _ = gradients(dim, fibre)
    P, h = pk1(F, v, fibre), 1e-6
    for a, b in itertools.product(range(dim), repeat=2):
        E = np.zeros((dim, dim))
        E[a, b] = h
        difference = (energy_density(F + E, v, fibre) - energy_density(F - E, v, fibre)) / (2.0 * h)
        assert np.allclose(P[:, a, b], difference, rtol=1e-6, atol=1e-7 * fibre.stress)


@DIMS
@ALL
def test_tangent_is_derivative_of_stress(fibre: MuscleFibre, dim: int) -> None:
    F, v, _ = gradients(dim, fibre)
    H, h = tangent(F, v, fibre), 1e-6
    for a, b in itertools.product(range(dim), repeat=2):
        E = np.zeros((dim, dim))
        E[a, b] = h
        difference = (pk1(F + E, v, fibre) - pk1(F - E, v, fibre)) / (2.0 * h)
        assert np.allclose(H[:, :, :, a, b], difference, rtol=1e-5, atol=1e-6 * fibre.stress)


@DIMS
@ALL
def test_projection_is_that_by_eigenvalues(fibre: MuscleFibre, dim: int) -> None:
    F, v, q = gradients(dim, fibre)
    n = dim * dim
    H = tangent(F, v, fibre).reshape(-1, n, n)
    values, vectors = np.linalg.eigh(H)
    clamped = np.einsum("nij,nj,nkj->nik", vectors, np.maximum(values, 0.0), vectors)
    projected = tangent(F, v, fibre, projected=True).reshape(-1, n, n)
    assert np.allclose(projected, clamped, atol=1e-12 * np.abs(H).max())
    if fibre.activation == 1.0:  # there is something to project: the descending limb
        assert (values[(q > 1.05) & (q < 1.35), 0] < 0.0).all()
        assert np.abs(projected - H).max() > 0.1 * fibre.stress


@ALL
def test_energy_and_tension_are_continuous(fibre: MuscleFibre) -> None:
    for q in JOINTS:
        below, above = (q - 1e-12) * fibre.optimal_stretch, (q + 1e-12) * fibre.optimal_stretch
        assert abs(fibre_energy(above, fibre) - fibre_energy(below, fibre)) < 1e-10 * fibre.stress
        tensions = [fibre_derivatives(stretch, fibre)[0] for stretch in (below, above)]
        assert abs(tensions[1] - tensions[0]) < 1e-10 * fibre.stress


def test_jumps_of_the_slope_are_the_known_ones() -> None:
    fibre = MuscleFibre(1.0, 1.0, 1.0)
    jumps = {0.4: 0.0, 0.6: -0.4, 1.0: 0.33, 1.4: -0.4, 1.6: 0.0}
    for q, jump in jumps.items():
        slopes = [fibre_derivatives(stretch, fibre)[1] for stretch in (q - 1e-9, q + 1e-9)]
        assert slopes[1] - slopes[0] == pytest.approx(jump, abs=1e-6)


def test_curves_have_blemkers_values() -> None:
    """Active tension peaks at the optimal length; activation leaves the passive part alone."""
    stress, optimal = 3.0e5, 1.4
    passive, active = MuscleFibre(stress, optimal, 0.0), MuscleFibre(stress, optimal, 1.0)
    for q, curve in {0.3: 0.0, 0.5: 0.09, 0.8: 0.84, 1.0: 1.0, 1.2: 0.84, 1.5: 0.09, 1.7: 0.0}.items():
        difference = fibre_derivatives(q * optimal, active)[0] - fibre_derivatives(q * optimal, passive)[0]
        assert difference == pytest.approx(stress / optimal * curve, abs=1e-9 * stress)
    assert fibre_derivatives(0.9 * optimal, passive)[0] == 0.0
    assert fibre_derivatives(1.4 * optimal, passive)[0] == pytest.approx(
        stress / optimal * 0.05 * (np.exp(6.6 * 0.4) - 1.0)
    )
    # True stress of active fibres of optimal length, the volume kept: l dPsi/dl.
    assert optimal * fibre_derivatives(optimal, active)[0] == pytest.approx(stress)


@ALL
def test_objective(fibre: MuscleFibre) -> None:
    F, v, _ = gradients(3, fibre)
    Q, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    assert np.allclose(energy_density(Q @ F, v, fibre), energy_density(F, v, fibre), rtol=1e-12)
    assert np.allclose(pk1(Q @ F, v, fibre), Q @ pk1(F, v, fibre), atol=1e-12 * fibre.stress)


def test_no_length_no_force() -> None:
    fibre = FIBRES["active"]
    F, v = np.zeros((1, 3, 3)), np.array([[1.0, 0.0, 0.0]])
    assert not pk1(F, v, fibre).any()
    assert not tangent(F, v, fibre).any()
    assert energy_density(F, v, fibre)[0] == 0.0


def test_shapes_are_checked() -> None:
    with pytest.raises(ValueError, match="shapes"):
        pk1(np.eye(3)[None], np.array([[1.0, 0.0]]), FIBRES["active"])
