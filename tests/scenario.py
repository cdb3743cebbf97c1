"""Small scenes for tests: made from plain data, through the same checks as a file, and stepped in this process."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import InputError
from femdeform.fem.incremental_potential import State
from femdeform.jit import set_threads
from femdeform.run.setup import Simulation, build_simulation
from femdeform.run.time_loop import Problem, take_step
from femdeform.scene.checks import check_scene
from femdeform.scene.load import load_scene
from femdeform.scene.meshing import load_meshes
from femdeform.step_problem import StepResult

Array = NDArray[np.float64]


def material(law: str = "neo_hookean", E: float = 1.0e5, nu: float = 0.3, density: float = 1000.0) -> dict[str, Any]:
    """Material block."""
    return {"law": law, "youngs_modulus": float(E), "poisson_ratio": nu, "density": float(density)}


def block(size: Sequence[float], cells: Sequence[int], **more: Any) -> dict[str, Any]:
    """Mesh block of the structured recipe; the number of sizes is the dimension of a solid."""
    return {"recipe": "block", "size": [float(s) for s in size], "cells": list(cells), **more}


def body(mesh: dict[str, Any], stuff: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    """Body block."""
    return {"mesh": mesh, "material": material() if stuff is None else stuff, **more}


def scene(bodies: dict[str, Any], *conditions: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Scene as plain data: backward Euler with dt = 0.01, SciPy's solver, unless said otherwise."""
    return {
        "schema_version": 1,
        "simulation": "deformable",
        "bodies": bodies,
        "conditions": list(conditions),
        "time": {"scheme": "backward_euler", "dt": 0.01, "end": 1.0},
        "linear_solver": {"method": "scipy_direct"},
        **more,
    }


def quasistatic(dt: float = 1.0, end: float = 1.0) -> dict[str, Any]:
    """Time block of a quasistatic run."""
    return {"scheme": "quasistatic", "dt": float(dt), "end": float(end)}


def write(data: dict[str, Any], path: Path) -> Path:
    """Write a scene to a file (JSON is YAML)."""
    path.write_text(json.dumps(data, indent=1), encoding="utf-8")
    return path


def build(data: dict[str, Any]) -> Simulation:
    """Check a scene as `femdeform check` does and wire it."""
    with tempfile.TemporaryDirectory() as folder:
        loaded = load_scene(write(data, Path(folder) / "scene.yaml"))
        meshes = load_meshes(loaded)
        faults = check_scene(loaded, meshes)
        if faults:
            raise InputError(faults)
        simulation = build_simulation(loaded.scene, meshes)
    # These meshes are done before a second thread has woken up; tests of threads run as processes.
    set_threads(1)
    return simulation


def step(simulation: Simulation, dt: float | None = None) -> StepResult:
    """One step, which has to converge; the simulation's state moves on."""
    problem, state = simulation.problem, simulation.state
    result = take_step(problem, simulation.solver, state, simulation.scene.time.dt if dt is None else dt)
    assert result.converged, result.reason
    simulation.state = problem.accept(state, result.x)
    return result


def advance(simulation: Simulation, steps: int) -> State:
    """That many steps of the scene's size, all of which have to converge."""
    for _ in range(steps):
        step(simulation)
    return simulation.state


def run(data: dict[str, Any]) -> Simulation:
    """Build a scene and step to its end."""
    simulation = build(data)
    n = round(simulation.scene.time.end / simulation.scene.time.dt)
    advance(simulation, n)
    return simulation


# ------------------------------------------------------------------------------------------- looking inside


def displacement(simulation: Simulation) -> Array:
    """Displacements of all nodes [m], (n_nodes, dim)."""
    return simulation.state.x - simulation.discretization.points


def dense_hessian(problem: Problem, x: Array, project: bool, everything: bool = False) -> Array:
    """Hessian of Phi as a dense matrix (n_nodes dim, n_nodes dim); `everything` keeps prescribed rows."""
    import scipy.sparse

    free = np.ones_like(problem.free) if everything else None
    K = problem.hessian(x, project, free=free)
    n = x.size
    return scipy.sparse.csr_matrix((K.values.copy(), K.columns, K.row_offsets), shape=(n, n)).toarray()


def cell_matrices(term: Any, x: Array, project: bool) -> Array:
    """Hessians of the cells of one term as dense matrices, (n_cells, k dim, k dim)."""
    n, k = term.cells.shape
    d = x.shape[1]
    a, b = np.triu_indices(k)
    blocks = np.empty((n * a.size, d * d))
    term.hessian(x, project, blocks, 0)
    upper = blocks.reshape(n, a.size, d, d)
    full = np.zeros((n, k, d, k, d))
    full[:, a, :, b, :] = upper.transpose(1, 0, 2, 3)
    full[:, b, :, a, :] = upper.transpose(1, 0, 3, 2)
    return full.reshape(n, k * d, k * d)


def term_gradient(term: Any, x: Array) -> Array:
    """Gradient of one term at the nodes, (n_nodes, dim)."""
    n, k = term.cells.shape
    slots = np.empty((n * k, x.shape[1]))
    term.gradient(x, slots, 0)
    out = np.zeros_like(x)
    np.add.at(out, term.cells.ravel(), slots)
    return out


def difference_gradient(value: Any, x: Array, step: float) -> Array:
    """Central differences of a scalar function of a field."""
    out = np.empty(x.size)
    for i in range(x.size):
        e = np.zeros(x.size)
        e[i] = step
        out[i] = (value(x + e.reshape(x.shape)) - value(x - e.reshape(x.shape))) / (2.0 * step)
    return out.reshape(x.shape)


def difference_matrix(gradient: Any, x: Array, step: float) -> Array:
    """Central differences of a field-valued function of a field, (size, size): column j belongs to x_j."""
    columns = []
    for i in range(x.size):
        e = np.zeros(x.size)
        e[i] = step
        columns.append((gradient(x + e.reshape(x.shape)) - gradient(x - e.reshape(x.shape))).ravel() / (2.0 * step))
    return np.stack(columns, axis=1)


def random_state(points: Array, amplitude: float, seed: int = 0) -> Array:
    """Reference positions with random shifts of that size [m]."""
    return points + amplitude * np.random.default_rng(seed).uniform(-1.0, 1.0, points.shape)


def rotation(dim: int, seed: int = 0) -> Array:
    """A random rotation matrix."""
    Q, R = np.linalg.qr(np.random.default_rng(seed).standard_normal((dim, dim)))
    Q = Q * np.sign(np.diag(R))
    if np.linalg.det(Q) < 0.0:
        Q[:, 0] *= -1.0
    return np.asarray(Q)
