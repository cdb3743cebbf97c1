"""The scenes of the mixed method's paper, and what its two schemes do over many steps and against a rigid body."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigid_body import RigidBody, best_fit
from scenario import block, body, build, material, scene

from femdeform.cli import main
from femdeform.run.setup import Simulation, build_simulation
from femdeform.scene.load import load_scene
from femdeform.scene.meshing import load_meshes

REPOSITORY = Path(__file__).resolve().parents[2]
SCENES = REPOSITORY / "scenes" / "mixed"
NAMES = sorted(path.stem for path in SCENES.glob("*.yaml"))
DATA = Path(os.environ.get("FEMDEFORM_DATA", REPOSITORY.parent / "shared" / "data" / "meshes"))
# The paper's meshes: scene, body, file, how it is taken.
REAL = {
    "bunny-solid": ("bunny", "coarse_bunny.mesh", "scale: 0.001"),
    "bunny-shell": ("bunny", "coarse_bunny.mesh", "scale: 0.001, cell_type: surface, drop_unreferenced: true"),
    "bunny-springs": ("bunny", "coarser_bunny.mesh", "scale: 0.001, cell_type: edges"),
    "rod-armadillo": ("armadillo", "armadillo_low.obj", "cell_type: edges, translate: [0, -0.5742, 0]"),
    "jelly-octopus": ("octopus", "octopus.mesh", "dim: 3"),
    "spot-stiff": ("spot", "spot.mesh", "dim: 3"),
    "cloth-stiff": ("cloth", "square_cloth3.obj", "dim: 3"),
    "beam-arap": ("beam", "cube_6k.mesh", "dim: 3"),
}


def test_every_row_has_a_scene() -> None:
    assert len(NAMES) == 16
    assert set(REAL) <= set(NAMES)


def test_the_scenes_have_no_faults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", *(str(SCENES / f"{name}.yaml") for name in NAMES)]) == 0
    assert capsys.readouterr().out.count("no faults") == len(NAMES)


def shortened(name: str, tmp_path: Path, *overrides: str, steps: int = 2) -> int:
    path = SCENES / f"{name}.yaml"
    dt = load_scene(path).scene.time.dt
    arguments = ["run", str(path), "--out", str(tmp_path / "result")]
    for override in (f"time.end={steps * dt!r}", "expect={}", *overrides):
        arguments += ["--set", override]
    return main(arguments)


@pytest.mark.parametrize("name", NAMES)
def test_a_shortened_run(name: str, tmp_path: Path) -> None:
    assert shortened(name, tmp_path, steps=1 if name == "bunny-shell-fine" else 2) == 0


@pytest.mark.parametrize("name", sorted(REAL))
def test_a_shortened_run_with_the_real_mesh(name: str, tmp_path: Path) -> None:
    member, file, how = REAL[name]
    if not (DATA / file).is_file():
        pytest.skip(f"{file} is not in {DATA}; FEMDEFORM_DATA names the folder of the paper's meshes")
    assert shortened(name, tmp_path, f"bodies.{member}.mesh={{file: {DATA / file}, {how}}}", steps=1) == 0


def loaded(name: str, *overrides: str) -> Simulation:
    found = load_scene(SCENES / f"{name}.yaml", list(overrides))
    return build_simulation(found.scene, load_meshes(found))


def forward(simulation: Simulation) -> int:
    """One step; the iterations it took."""
    problem = simulation.problem
    problem.begin_step(simulation.state, simulation.scene.time.dt)
    result = simulation.solver.step(problem, simulation.state)
    assert result.accepted, result.reason
    simulation.state = problem.accept(simulation.state, result.x)
    return int(result.iterations)


def test_the_stiff_drop_is_that_of_a_rigid_body() -> None:
    """Fall, landing on an edge, turning over and rest, against a rigid body in the same step; 1.7 m, 1 GPa."""
    simulation = loaded("spot-stiff", "bodies.spot.mesh.element_size=0.15", "solver={method: mixed_fem}")
    twin = loaded("spot-stiff", "bodies.spot.mesh.element_size=0.15")
    points, mass = simulation.discretization.points, simulation.discretization.lumped_mass
    gravity = np.array([0.0, -9.81, 0.0])
    rigid = RigidBody(points, mass, np.zeros_like(points), gravity, twin.problem.contacts)
    turn = 0.0
    for _ in range(24):
        forward(simulation)
        rigid.step(simulation.scene.time.dt)
        x = simulation.state.x
        assert np.abs(x - best_fit(x, points, mass)).max() < 5e-4
        assert np.abs(x - rigid.x).max() < 1e-3
        turn = float(np.abs((x - points) - mass @ (x - points) / mass.sum()).max())
    assert turn > 0.2, "it has turned over"


@pytest.mark.parametrize("kind", ["rod", "membrane"])
def test_nothing_but_rounding_turns_rods_and_membranes(kind: str) -> None:
    """Free fall by the alternating scheme: the direction of a multiplier that is rounding must not count."""
    name, h = ("rod-armadillo", 0.01) if kind == "rod" else ("bunny-shell", 1.0 / 30.0)
    simulation = loaded(name, "solver={method: mixed_fem, scheme: alternating}", "conditions=[]", "obstacles=[]")
    for _ in range(5):
        forward(simulation)
    fallen = simulation.state.x - simulation.discretization.points
    np.testing.assert_allclose(fallen, np.broadcast_to([0.0, -9.81 * h * h * 15.0, 0.0], fallen.shape), atol=1e-10)


# ------------------------------------------------------------------------------------- evidence over many steps

CONVERGED = {"method": "mixed_fem", "tolerance": 1e-11}
NEWTON = {"method": "projected_newton", "tolerance": 1e-11}


def bounce(solver: dict[str, Any], E: float) -> tuple[np.ndarray, np.ndarray]:
    """200 steps of a block that spins, falls and slides on a smooth floor: energy, momentum, volume; positions."""
    simulation = build(
        scene(
            {"b": body(block([0.4, 0.2, 0.2], [4, 2, 2], translate=[-0.2, 0.1, -0.1]), material(E=E, nu=0.4))},
            {"kind": "initial_velocity", "on": "b", "velocity": [0.5, 0.0, 0.0], "angular_velocity": [0.0, 1.0, 2.0]},
            obstacles=[{"kind": "plane", "point": [0, 0, 0], "normal": [0, 1, 0], "stiffness": 1e7}],
            gravity=[0.0, -9.81, 0.0],
            solver=solver,
        )
    )
    problem, mass = simulation.problem, simulation.discretization.lumped_mass
    rows = []
    for _ in range(200):
        forward(simulation)
        x, v = simulation.state.x, simulation.state.v
        elastic = sum(term.value(x) for term in problem.elastic)
        kinetic = 0.5 * float(np.einsum("i,ic,ic->", mass, v, v))
        height = float(mass @ x[:, 1])
        energy = elastic + kinetic + 9.81 * height + problem.contacts[0].value(x)
        rows.append([energy, *(mass @ v)[[0, 2]] / mass.sum()])
    return np.array(rows), simulation.state.x


@pytest.mark.parametrize("E", [1e5, 1e7])
def test_two_hundred_steps_of_a_free_body(E: float) -> None:
    newton, at_newton = bounce(NEWTON, E)
    mixed, at_mixed = bounce(CONVERGED, E)
    np.testing.assert_allclose(at_mixed, at_newton, atol=1e-9)
    np.testing.assert_allclose(mixed[:, 0], newton[:, 0], rtol=1e-9)
    assert np.diff(mixed[:, 0]).max() <= 0.0, "backward Euler only loses energy"
    np.testing.assert_allclose(mixed[:, 1:], np.broadcast_to([0.5, 0.0], (200, 2)), atol=1e-9)
    # The published number of iterations: the same rest, not the same way there.
    alternating, at_alternating = bounce({"method": "mixed_fem", "scheme": "alternating"}, E)
    np.testing.assert_allclose(alternating[:, 1:], np.broadcast_to([0.5, 0.0], (200, 2)), atol=1e-9)
    np.testing.assert_allclose(at_alternating, at_newton, atol=1e-4)


@pytest.mark.parametrize(
    ("law", "E", "expected"),
    [
        ("corotated", 1e5, (1e-2, 4e-6, 6e-10)),
        ("corotated", 1e7, (5e-2, 2e-5, 6e-9)),
        ("corotated", 1e9, (6e-2, 1e-6, 2e-10)),
        ("neo_hookean", 1e5, (1e-1, 1e-1, 1e-1)),
    ],
)
def test_the_table_of_distances(law: str, E: float, expected: tuple[float, ...]) -> None:
    """docs/gallery-mixed.md: distance to the solution over that of the predictor after 1, 3, 5 iterations."""
    data = scene(
        {"b": body(block([1.0, 0.5, 0.5], [4, 2, 2]), material(law, E=E, nu=0.45))},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "initial_velocity", "on": "b", "velocity": [0.0, 2.0, -3.0], "angular_velocity": [4.0, 0.0, 3.0]},
        gravity=[0.0, -9.81, 0.0],
        time={"scheme": "backward_euler", "dt": 1.0 / 60.0, "end": 1.0},
    )
    exact = build({**data, "solver": NEWTON})
    forward(exact)
    simulation = build({**data, "solver": {"method": "mixed_fem", "scheme": "alternating"}})
    problem, state = simulation.problem, simulation.state
    problem.begin_step(state, simulation.scene.time.dt)
    start = np.linalg.norm(problem.predictor(state) - exact.state.x)
    found: list[float] = []
    simulation.solver.step(
        problem, state, lambda row, x: found.append(float(np.linalg.norm(x - exact.state.x) / start))
    )
    for iteration, value in zip((0, 2, 4), expected, strict=True):
        assert 0.2 * value < found[iteration] < 5.0 * value
