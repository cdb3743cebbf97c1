"""Meshes and scenes that the comparisons with exact solutions share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from femdeform.fem.incremental_potential import IncrementalPotential
from femdeform.jit import set_threads
from femdeform.run.setup import Simulation, build_simulation
from femdeform.run.time_loop import StepControl, run_time_loop
from femdeform.scene import schema
from femdeform.scene.load import load_scene
from femdeform.scene.mesh_schema import BlockMesh
from femdeform.scene.meshing import load_meshes
from femdeform.types import FloatArray, Mesh
from meshes.build import build_mesh

CASES = Path(__file__).parents[2] / "verification" / "cases"


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    """These problems are too small to share: on a busy machine a second thread makes them several times slower."""
    import numba

    before = numba.get_num_threads()
    set_threads(1)
    yield
    set_threads(before)


@pytest.fixture
def block() -> Callable[..., Mesh]:
    """Structured box, its points moved by a function of the points if given."""

    def build(
        cells: Sequence[int],
        size: Sequence[float] | None = None,
        split: int = 5,
        move: Callable[[FloatArray], FloatArray] | None = None,
    ) -> Mesh:
        sizes = [1.0] * len(cells) if size is None else list(size)
        source = BlockMesh.model_validate(
            {"recipe": "block", "size": sizes, "cells": list(cells), "split": split}
        )
        mesh = build_mesh(source, Path())
        return mesh if move is None else replace(mesh, points=mesh.points + move(mesh.points))

    return build


@pytest.fixture
def scene_of() -> Callable[..., schema.DeformableScene]:
    """Quasistatic scene of one body named `body`; the mesh block only stands for the mesh that the test builds."""

    def make(material: Mapping[str, Any], order: int, dim: int, **more: Any) -> schema.DeformableScene:
        body = {
            "mesh": {"recipe": "block", "size": [1.0] * dim, "cells": [1] * dim},
            "element_order": order,
            "material": {"density": 1.0, **material},
        }
        data: dict[str, Any] = {
            "simulation": "deformable",
            "bodies": {"body": body},
            "time": {"scheme": "quasistatic", "dt": 1.0},
        }
        return schema.DeformableScene.model_validate(data | more)

    return make


@pytest.fixture
def case() -> Callable[..., tuple[schema.DeformableScene, dict[str, Mesh]]]:
    """A scene of verification/cases, with overrides as on the command line, and its meshes."""

    def load(name: str, *overrides: str) -> tuple[schema.DeformableScene, dict[str, Mesh]]:
        loaded = load_scene(CASES / f"{name}.yaml", overrides)
        return loaded.scene, load_meshes(loaded)

    return load


@pytest.fixture
def run() -> Callable[..., tuple[Simulation, list[Any]]]:
    """Run a scene on given meshes without a result folder; the simulation and its states, the first included.

    `problem_class` replaces backward Euler by another time integration.
    """

    def go(
        scene: schema.DeformableScene,
        meshes: Mapping[str, Mesh],
        problem_class: type[IncrementalPotential] | None = None,
    ) -> tuple[Simulation, list[Any]]:
        simulation = build_simulation(scene, meshes)
        if problem_class is not None:
            simulation.problem = problem_class(simulation.discretization, simulation.conditions, False)
        states = [simulation.state]
        outcome = run_time_loop(
            simulation.problem,
            simulation.solver,
            StepControl(scene.time.dt, scene.time.end, scene.time.dt, halve=False),
            simulation.state,
            on_accept=lambda state, *_: states.append(state),
            on_failure=lambda *_: None,
            observe=lambda _: None,
        )
        simulation.linear_solver.destroy()
        assert outcome.finished, outcome.reason
        return simulation, states

    return go


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Name parameters by their name: `order=2` says more than `2`."""
    if isinstance(val, int):
        return f"{argname}={val}"
    if isinstance(val, np.ndarray):
        return argname
    return None
