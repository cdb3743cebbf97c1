"""Bodies with active muscle fibres: PBNG and FP-PXPBD find what projected Newton finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import advance, block, body, build, displacement, material, quasistatic, scene, step

from femdeform.errors import InputError
from femdeform.run.setup import Simulation

DIMS = pytest.mark.parametrize("dim", [2, 3])
LAWS = pytest.mark.parametrize("law", ["neo_hookean", "fixed_corotated", "logarithmic_neo_hookean"])
NEWTON = {"method": "projected_newton", "tolerance": 1e-11}


def muscle(dim: int, stress: float, optimal: float, times: list[float], direction: Any = (1.0, 0.3, 0.1)) -> Any:
    return {
        "fibres": {"kind": "constant", "direction": list(direction)[:dim]},
        "max_isometric_stress": stress,
        "optimal_stretch": optimal,
        "activation": {"times": times, "values": [0.0, 1.0]},
    }


def bar(dim: int, law: str, E: float, fibres: dict[str, Any], solver: dict[str, Any], **more: Any) -> Simulation:
    """A bar, one end fixed, the other held in x only, sagging while its fibres become active."""
    mesh = block([1.0, 0.25, 0.25][:dim], [8, 2, 2][:dim])
    return build(
        scene(
            {"m": body(mesh, material(law, E=E, nu=0.4), muscle=fibres)},
            {"kind": "fixed", "on": "m.left"},
            {"kind": "fixed", "on": "m.right", "components": ["x"]},
            gravity=[0.0, -9.81, 0.0][:dim],
            solver=solver,
            **more,
        )
    )


@DIMS
@LAWS
@pytest.mark.parametrize("optimal", [0.9, 1.3])
def test_pbng_agrees_in_statics(dim: int, law: str, optimal: float) -> None:
    """From inactive to fully active fibres that pull with three times E, longer and shorter than optimal."""
    fibres = muscle(dim, 3e5, optimal, [0.0, 1.0])
    found = []
    for solver in (NEWTON, {"method": "pbng", "tolerance": 1e-10, "max_iterations": 5000}):
        simulation = bar(dim, law, 1e5, fibres, solver, time=quasistatic(0.5))
        advance(simulation, 2)
        found.append(displacement(simulation))
    assert np.abs(found[0]).max() > 0.03
    assert np.abs(found[1] - found[0]).max() < 1e-8


@DIMS
def test_plain_sweeps_never_raise_the_energy(dim: int) -> None:
    """From stretched far beyond the optimal length, where steps are long."""
    values: list[float] = []
    fibres = muscle(dim, 1e6, 0.9, [-1.0, 0.0])
    solver = {"method": "pbng", "tolerance": 1e-9, "max_iterations": 3000, "check_every": 1}
    simulation = bar(dim, "fixed_corotated", 1e5, fibres, solver, time=quasistatic(1.0))
    problem = simulation.problem
    problem.begin_step(simulation.state, 1.0)
    X = simulation.discretization.points
    simulation.state.x[:] = X * ([1.7] + [0.7] * (dim - 1))
    simulation.state.x[~problem.free] = X[~problem.free]
    result = simulation.solver.step(problem, simulation.state, lambda row, _: values.append(float(row["objective"])))
    assert result.converged
    rises = np.diff(values)
    assert rises.max() <= 1e-12 * max(abs(value) for value in values)
    assert values[0] > values[-1] + 1.0


@DIMS
@LAWS
@pytest.mark.parametrize(("E", "optimal"), [(1e3, 1.3), (1e4, 0.9), (1e5, 1.2)])
def test_fp_pxpbd_agrees_in_dynamics(dim: int, law: str, E: float, optimal: float) -> None:
    """Stiffness numbers 0.006 to 0.6; the right end slides, so that some corners have one component prescribed."""
    fibres = muscle(dim, 2.0 * E, optimal, [0.0, 0.05])
    found = []
    for solver in (NEWTON, {"method": "fp_pxpbd", "tolerance": 1e-10, "max_iterations": 2000}):
        simulation = bar(dim, law, E, fibres, solver)
        advance(simulation, 6)
        found.append(displacement(simulation))
    assert np.abs(found[0]).max() > 0.02
    assert np.abs(found[1] - found[0]).max() < 1e-9


def test_pbng_with_acceleration_and_single_precision() -> None:
    fibres = muscle(3, 3e5, 1.2, [0.0, 1.0])
    found = []
    more = ({"acceleration": "anderson"}, {"precision": "float32"}, {"finish": "newton_krylov"})
    for options in ({}, *more):
        solver = {"method": "pbng", "tolerance": 1e-10, "max_iterations": 5000, **options} if options else NEWTON
        simulation = bar(3, "neo_hookean", 1e5, fibres, solver, time=quasistatic(0.5))
        advance(simulation, 2)
        found.append(displacement(simulation))
    for other in found[1:]:
        assert np.abs(other - found[0]).max() < 1e-8


def test_pbng_with_stiff_ties_between_muscles() -> None:
    """Nodes of the block of stiff rows feel the fibres around them too."""
    found = []
    for solver in (NEWTON, {"method": "pbng", "tolerance": 1e-9, "max_iterations": 5000}):
        fibres = [muscle(3, 2e5, 1.2, [0.0, 1.0]), muscle(3, 1e5, 1.0, [0.0, 1.0], (1.0, 0.0, 0.0))]
        meshes = [block([1.0, 0.25, 0.25], [6, 2, 2]), block([1.0, 0.25, 0.25], [6, 2, 2], translate=[0.0, 0.25, 0.0])]
        bodies = {
            name: body(mesh, material("neo_hookean"), muscle=own)
            for name, mesh, own in zip("ab", meshes, fibres, strict=True)
        }
        simulation = build(
            scene(
                bodies,
                {"kind": "fixed", "on": "a.left"},
                {"kind": "fixed", "on": "b.left"},
                links={"skin": {"kind": "tie", "on": "b.bottom", "to": "a.top", "stiffness": 1e8}},
                solver=solver,
                time=quasistatic(1.0),
            )
        )
        step(simulation)
        found.append(displacement(simulation))
    assert np.abs(found[0]).max() > 0.1
    assert np.abs(found[1] - found[0]).max() < 1e-7


def test_isometric_force() -> None:
    """A bar held at its optimal length, its sides free: fibres add sigma/l_o to the stress at every activation."""
    stress, optimal = 1e5, 1.2
    data = scene(
        {
            "m": body(
                block([1.0, 0.2, 0.2], [4, 1, 1]),
                material("neo_hookean", E=1e4, nu=0.3),
                muscle=muscle(3, stress, optimal, [0.0, 1.0], (1.0, 0.0, 0.0)),
            )
        },
        {"kind": "fixed", "on": "m.left", "components": ["x"]},
        {"kind": "fixed", "on": "m.bottom", "components": ["y"]},
        {"kind": "fixed", "on": "m.back", "components": ["z"]},
        {"kind": "translate", "on": "m.right", "components": ["x"], "velocity": [0.2, 0.0, 0.0], "stop": 1.0},
        time=quasistatic(1.0, 3.0),
        solver=NEWTON,
    )
    data["bodies"]["m"]["muscle"]["activation"] = {"times": [1.0, 2.0, 3.0], "values": [0.0, 0.5, 1.0]}
    simulation = build(data)
    forces = []
    for _ in range(3):
        step(simulation)
        reaction = simulation.problem.full_gradient(simulation.state.x)
        right = simulation.discretization.points[:, 0] > 0.999
        forces.append(float(reaction[right, 0].sum()))
    # The matrix is the same in all three, for fibres push nothing sideways.
    assert np.diff(forces) == pytest.approx(0.5 * stress / optimal * 0.2 * 0.2, rel=1e-8)


@pytest.mark.parametrize(
    "solver",
    [
        {"method": "mixed_fem"},
        {"method": "xpbd"},
        {"method": "pbd"},
        {"method": "b_pxpbd"},
    ],
    ids=lambda solver: solver["method"],
)
def test_other_methods_refuse_muscles(solver: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="does not know muscle fibres"):
        bar(3, "fixed_corotated", 1e5, muscle(3, 1e5, 1.2, [0.0, 1.0]), solver)


def bound_spindles(solver: dict[str, Any]) -> Simulation:
    """Two muscles held at both ends, one pressed on the other: tissue on a part of the surface, contact elsewhere."""
    mesh = {"recipe": "muscle", "length": 0.2, "radius": 0.025, "end_radius": 0.015, "tendon_length": 0.03}
    down, bodies = [0.0, -0.012, 0.0], {}
    for name, cells, up in (("a", [10, 3], 0.0), ("b", [9, 3], 0.0502)):
        bodies[name] = {
            "mesh": {**mesh, "cells": cells, "translate": [0.0, up, 0.0]},
            "material": material("fixed_corotated", E=1e5, nu=0.45),
            "muscles": {"belly": muscle(3, 1e5, 1.4, [0.0, 1.0], (1.0, 0.0, 0.0))},
        }
    closer = [{"kind": "translate", "on": f"b.{end}_bone", "velocity": down} for end in ("origin", "insertion")]
    return build(
        scene(
            bodies,
            {"kind": "fixed", "on": "a.origin_bone"},
            {"kind": "fixed", "on": "a.insertion_bone"},
            *closer,
            links={
                "tissue": {
                    "kind": "binding",
                    "on": {"box": [[0.03, 0.0, -0.03], [0.085, 0.05, 0.03]], "body": "a"},
                    "to": "b",
                    "stiffness": 1e8,
                    "within": 0.015,
                }
            },
            contact={"method": "weak_constraints", "stiffness": 1e8, "self_contact": False},
            solver=solver,
            time=quasistatic(0.25),
        )
    )


def test_pbng_with_binding_and_contact_between_muscles() -> None:
    """Nodes of tissue and of contact are one block, in which fibres become more active from step to step."""
    found, touching = [], []
    for solver in ({**NEWTON, "tolerance": 1e-10}, {"method": "pbng", "tolerance": 1e-8, "max_iterations": 5000}):
        simulation = bound_spindles(solver)
        for _ in range(4):
            step(simulation)
            found.append(displacement(simulation))
        contact = simulation.problem.weak_contact
        assert contact is not None
        touching.append(contact.count(simulation.state.x))
    assert np.abs(found[3]).max() > 0.004
    assert touching[0] == touching[1] > 0
    for newton, pbng in zip(found[:4], found[4:], strict=True):
        assert np.abs(pbng - newton).max() < 1e-7


def test_the_stiff_block_follows_the_activation() -> None:
    """A block of tied nodes minimises the energy of the step's own activation, in every step."""
    simulation = bound_spindles({"method": "pbng", "tolerance": 1e-6, "max_iterations": 5000})
    for number in range(1, 4):
        problem = simulation.problem
        problem.begin_step(simulation.state, 0.25)
        sweep = simulation.solver.sweep_of(problem, "float64")
        assert sweep.block is not None
        x = problem.initial_guess(simulation.state)
        flat, loads = sweep.flat(x), np.zeros(3 * len(x))
        for _ in range(40):
            sweep.block.move(flat, loads)
            sweep.block.renew()
        sweep.unflat(flat, x)
        force = problem.gradient(x)[sweep.block.nodes]
        # The pull of fibres that are less active by a quarter would stand out.
        before = problem.gradient(problem.initial_guess(simulation.state))[sweep.block.nodes]
        assert np.abs(force).max() < 1e-6 * np.abs(before).max(), number
        step(simulation, 0.25)


