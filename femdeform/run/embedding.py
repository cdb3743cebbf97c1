"""From a scene with a grid to its step problem."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from femdeform.contact.obstacles import smooth_parts
from femdeform.fem.conditions import Conditions
from femdeform.fem.discretization import Discretization
from femdeform.fem.incremental_potential import IncrementalPotential
from femdeform.mpm.embedded_potential import EmbeddedPotential
from femdeform.mpm.grid import Grid
from femdeform.mpm.walls import Wall
from femdeform.scene import schema
from femdeform.types import Mesh


def embed(
    scene: schema.DeformableScene,
    meshes: Mapping[str, Mesh],
    discretization: Discretization,
    conditions: Conditions,
    notices: list[str],
) -> EmbeddedPotential:
    """The step problem of a scene with a grid.

    Raises
    ------
    InputError
        If two motions that differ hold the same grid nodes where bodies start.
    """
    grid = scene.grid
    assert grid is not None
    for name, mesh in meshes.items():
        edges = mesh.points[mesh.cells] - mesh.points[np.roll(mesh.cells, 1, axis=1)]
        longest = float(np.sqrt(np.max(np.einsum("eac,eac->ea", edges, edges))))
        if longest > 2.0 * grid.cell_size and len(meshes) > 1:
            notices.append(
                f"bodies.{name}: edges of up to {longest:.3g} m are longer than two cells of the grid, "
                f"{grid.cell_size:.3g} m each: other bodies may pass between its nodes"
            )
    dim = discretization.dim
    walls = [
        Wall(part, np.zeros(dim) if obstacle.velocity is None else np.array(obstacle.velocity), obstacle.friction)
        for obstacle in scene.obstacles
        for part in smooth_parts(obstacle)
    ]
    bodies = IncrementalPotential(discretization, conditions, quasistatic=True)
    return EmbeddedPotential(bodies, Grid(grid.cell_size, grid.kernel), walls, grid.obstacles, grid.cfl)
