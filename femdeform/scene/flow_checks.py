"""What the schema alone cannot judge about a flow: dimensions, places outside of the grid, meshes that do not close."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from femdeform import registry
from femdeform.scene.filled_mesh_checks import why_nothing_is_inside
from femdeform.scene.flow_places import SIDES, inlet_faces, inlet_velocity
from femdeform.scene.flow_schema import (
    BallRegion,
    BoxRegion,
    FlowPointQuantity,
    FlowScene,
    Inlet,
    Region,
    SmokeCentroid,
)
from femdeform.scene.key_path import KeyPath
from femdeform.scene.measured_checks import unmeasured_findings
from femdeform.scene.pressure_schema import LearnedPressureSolver
from femdeform.scene.validation import Finding
from femdeform.types import Mesh


def flow_findings(scene: FlowScene, meshes: Mapping[str, Mesh], folder: Path) -> Iterator[Finding]:
    """Findings about a scene that passed the schema.

    Parameters
    ----------
    scene : FlowScene
        The scene.
    meshes : mapping of str to Mesh
        Meshes of the solids.
    folder : Path
        Where files of weights are named from.
    """
    dimensions = list(_dimension_findings(scene))
    yield from dimensions
    if not dimensions:
        yield from _inlet_findings(scene)
    yield from _solid_findings(scene, meshes)
    yield from _measure_findings(scene)
    if isinstance(scene.linear_solver, LearnedPressureSolver):
        fault = registry.resolve(registry.WEIGHTS_FAULT)(scene.linear_solver, folder, scene.dim)
        if fault:
            yield Finding(("linear_solver", "weights"), fault)
    if scene.dim == 2:
        for side in ("back", "front"):
            if getattr(scene.boundaries, side) == "open":
                yield Finding(("boundaries", side), "a flow in the plane has no such side")


def _vectors(scene: FlowScene) -> Iterator[tuple[KeyPath, Sequence[float]]]:
    if scene.grid.origin is not None:
        yield ("grid", "origin"), scene.grid.origin
    for name, source in scene.sources.items():
        yield from _corners(("sources", name, "region"), source.region)
        if source.velocity is not None:
            yield ("sources", name, "velocity"), source.velocity
    for name, inlet in scene.inlets.items():
        if inlet.region is not None:
            yield from _corners(("inlets", name, "region"), inlet.region)
        if isinstance(inlet.velocity, tuple):
            yield ("inlets", name, "velocity"), inlet.velocity
    for name, solid in scene.solids.items():
        if solid.motion is not None:
            for key in ("velocity", "center"):
                vector = getattr(solid.motion, key)
                if vector is not None:
                    yield ("solids", name, "motion", key), vector
    for name, quantity in scene.measure.items():
        if isinstance(quantity, FlowPointQuantity):
            yield ("measure", name, "at"), quantity.at


def _corners(path: KeyPath, region: Region) -> Iterator[tuple[KeyPath, Sequence[float]]]:
    if isinstance(region, BoxRegion):
        yield (*path, "box", 0), region.box[0]
        yield (*path, "box", 1), region.box[1]
    if isinstance(region, BallRegion):
        yield (*path, "sphere", "center"), region.sphere.center


def _dimension_findings(scene: FlowScene) -> Iterator[Finding]:
    for path, vector in _vectors(scene):
        if len(vector) != scene.dim:
            yield Finding(path, f"needs {scene.dim} numbers in a grid of {scene.dim} dimensions, not {len(vector)}")


def _inlet_findings(scene: FlowScene) -> Iterator[Finding]:
    taken = {side: np.zeros(0, dtype=bool) for side in SIDES}
    sound = []
    for name, inlet in scene.inlets.items():
        path: KeyPath = ("inlets", name)
        if SIDES[inlet.side][0] >= scene.dim:
            yield Finding((*path, "side"), "a flow in the plane has no such side")
            continue
        if getattr(scene.boundaries, inlet.side) == "open":
            yield Finding((*path, "side"), f"is open (boundaries.{inlet.side}); an inlet is part of a wall")
        faces = inlet_faces(scene, inlet)
        if not faces.any():
            yield Finding((*path, "region"), f"no face of the side {inlet.side} has its centre inside")
        if taken[inlet.side].size and (taken[inlet.side] & faces).any():
            yield Finding(path, f"shares faces with another inlet of the side {inlet.side}")
        taken[inlet.side] = faces | taken[inlet.side] if taken[inlet.side].size else faces
        if inlet_velocity(scene, inlet)[SIDES[inlet.side][0]] == 0.0:
            yield Finding((*path, "velocity"), f"has no part across the side {inlet.side}; nothing comes in")
        sound.append(inlet)
    if sound:
        yield from _flux_findings(scene, sound)


def _flux_findings(scene: FlowScene, inlets: Sequence[Inlet]) -> Iterator[Finding]:
    """A box that nothing can leave takes no more than is drawn out."""
    if any(getattr(scene.boundaries, side) == "open" for side in list(SIDES)[: 2 * scene.dim]):
        return
    area = scene.grid.cell_size ** (scene.dim - 1)
    fluxes = []
    for inlet in inlets:
        axis, end = SIDES[inlet.side]
        inward = inlet_velocity(scene, inlet)[axis] * (1.0 if end == 0 else -1.0)
        fluxes.append(inward * area * float(np.count_nonzero(inlet_faces(scene, inlet))))
    net, unit = sum(fluxes), "m^3/s" if scene.dim == 3 else "m^2/s"
    if abs(net) > 1e-9 * sum(map(abs, fluxes)):
        yield Finding(
            ("inlets",),
            f"{'bring' if net > 0.0 else 'draw'} {abs(net):.3g} {unit} {'into' if net > 0.0 else 'out of'} a closed "
            "box; open a side in `boundaries`, or balance them by an inlet with a velocity outwards",
        )


def _solid_findings(scene: FlowScene, meshes: Mapping[str, Mesh]) -> Iterator[Finding]:
    for name, mesh in meshes.items():
        path: KeyPath = ("solids", name)
        fault = why_nothing_is_inside(mesh, scene.dim, "grid")
        if fault:
            yield Finding((*path, "mesh"), fault)
        motion = scene.solids[name].motion
        if motion is not None and motion.axis is not None and (scene.dim == 2 or len(motion.axis) != 3):
            yield Finding((*path, "motion", "axis"), "is for 3D, with three numbers; in the plane solids turn about z")


def _measure_findings(scene: FlowScene) -> Iterator[Finding]:
    low = scene.grid.origin or (0.0,) * scene.dim
    high = [a + n * scene.grid.cell_size for a, n in zip(low, scene.grid.cells, strict=False)]
    for name, quantity in scene.measure.items():
        if isinstance(quantity, (FlowPointQuantity, SmokeCentroid)) and quantity.component == "z" and scene.dim == 2:
            yield Finding(("measure", name, "component"), "a flow in the plane has no z")
        inside = (
            not isinstance(quantity, FlowPointQuantity)
            or len(quantity.at) != scene.dim
            or all(a <= x <= b for a, x, b in zip(low, quantity.at, high, strict=True))
        )
        if not inside:
            yield Finding(("measure", name, "at"), "lies outside of the grid")
    yield from unmeasured_findings(scene)
