"""Bodies that are linked: closed forms, one body cut in two, and two solvers that agree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import Array, advance, block, body, build, displacement, material, quasistatic, run, scene, step

from femdeform.fem.fields import cell_field
from femdeform.run.quantities import Meter
from femdeform.run.setup import Simulation

TIGHT = {"tolerance": 1e-11}
MIXED = {"method": "mixed_fem", "tolerance": 1e-11}
STIFF = material(E=1e8, nu=0.0)
MEASURE: dict[str, Any] = {
    "gap": {"kind": "link_gap"},
    "energy": {"kind": "link_energy"},
    "total": {"kind": "total_energy"},
}


def measured(simulation: Simulation) -> dict[str, float]:
    return Meter(simulation).evaluate(simulation.state)


def mean(simulation: Simulation, on: str) -> Array:
    return np.asarray(displacement(simulation)[simulation.conditions.local_nodes(on)].mean(axis=0))


# ------------------------------------------------------------------------------------------------- one body in two


def bar(dim: int, law: str, solver: dict[str, Any], stiffness: float | None, per: str = "node") -> Simulation:
    """A bar under pull and shear, whole, or cut in the middle and tied."""
    stuff = material(law, E=1e5, nu=0.3)
    size, cells = [1.0, 0.2, 0.2][:dim], [4, 2, 2][:dim]
    pull = [2e3, -50.0, 30.0][:dim]
    if stiffness is None:
        bodies = {"a": body(block([2.0, *size[1:]], [8, *cells[1:]]), stuff)}
        end, links = "a.right", {}
    else:
        bodies = {"a": body(block(size, cells), stuff), "b": body(block(size, cells, translate=[1, 0, 0][:dim]), stuff)}
        end = "b.right"
        links = {"glue": {"kind": "tie", "on": "b.left", "to": "a.right", "stiffness": stiffness, "per": per}}
    return run(
        scene(
            bodies,
            {"kind": "fixed", "on": "a.left"},
            {"kind": "traction", "on": end, "value": pull},
            links=links,
            time=quasistatic(),
            solver=solver,
            measure={"gap": {"kind": "link_gap"}} if links else {},
        )
    )


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("per", ["node", "area"])
def test_two_tied_bars_are_one_bar(dim: int, per: str) -> None:
    """The error is the gap: it falls with the inverse of the stiffness."""
    whole = bar(dim, "neo_hookean", TIGHT, None)
    errors, gaps = [], []
    for stiffness in (1e7, 1e8, 1e9):
        tied = bar(dim, "neo_hookean", TIGHT, stiffness if per == "node" else 100.0 * stiffness, per)
        errors.append(np.abs(mean(tied, "b.right") - mean(whole, "a.right")).max())
        gaps.append(measured(tied)["gap"])
    assert errors[0] < 1e-2
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 10.0, rtol=0.02)
    np.testing.assert_allclose(np.array(gaps[:-1]) / gaps[1:], 10.0, rtol=0.02)


@pytest.mark.parametrize("law", ["stable_neo_hookean", "fixed_corotated", "arap"])
def test_newton_and_mixed_elements_agree(law: str) -> None:
    newton, mixed = (bar(3, law, solver, 1e6) for solver in (TIGHT, MIXED))
    size = np.abs(displacement(newton)).max()
    assert size > 0.01
    np.testing.assert_allclose(displacement(mixed), displacement(newton), atol=1e-8 * size)


@pytest.mark.parametrize("stiffness", [1e4, 1e8])
@pytest.mark.parametrize("gap", ["kept", "closed"])
def test_iterations_do_not_grow_with_stiffness(gap: str, stiffness: float) -> None:
    """Links are convex: twisting two bars that are tied over a gap, with other meshes, is as easy as one."""
    stuff = material("stable_neo_hookean", E=1e5, nu=0.3)
    tie = {"kind": "tie", "on": "b.left", "to": "a.right", "stiffness": stiffness, "gap": gap, "max_distance": 0.1}
    for solver in ({"tolerance": 1e-8}, {"method": "mixed_fem", "tolerance": 1e-8}):
        simulation = build(
            scene(
                {
                    "a": body(block([1.0, 0.3, 0.3], [4, 2, 2]), stuff),
                    "b": body(block([1.0, 0.3, 0.3], [5, 3, 3], translate=[1.05, 0, 0]), stuff),
                },
                {"kind": "fixed", "on": "a.left"},
                {"kind": "twist", "on": "b.right", "axis": [1, 0, 0], "rate": 3.0, "elongation_rate": 0.2},
                links={"t": tie},
                time=quasistatic(0.25),
                solver=solver,
            )
        )
        assert max(step(simulation).iterations for _ in range(4)) <= 10


def test_a_link_pulls_bodies_into_contact() -> None:
    """With barriers between the bodies both solvers arrive at the same place, and nothing is crossed."""
    ends = [{"at": [0.5, 0.1], "body": "a"}, {"at": [0.5, 0.35], "body": "b"}]
    results = []
    for solver in (TIGHT, MIXED):
        simulation = build(
            scene(
                {
                    "a": body(block([1.0, 0.2], [6, 2])),
                    "b": body(block([0.6, 0.2], [4, 2], translate=[0.2, 0.22])),
                },
                {"kind": "fixed", "on": "a.bottom"},
                {"kind": "fixed", "on": "b", "components": ["x"]},
                links={"l": {"kind": "pair", "ends": ends, "stiffness": 2000.0}},
                contact={"method": "ipc"},
                solver=solver,
                time={"scheme": "backward_euler", "dt": 0.04, "end": 1.0},
            )
        )
        advance(simulation, 4)
        (contact,) = simulation.problem.couplings
        assert contact.value(simulation.state.x) > 0.0
        assert not contact.intersects(simulation.state.x)
        results.append(displacement(simulation))
    assert results[0][:, 1].min() < -0.01
    np.testing.assert_allclose(results[1], results[0], atol=1e-7 * np.abs(results[0]).max())


def test_the_interactive_scheme_knows_links() -> None:
    """Steps of the alternating scheme with many iterations end where Newton's do."""
    data = scene(
        {"a": body(block([0.4, 0.2], [4, 2]))},
        {"kind": "initial_velocity", "on": "a", "velocity": [1.0, 0.5]},
        links={
            "spring": {
                "kind": "spring",
                "ends": [{"at": [0.4, 0.2]}, {"at": [0.6, 0.5], "fixed": True}],
                "stiffness": 200.0,
            }
        },
        time={"scheme": "backward_euler", "dt": 0.01, "end": 0.1},
    )
    newton = run({**data, "solver": TIGHT})
    alternating = {"method": "mixed_fem", "scheme": "alternating", "outer_iterations": 40, "inner_iterations": 5}
    mixed = build({**data, "solver": alternating})
    for _ in range(10):
        mixed.problem.begin_step(mixed.state, 0.01)
        result = mixed.solver.step(mixed.problem, mixed.state)
        mixed.state = mixed.problem.accept(mixed.state, result.x)
    size = np.abs(displacement(newton)).max()
    np.testing.assert_allclose(displacement(mixed), displacement(newton), atol=1e-4 * size)


