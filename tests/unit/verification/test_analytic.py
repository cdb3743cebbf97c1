"""The exact solutions themselves: against tables, limits, balances, and recurrences carried out step by step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from femdeform.errors import InputError
from femdeform.materials import LAWS
from femdeform.scene import schema
from femdeform.scene.document import read_document
from femdeform.scene.load import load_scene
from verification.analytic import ANALYTIC
from verification.analytic.beams import RectangularBeam, square_bar_torque
from verification.analytic.discrete_time import rigid_spin_angle, rigid_spin_increments
from verification.analytic.rings import inflated_ring, lame_ring_displacement, lame_ring_moment
from verification.analytic.uniaxial import uniaxial_stretch

CASES = Path(__file__).parents[3] / "verification" / "cases"


def scene_of(path: str, *overrides: str) -> schema.DeformableScene:
    return load_scene(CASES / path, overrides).scene


# ------------------------------------------------------------------------------------------------------- uniaxial

# Stretch 1.5, nu = 0.45, three dimensions; lateral stretch, P11 / E by bisection.
TABLE = {
    "arap": (1.0, 0.344828),
    "corotated": (0.775, 0.5),
    "fixed_corotated": (0.828888, 0.410038),
    "neo_hookean": (0.829993, 0.358876),
    "logarithmic_neo_hookean": (0.830679, 0.358614),
    "stable_neo_hookean": (0.828994, 0.375428),
}


@pytest.mark.parametrize("law", sorted(TABLE))
def test_closed_forms_are_the_tabulated_ones(law: str) -> None:
    state = uniaxial_stretch(law, 1.0, 0.45, 1.5, 3)
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


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_stretch_and_force_of_a_scene_belong_together(law: str, dim: int) -> None:
    """The stretch found for a traction, given as a motion, leads back to the traction."""
    word = f"bodies.bar.material.law={law}"
    pulled = scene_of(f"uniaxial/force-{dim}d.yaml", word)
    shift = ANALYTIC["uniaxial_elongation"](pulled)
    assert 0.1 < shift < 0.4
    velocity = [shift] + [0.0] * (dim - 1)
    moved = scene_of(f"uniaxial/stretch-{dim}d.yaml", word, f"conditions[{dim}].velocity={velocity}")
    area = 0.4 * (0.5 if dim == 3 else 1.0)
    assert ANALYTIC["uniaxial_reaction"](moved) == pytest.approx(-2.0e5 * area, rel=1e-12)
    assert ANALYTIC["uniaxial_elongation"](moved) == pytest.approx(shift, rel=1e-15)
    for name in ("uniaxial_contraction", "uniaxial_volume_ratio"):
        assert ANALYTIC[name](moved) == pytest.approx(ANALYTIC[name](pulled), rel=1e-12)


def test_a_traction_that_no_stretch_reaches_is_bad_input() -> None:
    """St. Venant-Kirchhoff's bar loses its sides at a finite stress."""
    word = "bodies.bar.material.law=saint_venant_kirchhoff"
    with pytest.raises(InputError, match="no stretch of saint_venant_kirchhoff"):
        ANALYTIC["uniaxial_elongation"](scene_of("uniaxial/force-2d.yaml", word, "conditions[2].value=[1.0e+7, 0.0]"))


# --------------------------------------------------------------------------------------------------- beams, bars

SLENDER = RectangularBeam(1.0, 0.1, 0.1, 2.1e11, 0.0)


@pytest.mark.parametrize("name", ["slender", "contraction", "plane-strain"])
def test_scenes_of_the_cantilever_expect_what_theory_says(name: str) -> None:
    scene = scene_of(f"cantilever/{name}.yaml")
    assert scene.expect.displacement[0].value == pytest.approx(ANALYTIC["timoshenko_tip"](scene), rel=1e-5)


@pytest.mark.parametrize("name", ["csm1", "csm2"])
def test_scenes_of_the_benchmark_expect_what_the_study_does(name: str) -> None:
    study = read_document(CASES / "turek_hron" / "study.yaml", "study").data["studies"][name]
    published = {key[-1]: entry["reference"]["value"] for key, entry in study["quantities"].items()}
    expected = {entry.component: entry.value for entry in scene_of(f"turek_hron/{name}.yaml").expect.displacement}
    assert expected == pytest.approx(published)


def test_shear_is_in_the_theory() -> None:
    """With a height of a tenth of the length, shear adds one per cent."""
    assert SLENDER.tip_deflection(1.0) / SLENDER.bending_deflection(1.0) == pytest.approx(1.008, abs=1e-6)
    assert SLENDER.tip_deflection(tip_force=1.0) == pytest.approx(1.0 / (3.0 * SLENDER.bending_stiffness), rel=0.01)
    scene = scene_of("cantilever/slender.yaml")
    assert ANALYTIC["euler_bernoulli_tip"](scene, factor=1.008) == pytest.approx(ANALYTIC["timoshenko_tip"](scene))


