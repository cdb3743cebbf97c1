"""PBNG against projected Newton: every law, both dimensions, statics and dynamics, several laws in a scene, contact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, scene

from femdeform.materials import LAWS
from femdeform.run.setup import Simulation
from femdeform.step_problem import StepResult

NEWTON = {"tolerance": 1e-12}
PBNG = {"method": "pbng", "tolerance": 1e-10, "max_iterations": 4000}


def solve(data: dict[str, Any], solver: dict[str, Any], steps: int = 1) -> tuple[Simulation, StepResult]:
    """Steps of a scene with a solver, all of which have to converge."""
    simulation = build({**data, "solver": solver})
    result = None
    for _ in range(steps):
        simulation.problem.begin_step(simulation.state, simulation.scene.time.dt)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.converged, result.reason
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    assert result is not None
    return simulation, result


def compare(data: dict[str, Any], steps: int = 1, moved: float = 0.05, atol: float = 1e-8, **more: Any) -> StepResult:
    newton, _ = solve(data, NEWTON, steps)
    other, result = solve(data, {**PBNG, **more}, steps)
    # The one measure, evaluated anew.
    problem = other.problem
    norm = problem.residual_norm(problem.gradient(other.state.x))
    assert norm <= 1.0001e-10 * problem.force_scale
    distance = np.abs(newton.state.x - newton.discretization.points).max()
    assert distance > moved
    np.testing.assert_allclose(other.state.x, newton.state.x, rtol=0.0, atol=atol * distance)
    return result


def clamped_bar(law: str, dim: int, dynamic: bool, **stuff: Any) -> dict[str, Any]:
    """A bar held at one end, bent by its weight: to its own length in statics, thrown in dynamics."""
    load = {"kind": "traction", "on": "b.right", "value": [0.0, -300.0, 100.0][:dim]}
    thrown = {"kind": "initial_velocity", "on": "b", "velocity": [0.0, 1.5, -1.0][:dim]}
    return scene(
        {"b": body(block([1.0, 0.5, 0.5][:dim], [4, 2, 2][:dim]), material(law, E=2e4, **stuff))},
        {"kind": "fixed", "on": "b.left"},
        thrown if dynamic else load,
        gravity=[0.0, -9.81, 0.0][:dim],
        time={"scheme": "backward_euler", "dt": 1.0 / 30.0, "end": 1.0} if dynamic else quasistatic(),
    )


def twisted_block(law: str, dim: int, dynamic: bool) -> dict[str, Any]:
    """One end stretched by a quarter and turned, in one step."""
    turn: dict[str, Any] = {"kind": "rotate", "on": "b.right", "rate": 0.5}
    if dim == 3:
        turn = {"kind": "twist", "on": "b.right", "axis": [1, 0, 0], "rate": 0.8, "elongation_rate": 0.25}
    if dynamic:
        turn |= {key: 10.0 * turn[key] for key in ("rate", "elongation_rate") if key in turn}
    return scene(
        {"b": body(block([1.0, 0.5, 0.5][:dim], [4, 2, 2][:dim]), material(law, E=1e5))},
        {"kind": "fixed", "on": "b.left"},
        turn,
        time={"scheme": "backward_euler", "dt": 0.1, "end": 1.0} if dynamic else quasistatic(),
    )


@pytest.mark.parametrize("dynamic", [False, True], ids=["statics", "dynamics"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_every_law_on_the_clamped_bar(law: str, dim: int, dynamic: bool) -> None:
    compare(clamped_bar(law, dim, dynamic), 3 if dynamic else 1)


@pytest.mark.parametrize("dynamic", [False, True], ids=["statics", "dynamics"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_every_law_on_the_twisted_block(law: str, dim: int, dynamic: bool) -> None:
    compare(twisted_block(law, dim, dynamic))


@pytest.mark.parametrize("acceleration", ["none", "chebyshev", "sor", "anderson"])
def test_accelerations_find_the_same(acceleration: str) -> None:
    compare(twisted_block("neo_hookean", 3, False), acceleration=acceleration)


@pytest.mark.parametrize("dynamic", [False, True], ids=["statics", "dynamics"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_newton_steps_finish_the_twisted_block(law: str, dim: int, dynamic: bool) -> None:
    result = compare(twisted_block(law, dim, dynamic), finish="newton_krylov", acceleration="none")
    assert result.linear_iterations > 0
    assert result.iterations < 400


def test_newton_steps_finish_other_accelerations_and_precisions() -> None:
    for more in ({"acceleration": "chebyshev"}, {"acceleration": "anderson"}, {"precision": "float32"}):
        compare(twisted_block("neo_hookean", 3, False), finish="newton_krylov", **more)


def test_relaxation_inside_the_sweep_finds_the_same() -> None:
    compare(twisted_block("fixed_corotated", 3, False), relaxation=1.6, acceleration="none")


def test_single_precision_is_finished_in_double() -> None:
    compare(twisted_block("fixed_corotated", 3, False), precision="float32")
    compare(clamped_bar("neo_hookean", 3, True), 3, precision="float32")


def test_several_laws_in_one_body_and_several_bodies() -> None:
    """Three layers whose nodes are shared, and a second body; rollers; three steps under gravity."""
    mesh = block([1.0, 0.4, 0.4], [4, 2, 2])
    bodies = {
        "a": body(mesh, material("neo_hookean", E=3e4)),
        "c": body(block([1.0, 0.4, 0.4], [4, 2, 2], translate=[0, 0, 1]), material("corotated", E=2e4)),
        "d": body(block([1.0, 0.4, 0.4], [3, 2, 2], translate=[0, 0, 2]), material("neo_hookean", E=3e4)),
    }
    data = scene(
        bodies,
        {"kind": "fixed", "on": "a.left"},
        {"kind": "fixed", "on": "c.left"},
        {"kind": "fixed", "on": "d.left", "components": ["x"]},
        {"kind": "fixed", "on": "d.bottom", "components": ["y"]},
        {"kind": "fixed", "on": "d.back", "components": ["z"]},
        {"kind": "traction", "on": "d.right", "value": [2000.0, 0, 0]},
        gravity=[0.0, -9.81, 0.0],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 1.0},
    )
    compare(data, 3, moved=0.01)


def test_regions_share_nodes() -> None:
    """A mesh with two cell groups: nodes between them feel two laws."""
    import meshes.structured as structured
    from femdeform.run.setup import build_simulation
    from femdeform.scene.schema import DeformableScene
    from femdeform.types import Mesh

    data = clamped_bar("neo_hookean", 3, False)
    own = data["bodies"]["b"]
    own["regions"] = {"far": material("fixed_corotated", E=1e5)}
    model = DeformableScene.model_validate({**data, "bodies": {"b": own}, "solver": PBNG})
    plain = structured.block(model.bodies["b"].mesh)  # type: ignore[arg-type]
    centre = plain.points[plain.cells].mean(axis=1)
    mesh = Mesh(
        plain.points, plain.cells, plain.cell_type, plain.facet_groups, {"far": np.flatnonzero(centre[:, 0] > 0.4)}, {}
    )
    answers = []
    for solver in (NEWTON, PBNG):
        scene_model = DeformableScene.model_validate({**data, "bodies": {"b": own}, "solver": solver})
        simulation = build_simulation(scene_model, {"b": mesh})
        simulation.problem.begin_step(simulation.state, 1.0)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.converged, result.reason
        answers.append(result.x)
    assert np.abs(answers[0] - mesh.points).max() > 0.02
    np.testing.assert_allclose(answers[1], answers[0], atol=1e-9)


@pytest.mark.parametrize(
    ("dim", "obstacle"),
    [
        (3, {"kind": "plane", "point": [0.0, -0.02, 0.0], "normal": [0.1, 1, 0], "friction": 0.4}),
        (3, {"kind": "sphere", "center": [0.5, 0.6, 0.25], "radius": 1.2, "inside": True, "velocity": [0.5, 0, 0]}),
        (3, {"kind": "sphere", "center": [0.5, -0.4, 0.25], "radius": 0.39}),
        (3, {"kind": "box", "min": [0.2, -1.0, 0.1], "max": [0.8, -0.01, 0.4], "friction": 0.3}),
        (3, {"kind": "box", "min": [-0.01, -0.02, -0.01], "max": [2.0, 2.0, 0.51], "inside": True}),
        (2, {"kind": "sphere", "center": [0.5, -0.4], "radius": 0.39, "friction": 0.2}),
        (2, {"kind": "box", "min": [0.2, -1.0], "max": [0.8, -0.01]}),
    ],
)
def test_obstacles(dim: int, obstacle: dict[str, Any]) -> None:
    data = scene(
        {"b": body(block([1.0, 0.5, 0.5][:dim], [4, 2, 2][:dim]), material("neo_hookean", E=5e4))},
        {"kind": "initial_velocity", "on": "b", "velocity": [0.5, -2.0, 0.2][:dim]},
        gravity=[0.0, -9.81, 0.0][:dim],
        obstacles=[obstacle],
        time={"scheme": "backward_euler", "dt": 0.01, "end": 1.0},
    )
    compare(data, 4, moved=0.02)


def test_pressure_that_follows_the_surface() -> None:
    data = scene(
        {"b": body(block([1.0, 0.5, 0.5], [4, 2, 2]), material("fixed_corotated", E=1e5))},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "pressure", "on": "b.top", "value": 3000.0},
        time=quasistatic(),
    )
    compare(data, moved=0.05, atol=1e-7)


def test_the_forces_of_a_step_from_rest_are_not_rounding() -> None:
    """R0 of a body at rest whose support moves: forces of the first iterate, though a sweep never makes a Hessian."""
    data = scene(
        {"b": body(block([1.0, 1.0, 1.0], [3, 3, 3]), material("fixed_corotated"))},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "translate", "on": "b.right", "velocity": [0.1, 0.0, 0.0]},
        time={"scheme": "quasistatic", "dt": 1.0},
        solver={"method": "pbng"},
    )
    simulation = build(data)
    problem = simulation.problem
    problem.begin_step(simulation.state, 1.0)
    assert problem.force_scale < 1e-6, "nothing but rounding at rest"
    assert simulation.solver.step(problem, simulation.state).converged
    first = problem.full_gradient(problem.initial_guess(simulation.state))
    assert problem.force_scale == pytest.approx(np.linalg.norm(first), rel=1e-9)
