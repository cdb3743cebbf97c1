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
DATA = Path(os.environ.get("FEMDEFORM_DATA", REPOSITORY.parent / "shared" / "data")) / "meshes"
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


# Scenes that take a few seconds.
QUICK = {"bunny-solid", "bunny-shell", "bunny-springs", "jelly-octopus"} | {n for n in NAMES if n.startswith("square")}


def test_every_row_has_a_scene() -> None:
    assert len(NAMES) == 16
    assert set(REAL) <= set(NAMES)


def test_the_scenes_have_no_faults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", *(str(SCENES / f"{name}.yaml") for name in NAMES)]) == 0
    assert capsys.readouterr().out.count("no faults") == len(NAMES)


def run(name: str, tmp_path: Path, *overrides: str) -> int:
    arguments = ["run", str(SCENES / f"{name}.yaml"), "--out", str(tmp_path / "result")]
    for override in overrides:
        arguments += ["--set", override]
    return main(arguments)


def shortened(name: str, tmp_path: Path, *overrides: str) -> int:
    """One step of a large scene, with few inner iterations."""
    setting = load_scene(SCENES / f"{name}.yaml").scene
    few = ["solver.inner_iterations=2"] if setting.solver.scheme == "alternating" else []
    return run(name, tmp_path, f"time.end={setting.time.dt!r}", "expect={}", *few, *overrides)


@pytest.mark.parametrize("name", sorted(QUICK))
def test_a_quick_scene_meets_what_it_expects(name: str, tmp_path: Path) -> None:
    """Exit code 0: the run reached its end and every verdict of `expect:` holds."""
    assert load_scene(SCENES / f"{name}.yaml").scene.expect is not None
    assert run(name, tmp_path) == 0


@pytest.mark.parametrize("name", sorted(set(NAMES) - QUICK))
def test_a_step_of_a_large_scene(name: str, tmp_path: Path) -> None:
    assert shortened(name, tmp_path) == 0


@pytest.mark.gallery
@pytest.mark.parametrize("name", sorted(set(NAMES) - QUICK))
def test_a_large_scene_meets_what_it_expects(name: str, tmp_path: Path) -> None:
    assert run(name, tmp_path) == 0


def real(name: str) -> list[str]:
    """What puts the paper's mesh in place of the recipe's."""
    member, file, how = REAL[name]
    if not (DATA / file).is_file():
        pytest.skip(f"{file} is not in {DATA}; FEMDEFORM_DATA names the folder above")
    found = [f"bodies.{member}.mesh={{file: {DATA / file}, {how}}}"]
    if name == "bunny-solid":
        found.append(f"bodies.bunny.skin={{file: {DATA / 'bunny.mesh'}, cell_type: triangle, drop_unreferenced: true}}")
    return found


@pytest.mark.parametrize("name", sorted(REAL))
def test_a_step_with_the_real_mesh(name: str, tmp_path: Path) -> None:
    assert shortened(name, tmp_path, *real(name)) == 0


@pytest.mark.parametrize(
    ("name", "weight"), [("bunny-solid", 8.212), ("bunny-shell", 0.06158), ("bunny-springs", 0.03886)]
)
def test_the_real_bunny_weighs_what_its_mesh_does(name: str, weight: float, tmp_path: Path) -> None:
    """Pulled and at rest, the supports together carry density times volume (or area, or length) times g."""
    mesh = real(name)
    simulation = loaded(name, *mesh)
    assert 9.81 * simulation.discretization.lumped_mass.sum() == pytest.approx(weight, rel=1e-3)
    assert run(name, tmp_path, *mesh, f"expect.measured={{weight: {{value: {weight}, rtol: 1.0e-3}}}}") == 0


# Width of a bar of Poisson ratio nu pulled freely to the stretch a, by the law itself.
a, mu, lam = 1.5, 0.5 / 1.45, 0.45 / (1.45 * 0.1)
OWN_WIDTH = {
    "arap": 1.0,
    # Stress across 2 mu (b - 1) + lambda (a + 2 b - 3) = 0.
    "corotated": 1.0 - lam * (a - 1.0) / (2.0 * (lam + mu)),
    # mu b + g'(J) a b = 0 with g' = (lambda + mu) (J - 1) - mu, J = a b^2.
    "neo-hookean": float(np.sqrt((1.0 + mu / (lam + mu) * (1.0 - 1.0 / a)) / a)),
}


@pytest.mark.parametrize("law", sorted(OWN_WIDTH))
def test_a_square_necks_by_its_law(law: str) -> None:
    """The middle of the stretched square draws in by what the law does to a free bar, across and in thickness."""
    simulation = loaded(f"square-{law}")
    for _ in range(4):
        forward(simulation)
    X, x = simulation.discretization.points, simulation.state.x
    middle = np.abs(X[:, 0] - 0.5) < 1e-9
    b = OWN_WIDTH[law]
    for axis in (1, 2):
        found = np.ptp(x[middle, axis]) / np.ptp(X[middle, axis])
        assert found == pytest.approx(b, abs=1e-9 if law == "arap" else 0.006 if axis == 1 else 0.03)


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


@pytest.mark.parametrize("stuff", ["soft", "stiff"])
def test_the_stiff_drop_is_that_of_a_rigid_body(stuff: str) -> None:
    """Fall, landing on an edge, tipping over and rest, against a rigid body in the same step; 1.7 m, 1 GPa or 1 MPa."""
    name, coarse = f"spot-{stuff}", "bodies.spot.mesh.element_size=0.15"
    simulation = loaded(name, coarse, "solver={method: mixed_fem}")
    twin = loaded(name, coarse)
    points, mass = simulation.discretization.points, simulation.discretization.lumped_mass
    gravity = np.array([0.0, -9.81, 0.0])
    rigid = RigidBody(points, mass, np.zeros_like(points), gravity, twin.problem.contacts)
    from_rigid_shape, from_rigid_body, turn = 0.0, 0.0, 0.0
    for _ in range(30):
        forward(simulation)
        rigid.step(simulation.scene.time.dt)
        x = simulation.state.x
        from_rigid_shape = max(from_rigid_shape, float(np.abs(x - best_fit(x, points, mass)).max()))
        from_rigid_body = max(from_rigid_body, float(np.abs(x - rigid.x).max()))
        turn = float(np.abs((x - points) - mass @ (x - points) / mass.sum()).max())
    assert turn > 0.5, "it has tipped over"
    if stuff == "stiff":
        assert from_rigid_shape < 1e-3
        assert from_rigid_body < 5e-3
    else:
        assert from_rigid_shape > 0.05


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