# ---------------------------------------------------------------------------------------------- across other meshes


@pytest.mark.parametrize(
    ("dim", "order", "upper", "error"),
    # Same meshes: exact. Others: what quadrature over the facets of `on` misses of the kinks of the other surface.
    [(2, 1, 4, 1e-8), (3, 1, 2, 1e-8), (2, 2, 4, 1e-8), (3, 2, 2, 1e-7), (2, 1, 7, 2e-3), (3, 1, 3, 2e-3)],
)
def test_uniform_stress_passes_across_a_tie(dim: int, order: int, upper: int, error: float) -> None:
    """Patch test: pulled blocks on top of one another, tied by area; the gap opens by pressure over stiffness."""
    lower = {2: 4, 3: 2}[dim]  # even: the diagonals of the faces meet
    stuff = material("linear", E=1e5, nu=0.0)
    mirrors = [{"kind": "fixed", "on": f"{name}.left", "components": ["x"]} for name in ("a", "b")]
    if dim == 3:
        mirrors += [{"kind": "fixed", "on": f"{name}.back", "components": ["z"]} for name in ("a", "b")]
    simulation = run(
        scene(
            {
                "a": body(block([1.0] * dim, [lower] * dim), stuff, element_order=order),
                "b": body(block([1.0] * dim, [upper] * dim, translate=[0, 1, 0][:dim]), stuff, element_order=order),
            },
            {"kind": "fixed", "on": "a.bottom", "components": ["y"]},
            *mirrors,
            {"kind": "traction", "on": "b.top", "value": [0, 1000.0, 0][:dim]},
            links={"t": {"kind": "tie", "on": "b.bottom", "to": "a.top", "stiffness": 1e8, "per": "area"}},
            time=quasistatic(),
            solver=TIGHT,
            measure={**MEASURE, "pull": {"kind": "link_force", "link": "t", "component": "y"}},
        )
    )
    for term in simulation.problem.elastic:
        stress = cell_field("cauchy_stress", term, simulation.state.x)[:, 4]
        np.testing.assert_allclose(stress, 1000.0, rtol=2.5 * error)
    values = measured(simulation)
    # The force on the upper block holds it against the traction, whatever the meshes are.
    assert values["pull"] == pytest.approx(-1000.0, rel=1e-9)
    assert values["gap"] == pytest.approx(1e-5, rel=max(100.0 * error, 1e-6))
    top = displacement(simulation)[simulation.conditions.local_nodes("b.top"), 1]
    np.testing.assert_allclose(top, 0.02 + 1e-5, rtol=0.05 * error)