def test_frequency_of_a_beam_tends_to_that_without_shear() -> None:
    def ratio(height: float) -> float:
        beam = RectangularBeam(1.0, height, 1.0, 1.0e6, 0.0)
        slender = 1.8751040687119611**2 / (2.0 * np.pi) * np.sqrt(beam.bending_stiffness / beam.line_mass(1000.0))
        return float(beam.first_frequency(1000.0) / slender)

    missing = [1.0 - ratio(height) for height in (0.2, 0.1, 0.05, 0.025)]
    assert missing[0] == pytest.approx(0.026, abs=0.003)
    quotients = np.array(missing[:-1]) / np.array(missing[1:])
    np.testing.assert_allclose(quotients, 4.0, atol=0.15)  # of second order in height / length


def test_torque_of_the_square_bar() -> None:
    """0.1406 of the literature: Timoshenko and Goodier, Theory of Elasticity, table in section 109."""
    assert square_bar_torque(1.0, 1.0, 1.0) == pytest.approx(0.1406, abs=5e-5)
    scene = scene_of("twisted_bar/torque.yaml")
    assert ANALYTIC["saint_venant_torque"](scene) == pytest.approx(0.1406 * 1.0e5 / 2.6 * 0.25**4 * 1e-3, rel=5e-4)


# -------------------------------------------------------------------------------------------------- discrete time


@pytest.mark.parametrize("dt", [2.0e-3, 1.6e-2])
def test_swinging_bar_in_discrete_time(dt: float) -> None:
    """One oscillator, stepped by the two schemes as they are defined."""
    scene = scene_of("free_vibration/axial.yaml", f"time.dt={dt}")
    assert ANALYTIC["axial_frequency"](scene) == pytest.approx(2.5)
    omega, n = 2.0 * np.pi * 2.5, round(scene.time.end / dt)
    speed = 1.0e-3
    u, v = 0.0, speed
    for _ in range(n):  # (1 + w^2 h^2) v' = v - w^2 h u,  u' = u + h v'
        v = (v - omega**2 * dt * u) / (1.0 + omega**2 * dt**2)
        u += dt * v
    assert ANALYTIC["axial_tip"](scene, speed=speed) == pytest.approx(u, rel=1e-9)
    energy = (v**2 + omega**2 * u**2) / speed**2
    assert ANALYTIC["axial_energy_ratio"](scene) == pytest.approx(energy, rel=1e-9)
    euler = np.array([[1.0, 0.0], [0.0, 1.0]]) - dt * np.array([[0.0, 1.0], [-(omega**2), 0.0]])
    half = 0.5 * dt * np.array([[0.0, 1.0], [-(omega**2), 0.0]])
    steps = {
        "backward_euler": np.linalg.inv(euler),
        "trapezoidal": np.linalg.solve(np.eye(2) - half, np.eye(2) + half),
    }
    for scheme, step in steps.items():
        turn = np.abs(np.angle(np.linalg.eigvals(step)))[0]
        found = ANALYTIC["axial_frequency_in_steps"](scene, scheme=scheme)
        assert found == pytest.approx(turn / (2.0 * np.pi * dt), rel=1e-12)


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
def test_swinging_rod_of_linear_cells(mass: str) -> None:
    """The lowest eigenvalue of stiffness and mass, put together cell by cell."""
    n = 6
    scene = scene_of("free_vibration/rod.yaml", f"bodies.bar.mesh.cells={n}", f"bodies.bar.mass={mass}", "time.dt=1e-6")
    of_cell = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0 if mass == "consistent" else 0.5 * np.eye(2)
    K, M = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    for k in range(n):
        here = np.ix_([k, k + 1], [k, k + 1])
        K[here] += 1.0e5 * n * np.array([[1.0, -1.0], [-1.0, 1.0]])
        M[here] += 1.0e3 / n * of_cell
    lowest = np.linalg.eigvals(np.linalg.solve(M[1:, 1:], K[1:, 1:])).real.min()
    found = ANALYTIC["rod_frequency_in_steps"](scene, scheme="trapezoidal")
    assert found == pytest.approx(np.sqrt(lowest) / (2.0 * np.pi), rel=1e-9)


def test_rigid_spin_is_the_projection_of_the_extrapolated_rotation() -> None:
    """The closed form, and the recurrence it comes from, carried out with matrices."""
    assert rigid_spin_angle(0.1, 30) == pytest.approx(2.65202, abs=5e-6)
    before = np.eye(2)
    # The start: x_hat = X + h v, with v = w times X turned by a right angle.
    target = np.array([[1.0, -0.1], [0.1, 1.0]])
    total = 0.0
    for increment in rigid_spin_increments(0.1, 30):
        U, _, Vt = np.linalg.svd(target)
        now = U @ Vt
        step = now @ before.T
        assert np.arctan2(step[1, 0], step[0, 0]) == pytest.approx(increment, rel=1e-10)
        total += increment
        before, target = now, 2.0 * now - before
    assert total == pytest.approx(rigid_spin_angle(0.1, 30), rel=1e-15)


