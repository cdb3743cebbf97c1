"""Supports, prescribed motions, loads and initial velocities of a scene, evaluated on this rank's nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from femdeform.fem.discretization import Discretization
from femdeform.fem.node_sets import NodeSets, facet_loads, facet_measure, holds_facets
from femdeform.scene import schema
from femdeform.scene.amplitude_schema import Amplitude
from femdeform.scene.selection_schema import Selection
from femdeform.scene.selections import select_facets, select_nodes
from femdeform.types import BoolArray, FloatArray, IntArray, Mesh


@dataclass(frozen=True)
class Curve:
    """A factor over time: piecewise linear, constant outside its range."""

    times: FloatArray
    values: FloatArray

    def __call__(self, time: float) -> float:
        return float(np.interp(time, self.times, self.values))


def amplitude_curve(amplitude: Amplitude | None, end: float, quasistatic: bool) -> Curve:
    """Curve of a load: as given, else a ramp over a quasistatic run, else one."""
    if amplitude is not None:
        return Curve(np.array(amplitude.times), np.array(amplitude.values))
    return Curve(np.array([0.0, end]), np.array([0.0 if quasistatic else 1.0, 1.0]))


@dataclass(frozen=True)
class PrescribedMotion:
    """One condition that sets positions: nodes, the components it holds, and where they are at a time.

    Attributes
    ----------
    nodes : (n,) int64
        Local nodes.
    components : (dim,) bool
        Components it prescribes.
    reference : (n, dim) float64
        Reference positions of the nodes [m].
    condition : schema condition
    center : (dim,) float64
        A point of the axis of rotation [m].
    """

    nodes: IntArray
    components: BoolArray
    reference: FloatArray
    condition: schema.Fixed | schema.Translate | schema.Rotate | schema.Twist | schema.Path
    center: FloatArray

    def positions(self, time: float) -> FloatArray:
        """Positions (n, dim) at a time [m]."""
        return self.carry(self.reference, None, time)

    def carry(self, points: FloatArray, before: float | None, after: float) -> FloatArray:
        """Where the motion takes points (n, dim) from one time to another [m]; from the reference state if None."""
        condition = self.condition
        if isinstance(condition, schema.Fixed):
            return points
        if isinstance(condition, schema.Path):
            return np.asarray(points + self._path(after) - (0.0 if before is None else self._path(before)))
        elapsed = self._elapsed(after) - (0.0 if before is None else self._elapsed(before))
        if isinstance(condition, schema.Translate):
            return points + elapsed * np.array(condition.velocity)
        offset = points - self.center
        angle = condition.rate * elapsed
        if condition.axis is None:
            turned = rotate_planar(offset, angle)
        else:
            axis = np.array(condition.axis) / np.linalg.norm(condition.axis)
            turned = rotate_spatial(offset, axis, angle)
            if isinstance(condition, schema.Twist):
                turned = turned + elapsed * condition.elongation_rate * axis
        return np.asarray(self.center + turned)

    def _path(self, time: float) -> FloatArray:
        assert isinstance(self.condition, schema.Path)
        table = np.array(self.condition.displacements)
        return np.array([np.interp(time, self.condition.times, column) for column in table.T])

    def _elapsed(self, time: float) -> float:
        """Time for which the motion has lasted [s]."""
        condition = self.condition
        assert isinstance(condition, (schema.Translate, schema.Rotate))
        stop = np.inf if condition.stop is None else condition.stop
        return max(min(time, stop) - condition.start, 0.0)


def rotate_planar(vectors: FloatArray, angle: float) -> FloatArray:
    """Rotate (n, 2) vectors by an angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(vectors @ np.array([[c, s], [-s, c]]))


def rotate_spatial(vectors: FloatArray, axis: FloatArray, angle: float) -> FloatArray:
    """Rotate (n, 3) vectors about a unit axis by an angle [rad] (Rodrigues' formula)."""
    along = (vectors @ axis)[:, None] * axis
    across = vectors - along
    return np.asarray(along + np.cos(angle) * across + np.sin(angle) * np.cross(axis, across))