@DIMS
@pytest.mark.parametrize("slides", [False, True])
def test_residuals_of_fp_pxpbd_add_up_with_fibres(dim: int, slides: bool) -> None:
    """What the corners miss and what stresses and fibres miss is the residual, long before convergence."""
    solver = {"method": "fp_pxpbd", "iterations": 3}
    components = ["x"] if slides else list("xyz"[:dim])
    data = scene(
        {
            "m": body(
                block([1.0, 0.25, 0.25][:dim], [6, 2, 2][:dim]),
                material("fixed_corotated", E=1e4, nu=0.4),
                muscle=muscle(dim, 2e4, 0.9, [0.0, 0.05]),
            )
        },
        {"kind": "fixed", "on": "m.left"},
        {"kind": "fixed", "on": "m.right", "components": components},
        gravity=[0.0, -9.81, 0.0][:dim],
        solver=solver,
    )
    simulation = build(data)
    problem = simulation.problem
    for number in range(4):
        problem.begin_step(simulation.state, 0.01)
        result = simulation.solver.step(problem, simulation.state)
        sweep = simulation.solver.sweep_of(problem)
        primary, secondary = sweep.residual_parts(problem)
        residual = problem.gradient(result.x)
        # Rounding is that of the forces that all but cancel.
        np.testing.assert_allclose(primary + secondary, residual, rtol=0.0, atol=1e-12 * problem.force_scale)
        assert np.abs(secondary).max() > 1e-6 * np.abs(residual).max(), number
        simulation.state = problem.accept(simulation.state, result.x)
