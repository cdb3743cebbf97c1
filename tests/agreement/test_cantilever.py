"""Cantilevers of verification/cases/cantilever against Timoshenko's beam theory, and the locking of linear elements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from femdeform.run.expectations import check_expectations, mean_displacement
from verification.analytic import RectangularBeam
from verification.norms import observed_rates

E = 2.1e11
LINE_LOAD = 7850.0 * 9.81 * 0.1 * 0.1  # [N/m]
BEAMS = {
    "slender": RectangularBeam(1.0, 0.1, 0.1, E, 0.0),
    "contraction": RectangularBeam(2.0, 0.1, 0.1, E, 0.3),
    "plane-strain": RectangularBeam(1.0, 0.1, 0.1, E, 0.3, plane_strain=True),  # any width
}


@pytest.fixture
def deflection(case: Callable[..., Any], run: Callable[..., Any]) -> Callable[..., float]:
    """Mean deflection of the tip of a case [m]."""

    def of(name: str, *overrides: str) -> float:
        simulation, states = run(*case(f"cantilever/{name}", *overrides))
        wanted = simulation.scene.expect.displacement[0]
        return -mean_displacement(simulation, states[-1], wanted)

    return of


def p1_ratio(deflection: Callable[..., float], nu: float, n: int) -> float:
    """Deflection with linear elements over that of Euler and Bernoulli, n elements across."""
    tip = deflection(
        "locking",
        f"bodies.beam.mesh.cells=[{10 * n}, {n}, {n}]",
        f"bodies.beam.material.poisson_ratio={nu}",
    )
    return tip / RectangularBeam(1.0, 0.1, 0.1, E, nu).bending_deflection(LINE_LOAD)


@pytest.mark.parametrize("name", sorted(BEAMS))
def test_quadratic_elements_agree_with_timoshenko(
    name: str, case: Callable[..., Any], run: Callable[..., Any]
) -> None:
    simulation, states = run(*case(f"cantilever/{name}"))
    theory = -BEAMS[name].tip_deflection(LINE_LOAD)
    assert simulation.scene.expect.displacement[0].value == pytest.approx(theory, rel=1e-5)
    (verdict,) = check_expectations(simulation, states[-1])
    print(f"{name}: {verdict['computed'] / theory:.4f} of Timoshenko")
    assert verdict["computed"] == pytest.approx(theory, rel=0.01)
    assert verdict["passed"]


def test_without_contraction_theory_and_solid_agree_closely(deflection: Callable[..., float]) -> None:
    assert deflection("slender") == pytest.approx(BEAMS["slender"].tip_deflection(LINE_LOAD), rel=1e-3)


def test_shear_is_in_the_theory_and_in_the_solid() -> None:
    """With a height of a tenth of the length, shear adds one per cent: the comparison above would see it missing."""
    beam = BEAMS["slender"]
    ratio = beam.tip_deflection(LINE_LOAD) / beam.bending_deflection(LINE_LOAD)
    assert ratio == pytest.approx(1.008, abs=1e-6)
    assert beam.tip_deflection(tip_force=1.0) == pytest.approx(1.0 / (3.0 * beam.bending_stiffness), rel=0.01)


@pytest.mark.parametrize(
    ("nu", "coarse", "fine"), [(0.0, 0.555, 0.831), (0.3, 0.509, 0.793), (0.45, 0.302, 0.600)]
)
def test_linear_elements_lock_as_much_as_they_should(
    nu: float, coarse: float, fine: float, deflection: Callable[..., float]
) -> None:
    """methods.md, section 6, row 5: Kuhn meshes of 20x2x2 and 40x4x4 cells."""
    ratios = (p1_ratio(deflection, nu, 2), p1_ratio(deflection, nu, 4))
    print(f"nu = {nu}: {ratios[0]:.4f}, {ratios[1]:.4f} of Euler-Bernoulli")
    assert ratios == pytest.approx((coarse, fine), abs=2e-3)


def test_locking_vanishes_under_refinement(deflection: Callable[..., float]) -> None:
    counts = (2, 4, 8)
    limit = deflection("locking", "bodies.beam.element_order=2", "bodies.beam.mesh.cells=[40, 4, 4]")
    limit /= RectangularBeam(1.0, 0.1, 0.1, E, 0.3).bending_deflection(LINE_LOAD)
    assert limit == pytest.approx(1.0, abs=2e-3)
    missing = [limit - p1_ratio(deflection, 0.3, n) for n in counts]
    rates = observed_rates([1.0 / n for n in counts], missing)
    print(f"missing {missing}, rates {rates}")
    assert missing[0] > missing[1] > missing[2] > 0.0, "linear elements are too stiff, never too soft"
    assert missing[2] < 0.07
    assert rates[0] < rates[1]
    assert rates[1] == pytest.approx(2.0, abs=0.4)