def test_a_tie_of_normals_lets_surfaces_slide() -> None:
    """Without tangential stiffness a block on a tilted face goes where the face lets it, in any orientation."""
    for angle in (0.0, 0.7):
        turn = {"angle": angle}
        c, s = np.cos(angle), np.sin(angle)
        along, up = np.array([c, s]), np.array([-s, c])
        low = body(block([1.0, 0.2], [6, 2], rotate=turn))
        # Both are turned about the origin: the upper one is moved along the turned axes.
        high = body(block([0.4, 0.2], [3, 2], rotate=turn, translate=[float(v) for v in 0.2 * along + 0.2 * up]))
        push = 20.0 * along - 100.0 * up
        simulation = run(
            scene(
                {"low": low, "high": high},
                {"kind": "fixed", "on": "low.bottom"},
                {"kind": "traction", "on": "high.top", "value": [float(v) for v in push]},
                links={
                    "slide": {
                        "kind": "tie",
                        "on": "high.bottom",
                        "to": "low.top",
                        "stiffness": 1e8,
                        "tangential_stiffness": 100.0,
                        "per": "area",
                    }
                },
                time=quasistatic(),
                solver=TIGHT,
                measure={"force": {"kind": "link_force", "link": "slide", "component": "x"}, **MEASURE},
            )
        )
        moved = mean(simulation, "high.bottom")
        # 20 Pa over 100 Pa/m: 0.2 m along; and hardly anything across.
        assert float(moved @ along) == pytest.approx(0.2, rel=0.02)
        assert abs(float(moved @ up)) < 2e-3
        force = -0.4 * push
        assert measured(simulation)["force"] == pytest.approx(float(force[0]), rel=1e-7)


# ---------------------------------------------------------------------------------------------------- closed forms


def spring(first: dict[str, Any], second: dict[str, Any], stiffness: float, **more: Any) -> dict[str, Any]:
    return {"kind": "spring", "ends": [first, second], "stiffness": stiffness, **more}


@pytest.mark.parametrize("kind", ["spring", "pair"])
def test_springs_in_series(kind: str) -> None:
    """Two stiff bodies on two springs below one another: elongations F/k1 and F/k2."""
    k1, k2, force = 1000.0, 400.0, 30.0
    ends = [
        [{"at": [0.5, 1.0], "fixed": True}, {"at": [0.5, 0.0], "body": "a"}],
        [{"at": [0.5, -1.0], "body": "a"}, {"at": [0.5, -2.0], "body": "b"}],
    ]
    more = {"gap": "kept"} if kind == "pair" else {}
    simulation = run(
        scene(
            {
                "a": body(block([1.0, 1.0], [2, 2], translate=[0, -1]), STIFF),
                "b": body(block([1.0, 1.0], [2, 2], translate=[0, -3]), STIFF),
            },
            {"kind": "fixed", "on": "a", "components": ["x"]},
            {"kind": "fixed", "on": "b", "components": ["x"]},
            {"kind": "traction", "on": "b.bottom", "value": [0.0, -force]},
            links={
                "upper": {"kind": kind, "ends": ends[0], "stiffness": k1, **more},
                "lower": {"kind": kind, "ends": ends[1], "stiffness": k2, **more},
            },
            time=quasistatic(),
            solver=TIGHT,
            measure={
                "first": {"kind": "link_gap", "link": "upper"},
                "second": {"kind": "link_gap", "link": "lower"},
                "pull": {"kind": "link_force", "link": "lower", "component": "y"},
                "size": {"kind": "link_force", "link": "upper", "component": "norm"},
                "stored": {"kind": "link_energy", "link": "lower"},
                **MEASURE,
            },
        )
    )
    values = measured(simulation)
    assert values["first"] == pytest.approx(force / k1, rel=1e-9)
    assert values["second"] == pytest.approx(force / k2, rel=1e-9)
    assert values["gap"] == values["second"]
    assert values["pull"] == pytest.approx(-force, rel=1e-9)
    assert values["size"] == pytest.approx(force, rel=1e-9)
    assert values["stored"] == pytest.approx(0.5 * force**2 / k2, rel=1e-9)
    assert values["energy"] == pytest.approx(0.5 * force**2 * (1 / k1 + 1 / k2), rel=1e-9)
    assert mean(simulation, "b")[1] == pytest.approx(-force / k1 - force / k2, rel=1e-5)