def test_spinning_scene() -> None:
    scene = scene_of("rigid_rotation/spin.yaml")
    angle = rigid_spin_angle(0.1, 30)
    spin = ANALYTIC["rigid_spin_displacement"]
    assert spin(scene, at=[1.0, 0.5], component="x") == pytest.approx(0.5 * (np.cos(angle) - 1.0))
    assert spin(scene, at=[1.0, 0.5], component="y") == pytest.approx(0.5 * np.sin(angle))
    assert ANALYTIC["rigid_spin_momentum_ratio"](scene) == pytest.approx(0.793, abs=5e-4)


# ---------------------------------------------------------------------------------------------------------- rings


def test_scene_of_the_cylinder_expects_lame() -> None:
    scene = scene_of("lame_cylinder/scene.yaml")
    for name, radius in (("inner", 0.5), ("outer", 1.0)):
        expected = ANALYTIC["lame_displacement"](scene, radius=radius)
        assert scene.expect.measured[name].value == pytest.approx(expected, rel=1e-6)


def test_lame_is_in_equilibrium() -> None:
    E, nu, a, b, p = 3.0, 0.3, 0.5, 1.0, 1e-3
    mu, lmbda = E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    r, h = np.linspace(a, b, 2001), 1e-6

    def u(radius: Any) -> Any:
        return np.array([lame_ring_displacement(E, nu, a, b, p, float(x)) for x in radius])

    slope = (u(r + h) - u(r - h)) / (2.0 * h)
    radial = 2.0 * mu * slope + lmbda * (slope + u(r) / r)
    hoop = 2.0 * mu * u(r) / r + lmbda * (slope + u(r) / r)
    assert radial[[0, -1]] == pytest.approx([-p, 0.0], abs=1e-6 * p)
    np.testing.assert_allclose(np.gradient(radial, r)[1:-1], ((hoop - radial) / r)[1:-1], atol=2e-5 * p)
    assert np.trapezoid(hoop, r) == pytest.approx(p * a, rel=1e-6)
    assert np.trapezoid(hoop * r, r) == pytest.approx(lame_ring_moment(a, b, p), rel=1e-6)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_inflated_ring_tends_to_lame(law: str) -> None:
    nu = 0.0 if law == "arap" else 0.3
    shape = inflated_ring(law, 1.0, nu, 0.5, 1.0, 1e-6)
    for radius in (0.5, 0.7, 1.0):
        small = lame_ring_displacement(1.0, nu, 0.5, 1.0, 1e-6, radius)
        assert float(shape(np.array([radius]))[0]) - radius == pytest.approx(small, rel=1e-5)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_inflated_ring_balances_the_pressure(law: str) -> None:
    """The hoop force over a cut is the pressure times the deformed inner radius; stresses by the compiled law."""
    from types import SimpleNamespace

    from femdeform.materials import batch, law_for

    p = 0.05
    shape = inflated_ring(law, 1.0, 0.3, 0.5, 1.0, p)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    R, w, h = 0.75 + 0.25 * nodes, 0.25 * weights, 1e-5
    F = np.zeros((len(R), 2, 2))
    F[:, 0, 0], F[:, 1, 1] = (shape(R + h) - shape(R - h)) / (2.0 * h), shape(R) / R
    material = SimpleNamespace(law=law, youngs_modulus=1.0, poisson_ratio=0.3)
    hoop = np.asarray(batch.pk1(F, law_for(material, 2)))[:, 1, 1]
    inner = float(shape(np.array([0.5]))[0])
    assert inner > 0.54
    assert w @ hoop == pytest.approx(p * inner, rel=1e-7)


def test_a_pressure_beyond_equilibrium_is_bad_input() -> None:
    with pytest.raises(InputError, match="no equilibrium"):
        inflated_ring("neo_hookean", 1.0, 0.3, 0.5, 1.0, 1.0)


# ---------------------------------------------------------------------------------------- what a scene must be like


@pytest.mark.parametrize(
    ("name", "path", "overrides", "message"),
    [
        ("uniaxial_reaction", "cantilever/slender.yaml", (), "one condition `traction`, not 0"),
        ("timoshenko_tip", "turek_hron/csm1.yaml", (), "recipe `block`"),
        ("timoshenko_tip", "necking/scene.yaml", (), "gravity"),
        ("axial_frequency", "cantilever/locking.yaml", (), "poisson_ratio 0"),
        ("axial_energy_ratio", "free_vibration/axial.yaml", ("time.dt=0.07",), "divides the run"),
        ("lame_displacement", "uniaxial/force-2d.yaml", (), "one condition `pressure`"),
        ("rigid_spin_momentum_ratio", "rigid_rotation/spin.yaml",
         ("conditions[0].angular_velocity=[1.0, 0.0, 0.0]",), "about z"),
    ],
)  # fmt: skip
def test_a_scene_of_another_kind_is_bad_input(name: str, path: str, overrides: tuple[str, ...], message: str) -> None:
    more = {"radius": 1.0} if name == "lame_displacement" else {}
    with pytest.raises(InputError, match=message):
        ANALYTIC[name](scene_of(path, *overrides), **more)
