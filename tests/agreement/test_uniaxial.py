"""Uniaxial stretch between rollers against the closed form of every law, driven by displacement and by force."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from femdeform.materials import LAWS
from femdeform.types import FloatArray
from verification.analytic import uniaxial_stretch
from verification.prescribed_field import solve_prescribed

E, NU = 1.0e6, 0.45
SIZE = (1.0, 0.4, 0.5)
SIDES = (("left", "x"), ("bottom", "y"), ("back", "z"))
# methods.md, section 6, row 4: stretch 1.5 in three dimensions; lateral stretch, P11 / E.
TABLE = {
    "arap": (1.0, 0.344828),
    "corotated": (0.775, 0.5),
    "fixed_corotated": (0.828888, 0.410038),
    "neo_hookean": (0.829993, 0.358876),
    "logarithmic_neo_hookean": (0.830679, 0.358614),
    "stable_neo_hookean": (0.828994, 0.375428),
}
# In plane strain the sides of St. Venant-Kirchhoff's body vanish at a^2 = 1 + (1 - nu) / nu, a = 1.49.
STRETCH = {law: 1.4 if law == "saint_venant_kirchhoff" else 1.5 for law in LAWS}


@pytest.mark.parametrize("law", sorted(TABLE))
def test_closed_forms_are_the_tabulated_ones(law: str) -> None:
    state = uniaxial_stretch(law, 1.0, NU, 1.5, 3)
    assert (state.lateral, state.stress) == pytest.approx(TABLE[law], abs=6e-7)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_closed_forms_agree_with_small_strain(law: str, dim: int) -> None:
    nu = 0.0 if law == "arap" else 0.3
    e = 1e-6
    state = uniaxial_stretch(law, 1.0, nu, 1.0 + e, dim)
    modulus, contraction = (1.0, nu) if dim == 3 else (1.0 / (1.0 - nu**2), nu / (1.0 - nu))
    assert state.stress / e == pytest.approx(modulus, rel=1e-4)
    assert (1.0 - state.lateral) / e == pytest.approx(contraction, abs=1e-4)


def rollers(dim: int) -> list[dict[str, Any]]:
    return [{"kind": "fixed", "on": f"body.{side}", "components": [axis]} for side, axis in SIDES[:dim]]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_prescribed_stretch(
    law: str, dim: int, order: int, block: Callable[..., Any], scene_of: Callable[..., Any]
) -> None:
    a = STRETCH[law]
    exact = uniaxial_stretch(law, E, NU, a, dim)
    mesh = block([3, 2, 2][:dim], SIZE[:dim])
    scene = scene_of(
        {"law": law, "youngs_modulus": E, "poisson_ratio": NU},
        order,
        dim,
        conditions=[*rollers(dim), {"kind": "fixed", "on": "body.right", "components": ["x"]}],
        solver={"tolerance": 1e-12},
        time={"scheme": "quasistatic", "dt": 0.5},
    )

    def pull(X: FloatArray) -> FloatArray:
        return X * np.array([a - 1.0, 0.0, 0.0])[:dim]

    solved = solve_prescribed(scene, {"body": mesh}, pull)
    points = solved.simulation.discretization.points
    expected = points * np.array([a, exact.lateral, exact.lateral])[:dim]
    np.testing.assert_allclose(solved.state.x, expected, rtol=0, atol=1e-8)
    force = solved.reaction(np.flatnonzero(points[:, 0] > SIZE[0] - 1e-9))
    area = float(np.prod(SIZE[1:dim]))
    assert force[0] / (area * E) == pytest.approx(exact.stress / E, rel=1e-8)
    np.testing.assert_allclose(force[1:] / (area * E), 0.0, atol=1e-8)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_traction_gives_the_same_stretch(
    law: str, dim: int, block: Callable[..., Any], scene_of: Callable[..., Any], run: Callable[..., Any]
) -> None:
    a = STRETCH[law]
    exact = uniaxial_stretch(law, E, NU, a, dim)
    traction = [exact.stress] + [0.0] * (dim - 1)
    scene = scene_of(
        {"law": law, "youngs_modulus": E, "poisson_ratio": NU},
        2,
        dim,
        conditions=[*rollers(dim), {"kind": "traction", "on": "body.right", "value": traction}],
        solver={"tolerance": 1e-12},
        time={"scheme": "quasistatic", "dt": 0.25},
    )
    simulation, states = run(scene, {"body": block([3, 2, 2][:dim], SIZE[:dim])})
    expected = simulation.discretization.points * np.array([a, exact.lateral, exact.lateral])[:dim]
    np.testing.assert_allclose(states[-1].x, expected, rtol=0, atol=1e-8)
