"""What the schema alone cannot judge about a flow: dimensions, places outside of the grid, meshes that do not close."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from femdeform.scene.filled_mesh_checks import why_nothing_is_inside
from femdeform.scene.flow_schema import BallRegion, BoxRegion, FlowPointQuantity, FlowScene, SmokeCentroid
from femdeform.scene.key_path import KeyPath
from femdeform.scene.measured_checks import unmeasured_findings
from femdeform.scene.validation import Finding
from femdeform.types import Mesh


def flow_findings(scene: FlowScene, meshes: Mapping[str, Mesh]) -> Iterator[Finding]:
    """Findings about a scene that passed the schema.

    Parameters
    ----------
    scene : FlowScene
        The scene.
    meshes : mapping of str to Mesh
        Meshes of the solids.
    """
    yield from _dimension_findings(scene)
    yield from _solid_findings(scene, meshes)
    yield from _measure_findings(scene)
    if scene.dim == 2:
        for side in ("back", "front"):
            if getattr(scene.boundaries, side) == "open":
                yield Finding(("boundaries", side), "a flow in the plane has no such side")


def _vectors(scene: FlowScene) -> Iterator[tuple[KeyPath, Sequence[float]]]:
    if scene.grid.origin is not None:
        yield ("grid", "origin"), scene.grid.origin
    for name, source in scene.sources.items():
        if isinstance(source.region, BoxRegion):
            yield ("sources", name, "region", "box", 0), source.region.box[0]
            yield ("sources", name, "region", "box", 1), source.region.box[1]
        if isinstance(source.region, BallRegion):
            yield ("sources", name, "region", "sphere", "center"), source.region.sphere.center
        if source.velocity is not None:
            yield ("sources", name, "velocity"), source.velocity
    for name, solid in scene.solids.items():
        if solid.motion is not None:
            for key in ("velocity", "center"):
                vector = getattr(solid.motion, key)
                if vector is not None:
                    yield ("solids", name, "motion", key), vector
    for name, quantity in scene.measure.items():
        if isinstance(quantity, FlowPointQuantity):
            yield ("measure", name, "at"), quantity.at


def _dimension_findings(scene: FlowScene) -> Iterator[Finding]:
    for path, vector in _vectors(scene):
        if len(vector) != scene.dim:
            yield Finding(path, f"needs {scene.dim} numbers in a grid of {scene.dim} dimensions, not {len(vector)}")


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
