"""The block that the benchmarks deform: a clamped, heavy, neo-Hookean cube, and states of it worth a Newton step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from femdeform import parallel
from femdeform.fem.incremental_potential import IncrementalPotential, State
from femdeform.run.setup import Simulation, build_simulation
from femdeform.scene.schema import DeformableScene
from femdeform.types import FloatArray
from meshes.build import build_mesh

YOUNGS_MODULUS = 1e5  # [Pa]
POISSON_RATIO = 0.3
DENSITY = 1000.0  # [kg/m^3]
DT = 0.01  # [s], in dynamics
_GRAVITY = 9.81  # [m/s^2]


def stiffness_number(cells: int) -> float:
    """Return kappa = h^2 E / (rho dx^2) of the block in dynamics: how much a step is a static problem [-]."""
    return DT**2 * YOUNGS_MODULUS / DENSITY * cells**2


def block_scene(cells: int, quasistatic: bool, linear_solver: dict[str, Any] | None = None) -> DeformableScene:
    """Return the scene: a unit cube of cells^3 grid cells, 5 tetrahedra each, held at x = 0, under gravity."""
    scheme = {"scheme": "quasistatic", "dt": 1.0} if quasistatic else {"scheme": "backward_euler", "dt": DT}
    material = {
        "law": "neo_hookean",
        "density": DENSITY,
        "youngs_modulus": YOUNGS_MODULUS,
        "poisson_ratio": POISSON_RATIO,
    }
    mesh = {"recipe": "block", "size": (1.0, 1.0, 1.0), "cells": (cells, cells, cells)}
    data: dict[str, Any] = {
        "schema_version": 1,
        "title": "Benchmark block",
        "simulation": "deformable",
        "bodies": {"block": {"mesh": mesh, "material": material}},
        "conditions": [{"kind": "fixed", "on": "block.left"}],
        "gravity": (0.0, -_GRAVITY, 0.0),
        "time": {**scheme, "end": 1.0},
    }
    if linear_solver is not None:
        data["linear_solver"] = linear_solver
    return DeformableScene.model_validate(data)


class Block:
    """The block as the runner would build it, on this rank.

    Parameters
    ----------
    cells : int
        Grid cells along an edge.
    quasistatic : bool
        Statics, else a step of `DT`.
    linear_solver : dict, optional
        As in a scene.

    Attributes
    ----------
    simulation : Simulation
    problem : IncrementalPotential
    """

    def __init__(self, cells: int, quasistatic: bool, linear_solver: dict[str, Any] | None = None) -> None:
        self.cells = cells
        self.quasistatic = quasistatic
        scene = block_scene(cells, quasistatic, linear_solver)
        mesh = build_mesh(scene.bodies["block"].mesh, Path())
        self.simulation: Simulation = build_simulation(scene, {"block": mesh}, parallel.world())
        assert isinstance(self.simulation.problem, IncrementalPotential)
        self.problem: IncrementalPotential = self.simulation.problem

    @property
    def n_cells(self) -> int:
        """Tetrahedra of the whole block."""
        return self.simulation.meshes["block"].n_cells

    def positions(self, amount: float) -> FloatArray:
        """Positions (n_local, 3) [m]: a stretch along x of 10 % and a sag of 5 cm, times `amount`, and noise.

        The noise, 1 % of an edge of the grid, keeps all element matrices different; the smooth part is what makes
        the linear system of statics hard. The same on any number of ranks.
        """
        points = self.simulation.discretization.all_points
        noise = np.random.default_rng(20240501).standard_normal(points.shape)
        displacement = amount * 0.01 / self.cells * noise
        displacement[:, 0] += amount * 0.1 * points[:, 0]
        displacement[:, 1] -= amount * 0.05 * points[:, 0] ** 2
        displacement[points[:, 0] == 0.0] = 0.0
        return self.simulation.discretization.partition.restrict(points + displacement)

    def begin(self, amount: float) -> FloatArray:
        """Begin a step whose first iterate is ``positions(amount)``, and return that.

        In dynamics the step also starts there, with 1 m/s downwards at the free end.
        """
        x = self.positions(amount)
        if self.quasistatic:
            reference = self.simulation.state
            self.problem.begin_step(reference, 1.0)
        else:
            velocity = np.zeros_like(x)
            velocity[:, 1] = -self.simulation.discretization.points[:, 0]
            self.problem.begin_step(State(x, velocity), DT)
        return x
