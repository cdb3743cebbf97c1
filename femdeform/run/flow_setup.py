"""From a checked scene of smoke and the meshes of its solids to a flow that can be stepped."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.mac_grid import MACGrid, PressureSolver
from femdeform.flow.pressure_system import PressureSystem
from femdeform.flow.smoke import MovingSolid, SmokeFlow, Source
from femdeform.flow.voxels import voxels_inside
from femdeform.run.closed_surface import closed_surface
from femdeform.scene.flow_schema import BoxRegion, FlowScene, Region, SolidMotion
from femdeform.types import FloatArray, IntArray, Mesh

# Sides of the grid: the axis that crosses them, and which end of it they are.
_SIDES = {"left": (0, 0), "right": (0, -1), "bottom": (1, 0), "top": (1, -1), "back": (2, 0), "front": (2, -1)}


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
            _voxels_of(source.region, grid),
            source.density,
            source.velocity,
            np.inf if source.end is None else source.end,
        )
        for source in scene.sources.values()
    ]
    return SmokeFlow(
        grid,
        solid,
        _air(scene, grid),
        make_solver,
        scene.buoyancy,
        sources,
        moving,
        scene.linear_solver.tolerance,
        scene.linear_solver.max_iterations,
    )


def _air(scene: FlowScene, grid: MACGrid) -> NDArray[np.bool_]:
    air = np.zeros(grid.shape, dtype=bool)
    for side, (axis, end) in _SIDES.items():
        if axis < grid.dim and getattr(scene.boundaries, side) == "open":
            np.moveaxis(air, axis, 0)[end] = True
    return air


def _voxels_of(region: Region, grid: MACGrid) -> NDArray[np.bool_]:
    centres = grid.centres()
    if isinstance(region, BoxRegion):
        low, high = (np.array(corner) for corner in region.box)
        return np.asarray(((centres >= low) & (centres <= high)).all(axis=-1))
    offset = centres - np.array(region.sphere.center)
    return np.asarray((offset**2).sum(axis=-1) <= region.sphere.radius**2)


def _moving_solid(grid: MACGrid, points: FloatArray, facets: IntArray, motion: SolidMotion) -> MovingSolid:
    dim = grid.dim
    used = points[np.unique(facets)]
    center = 0.5 * (used.min(axis=0) + used.max(axis=0)) if motion.center is None else np.array(motion.center)
    velocity = np.zeros(dim) if motion.velocity is None else np.array(motion.velocity)
    axis = np.array([0.0, 0.0, 1.0] if motion.axis is None else motion.axis)
    axis /= np.linalg.norm(axis)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    spin = motion.rate * cross[:dim, :dim]

    def voxels(time: float) -> NDArray[np.bool_]:
        angle = motion.rate * time
        # Rodrigues' formula; in the plane its upper left part.
        turn = (np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)[:dim, :dim]
        return voxels_inside(grid, center + velocity * time + (points - center) @ turn.T, facets)

    def velocities(time: float, at: FloatArray) -> FloatArray:
        return np.asarray(velocity + (at - center - velocity * time) @ spin.T)

    return MovingSolid(voxels, velocities)
