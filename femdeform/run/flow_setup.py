"""From a checked scene of smoke and the meshes of its solids to a flow that can be stepped."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.inlets import Inlet
from femdeform.flow.mac_grid import MACGrid, PressureSolver
from femdeform.flow.pressure_system import PressureSystem
from femdeform.flow.smoke import MovingSolid, SmokeFlow, Source
from femdeform.flow.voxels import voxels_inside
from femdeform.run.closed_surface import closed_surface
from femdeform.scene.flow_places import SIDES, inlet_faces, inlet_velocity, inside
from femdeform.scene.flow_schema import FlowScene, SolidMotion
from femdeform.types import FloatArray, IntArray, Mesh


def build_flow(
    scene: FlowScene, meshes: Mapping[str, Mesh], make_solver: Callable[[PressureSystem], PressureSolver]
) -> SmokeFlow:
    """Wire a scene.

    Parameters
    ----------
    scene : FlowScene
        Checked by `femdeform.scene.flow_checks`.
    meshes : mapping of str to Mesh
        Of its solids.
    make_solver : callable
        Makes what solves for the pressure.

    Raises
    ------
    MissingDependencyError
        If the pressure solver needs a library that is not there.
    """
    grid = MACGrid(scene.grid.cells, scene.grid.cell_size, scene.grid.origin)
    solid = np.zeros(grid.shape, dtype=bool)
    moving = []
    for name, block in scene.solids.items():
        surface = closed_surface(meshes[name])
        if block.motion is None:
            solid |= voxels_inside(grid, *surface)
        else:
            moving.append(_moving_solid(grid, *surface, block.motion))
    sources = [
        Source(
            inside(source.region, grid.centres()),
            source.density,
            source.velocity,
            np.inf if source.end is None else source.end,
        )
        for source in scene.sources.values()
    ]
    inlets = [
        Inlet(*SIDES[inlet.side], inlet_faces(scene, inlet), inlet_velocity(scene, inlet), inlet.density)
        for inlet in scene.inlets.values()
    ]
    return SmokeFlow(
        grid,
        solid,
        _air(scene, grid),
        make_solver,
        scene.buoyancy,
        sources,
        moving,
        inlets,
        scene.linear_solver.tolerance,
        scene.linear_solver.max_iterations,
    )


def walls_behind(scene: FlowScene, source: Source) -> list[str]:
    """Sides of the grid that are walls, beside which a source blows away from them."""
    if source.velocity is None:
        return []
    return [
        side
        for side, (axis, end) in list(SIDES.items())[: 2 * scene.dim]
        if getattr(scene.boundaries, side) == "wall"
        and np.moveaxis(source.voxels, axis, 0)[end].any()
        and source.velocity[axis] * (1.0 if end == 0 else -1.0) > 0.0
    ]


def _air(scene: FlowScene, grid: MACGrid) -> NDArray[np.bool_]:
    air = np.zeros(grid.shape, dtype=bool)
    for side, (axis, end) in SIDES.items():
        if axis < grid.dim and getattr(scene.boundaries, side) == "open":
            np.moveaxis(air, axis, 0)[end] = True
    return air


def _moving_solid(grid: MACGrid, points: FloatArray, facets: IntArray, motion: SolidMotion) -> MovingSolid:
    dim = grid.dim
    used = points[np.unique(facets)]
    center = 0.5 * (used.min(axis=0) + used.max(axis=0)) if motion.center is None else np.array(motion.center)
    velocity = np.zeros(dim) if motion.velocity is None else np.array(motion.velocity)
    axis = np.array([0.0, 0.0, 1.0] if motion.axis is None else motion.axis)
    axis /= np.linalg.norm(axis)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    spin = motion.rate * cross[:dim, :dim]

    @lru_cache(maxsize=2)  # asked for several times in a step
    def voxels(time: float) -> NDArray[np.bool_]:
        angle = motion.rate * time
        # Rodrigues' formula; in the plane its upper left part.
        turn = (np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)[:dim, :dim]
        return voxels_inside(grid, center + velocity * time + (points - center) @ turn.T, facets)

    def velocities(time: float, at: FloatArray) -> FloatArray:
        return np.asarray(velocity + (at - center - velocity * time) @ spin.T)

    return MovingSolid(voxels, velocities)
