"""Problems whose prescribed degrees of freedom follow a given displacement field, which a scene cannot describe.

A scene's `fixed` conditions say which nodes, and which of their components, are held; a `PrescribedField` moves them.
"""

from __future__ import annotations

from collections.abc import Mapping

from femdeform.fem.conditions import Conditions
from femdeform.fem.discretization import Discretization
from femdeform.fem.node_sets import NodeSets
from femdeform.scene import schema
from femdeform.types import BoolArray, FloatArray, Mesh
from verification.manufactured import ManufacturedSolution
from verification.norms import Field, ShapeTable, tabulate, tabulate_facets


class PrescribedField(Conditions):
    """Conditions of a scene whose held degrees of freedom are displaced by a field, growing linearly over the run.

    Parameters
    ----------
    scene : DeformableScene
        Its `fixed` conditions choose the degrees of freedom.
    meshes : mapping of str to Mesh
    discretization : Discretization
    displacement : callable
        Displacement (n, dim) at reference positions (n, dim) at the end of the run [m].
    """

    def __init__(
        self,
        scene: schema.DeformableScene,
        meshes: Mapping[str, Mesh],
        discretization: Discretization,
        displacement: Field,
    ) -> None:
        super().__init__(scene, meshes, discretization)
        self._points = discretization.points
        self._target = displacement(discretization.points)
        self._load: FloatArray | None = None

    def add_load(self, load: FloatArray) -> None:
        """Add nodal forces (n_local, dim) at the end of the run [N]; they too grow linearly over it."""
        self._load = load if self._load is None else self._load + load

    def set_prescribed(self, time: float, x: FloatArray) -> None:
        """Write the prescribed positions at a time into `x` (n_local, dim)."""
        x[~self.free] = (self._points + time / self._end * self._target)[~self.free]

    def dead_load(self, time: float, out: FloatArray) -> None:
        """Write the dead loads at a time into `out` (n_local, dim) [N]."""
        super().dead_load(time, out)
        if self._load is not None:
            out += time / self._end * self._load


def manufactured_load(
    discretization: Discretization,
    meshes: Mapping[str, Mesh],
    free: BoolArray,
    solution: ManufacturedSolution,
    degree: int = 6,
) -> FloatArray:
    """Nodal forces that keep the only body of a problem in a manufactured solution.

    Parameters
    ----------
    discretization : Discretization
        The problem.
    meshes : mapping of str to Mesh
        Its only mesh.
    free : (n_local, dim) bool
        Degrees of freedom that are solved for. Boundary facets that touch one get the traction of the solution.
    solution : ManufacturedSolution
        What the body is to be kept in.
    degree : int
        Degree of the rule that integrates the forces.

    Returns
    -------
    (n_local, dim) float64
        [N]
    """
    ((name, mesh),) = meshes.items()
    load = body_table(discretization, degree).integrate_load(solution.body_force, discretization.n_nodes)
    facets = NodeSets(meshes, discretization.bodies).facet_nodes(name, mesh.facet_groups["boundary"])
    open_facets = facets[free[facets].any(axis=(1, 2))]
    if open_facets.size:
        table = tabulate_facets(discretization.points, open_facets, degree)
        load += table.integrate_load(solution.traction, discretization.n_nodes)
    return load


def body_table(discretization: Discretization, degree: int) -> ShapeTable:
    """Shape functions of a problem of one body at the points of a rule of a degree."""
    (body,) = discretization.bodies.values()
    return tabulate(discretization.points, body.connectivity, degree)