@dataclass(frozen=True)
class FacetPressure:
    """Facets under pressure on the deformed surface, seen by the rank that owns their first node.

    Attributes
    ----------
    facets : (n, n_nodes) int64
        Local nodes, corners first.
    n_corners : int
        2 for edges of triangles, 3 for triangles of tets.
    pressure : float
        Pressure at amplitude 1 [Pa].
    curve : Curve
        Factor over time.
    """

    facets: IntArray
    n_corners: int
    pressure: float
    curve: Curve


class Conditions:
    """All conditions of a scene on this rank.

    Parameters
    ----------
    scene : DeformableScene
    meshes : mapping of str to Mesh
    discretization : Discretization

    Attributes
    ----------
    free : (n_local, dim) bool
        Degrees of freedom that no condition prescribes.
    notices : list of str
        What the user should know: conditions that meet on the same nodes.
    """

    def __init__(
        self, scene: schema.DeformableScene, meshes: Mapping[str, Mesh], discretization: Discretization
    ) -> None:
        self._discretization = discretization
        self._sets = NodeSets(meshes, discretization.bodies)
        self._meshes = dict(meshes)
        self._quasistatic = scene.time.scheme == "quasistatic"
        self._end = scene.time.end
        self.notices: list[str] = []
        self.motions: list[PrescribedMotion] = []
        self._moved: list[IntArray] = []  # nodes of the whole problem of each motion: every rank says the same
        self.pressures: list[FacetPressure] = []
        self._loads: list[tuple[Curve, FloatArray]] = []
        self.gravity = np.zeros(discretization.dim) if scene.gravity is None else np.array(scene.gravity)
        self.gravity_curve = amplitude_curve(scene.gravity_amplitude, self._end, self._quasistatic)
        self.initial_velocity = np.zeros_like(discretization.points)
        for number, condition in enumerate(scene.conditions):
            if isinstance(condition, schema.Traction):
                self._add_traction(condition)
            elif isinstance(condition, schema.Pressure):
                self._add_pressure(condition)
            elif isinstance(condition, schema.PointLoad):
                self._add_point_load(condition)
            elif isinstance(condition, schema.InitialVelocity):
                self._add_initial_velocity(condition)
            else:
                self._add_motion(number, condition)
        self.free: BoolArray = np.ones(discretization.points.shape, dtype=bool)
        for motion in self.motions:
            self.free[np.ix_(motion.nodes, np.flatnonzero(motion.components))] = False

    # ---------------------------------------------------------------------------------------- evaluation

    def set_prescribed(self, time: float, x: FloatArray) -> None:
        """Write the prescribed positions at a time into `x` (n_local, dim); later conditions win on shared nodes."""
        for motion in self.motions:
            where = np.ix_(motion.nodes, np.flatnonzero(motion.components))
            x[where] = motion.positions(time)[:, motion.components]

    def dead_load(self, time: float, out: FloatArray) -> None:
        """Write gravity-free dead loads (tractions, point loads) at a time into `out` (n_local, dim) [N]."""
        out[:] = 0.0
        for curve, load in self._loads:
            out += curve(time) * load

    def acceleration(self, time: float) -> FloatArray:
        """Acceleration of gravity at a time (dim,) [m/s^2]."""
        return self.gravity_curve(time) * self.gravity

    # ------------------------------------------------------------------------------------------ building

    def nodes(self, selection: Selection) -> IntArray:
        """Nodes of the whole problem that a selection means."""
        if isinstance(selection, str) and "." in selection:
            body, group = selection.split(".", 1)
            if group in self._meshes[body].facet_groups:
                return self._sets.from_facets(body, self._meshes[body].facet_groups[group])
        parts = [self._sets.from_points(body, n) for body, n in select_nodes(selection, self._meshes).items()]
        return np.unique(np.concatenate(parts))

    def local_nodes(self, selection: Selection) -> IntArray:
        """Local numbers of the selected nodes that this rank holds."""
        return self._discretization.to_local(self.nodes(selection))

    def _centroid(self, nodes: IntArray) -> FloatArray:
        return np.asarray(self._discretization.all_points[nodes].mean(axis=0))

    def _add_motion(
        self, number: int, condition: schema.Fixed | schema.Translate | schema.Rotate | schema.Twist | schema.Path
    ) -> None:
        dim = self._discretization.dim
        components = np.ones(dim, dtype=bool)
        if condition.components is not None:
            components = np.array([axis in condition.components for axis in "xyz"[:dim]])
        chosen = self.nodes(condition.on)
        center = np.zeros(dim)
        if isinstance(condition, schema.Rotate):
            center = self._centroid(chosen) if condition.center is None else np.array(condition.center)
        nodes = self._discretization.to_local(chosen)
        for earlier, taken in zip(self.motions, self._moved, strict=True):
            shared = np.intersect1d(taken, chosen)
            both_fixed = isinstance(earlier.condition, schema.Fixed) and isinstance(condition, schema.Fixed)
            if shared.size and not both_fixed and (earlier.components & components).any():
                self.notices.append(
                    f"conditions[{number}] ({condition.kind}) takes over {shared.size} nodes that an earlier "
                    f"{earlier.condition.kind} condition also moves"
                )
        self._moved.append(chosen)
        self.motions.append(PrescribedMotion(nodes, components, self._discretization.points[nodes], condition, center))

    def _scatter(self, nodes: IntArray, forces: FloatArray) -> FloatArray:
        """Sum forces at nodes of the whole problem into a field of this rank; every rank sees every force."""
        load = np.zeros_like(self._discretization.points)
        local = self._discretization.local_numbers[nodes]
        held = local >= 0
        np.add.at(load, local[held], forces[held])
        return load

    def _add_traction(self, condition: schema.Traction) -> None:
        value = np.array(condition.value)
        load = np.zeros_like(self._discretization.points)
        for body, facets in select_facets(condition.on, self._meshes).items():
            nodes = self._sets.facet_nodes(body, facets)
            share = facet_loads(facets.shape[1], nodes.shape[1])
            measure = facet_measure(self._meshes[body].points, facets)
            forces = (measure[:, None] * share)[..., None] * value
            load += self._scatter(nodes.ravel(), forces.reshape(-1, value.size))
        self._loads.append((amplitude_curve(condition.amplitude, self._end, self._quasistatic), load))

    def _add_pressure(self, condition: schema.Pressure) -> None:
        curve = amplitude_curve(condition.amplitude, self._end, self._quasistatic)
        for body, facets in select_facets(condition.on, self._meshes).items():
            nodes = self._sets.facet_nodes(body, facets)
            local = self._discretization.local_numbers[nodes]
            owned = holds_facets(self._discretization, body, self._meshes[body], facets)
            self.pressures.append(FacetPressure(local[owned], facets.shape[1], condition.value, curve))

    def _add_point_load(self, condition: schema.PointLoad) -> None:
        nodes = self.nodes(condition.on)
        forces = np.tile(np.array(condition.force) / nodes.size, (nodes.size, 1))
        curve = amplitude_curve(condition.amplitude, self._end, self._quasistatic)
        self._loads.append((curve, self._scatter(nodes, forces)))

    def _add_initial_velocity(self, condition: schema.InitialVelocity) -> None:
        chosen = self.nodes(condition.on)
        local = self._discretization.to_local(chosen)
        velocity = np.zeros((local.size, self._discretization.dim))
        if condition.velocity is not None:
            velocity += np.array(condition.velocity)
        if condition.angular_velocity is not None:
            center = self._centroid(chosen) if condition.center is None else np.array(condition.center)
            offset = self._discretization.points[local] - center
            if isinstance(condition.angular_velocity, tuple):
                velocity += np.cross(np.array(condition.angular_velocity), offset)
            else:
                velocity += condition.angular_velocity * np.stack([-offset[:, 1], offset[:, 0]], axis=1)
        self.initial_velocity[local] = velocity