def test_a_mass_on_a_spring() -> None:
    """Backward Euler turns by atan(w h) and shrinks by (1 + w^2 h^2)^-1/2 a step about the static elongation."""
    k, mass, g, h, n = 4000.0, 40.0, 9.81, 0.01, 60
    simulation = run(
        scene(
            {"m": body(block([0.2, 0.2], [2, 2]), STIFF)},
            gravity=[0.0, -g],
            links={"s": spring({"at": [0.1, 0.2]}, {"at": [0.1, 0.5], "fixed": True}, k)},
            time={"scheme": "backward_euler", "dt": h, "end": n * h},
            solver=TIGHT,
            measure=MEASURE,
        )
    )
    w = np.sqrt(k / mass)
    static = -mass * g / k
    z = 1.0 / (1.0 + 1j * w * h)
    # e_n = Re(A z^n) with e_0 = e_-1 = -static: at rest, the spring without force.
    system = np.array([[1.0, 0.0], [(1 / z).real, -(1 / z).imag]])
    real, imaginary = np.linalg.solve(system, [-static, -static])
    expected = static + ((real + 1j * imaginary) * z**n).real
    masses = simulation.discretization.lumped_mass
    middle = float(masses @ displacement(simulation)[:, 1] / masses.sum())
    assert masses.sum() == pytest.approx(mass)
    assert middle == pytest.approx(expected, rel=2e-4)
    assert abs(expected - static) > 0.01
    values = measured(simulation)
    assert values["total"] == pytest.approx(
        values["energy"]
        + simulation.problem.kinetic_energy(simulation.state.v)
        + simulation.problem.elastic_energy(simulation.state.x)
        + simulation.problem.load_potential(simulation.state.x)
    )


@pytest.mark.parametrize("carried", ["velocity", "obstacle"])
def test_an_attachment_carries_a_body_along(carried: str) -> None:
    """Held at its base, a body follows; an end of a spring that moves with an obstacle pulls by its elongation."""
    speed = [0.3, 0.1]
    motion = {"velocity": speed} if carried == "velocity" else {"obstacle": 0}
    simulation = run(
        scene(
            {"b": body(block([0.4, 0.2], [4, 2]))},
            links={"hold": {"kind": "attachment", "on": "b", "stiffness": 1e4, **motion}},
            obstacles=[{"kind": "sphere", "center": [9, 9], "radius": 0.5, "velocity": speed}],
            time=quasistatic(0.25),
            measure=MEASURE,
        )
    )
    np.testing.assert_allclose(displacement(simulation), np.tile(speed, (15, 1)), atol=1e-9)
    assert measured(simulation)["gap"] < 1e-9


def test_a_binding_shares_the_load_by_area() -> None:
    """Two plates side by side with a gap: bound tissue stretches by traction over stiffness, whatever the meshes."""
    stuff = material("linear", E=1e6, nu=0.0)
    for cells in (3, 8):
        simulation = run(
            scene(
                {
                    "low": body(block([1.0, 0.2], [5, 1]), stuff),
                    "high": body(block([1.0, 0.2], [cells, 1], translate=[0, 0.25]), stuff),
                },
                {"kind": "fixed", "on": "low"},
                {"kind": "fixed", "on": "high", "components": ["x"]},
                {"kind": "traction", "on": "high.top", "value": [0.0, 50.0]},
                links={"b": {"kind": "binding", "on": "high", "to": "low.top", "stiffness": 1e3, "within": 0.06}},
                time=quasistatic(),
                solver=TIGHT,
                measure=MEASURE,
            )
        )
        assert measured(simulation)["gap"] == pytest.approx(0.05, rel=1e-6)
        assert measured(simulation)["energy"] == pytest.approx(0.5 * 1e3 * 0.05**2, rel=1e-6)


def test_steps_of_another_size_end_at_the_same_place() -> None:
    """Targets move with time, not with steps."""
    data = scene(
        {"b": body(block([0.4, 0.2], [4, 2]))},
        links={"hold": {"kind": "attachment", "on": "b.left", "stiffness": 1e4, "velocity": [0.0, 0.2]}},
        time=quasistatic(0.5),
        solver=TIGHT,
    )
    coarse = run(data)
    fine = run({**data, "time": quasistatic(0.1)})
    np.testing.assert_allclose(displacement(fine), displacement(coarse), atol=1e-8)
    assert advance(coarse, 1).time == 1.5
    np.testing.assert_allclose(displacement(coarse)[:, 1], 0.3, atol=1e-8)
