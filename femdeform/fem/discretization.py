"""From meshes to the constant operators of the finite element method; the only module that uses scikit-fem.

Every body becomes one or more `ElementGroup`s (cells of one kind, order and material) over one common node numbering.
Gradients, quadrature weights and masses are evaluated once, here; what changes with the deformation is evaluated by
the kernels of `femdeform.fem.kernels`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from femdeform.errors import Fault, InputError, MeshError
from femdeform.fem.fibres import FibreCells, FibreInput, fibre_cells
from femdeform.parallel import Partition
from femdeform.types import BoolArray, FloatArray, IntArray, Mesh

Kind = Literal["solid", "membrane", "rod"]

# Cells whose shape functions are evaluated at once: what is made on the way takes a kilobyte a cell.
_BATCH = 1 << 16


@dataclass(frozen=True)
class BodyInput:
    """What the discretization needs to know of one body.

    Attributes
    ----------
    mesh : Mesh
        Checked mesh, positively oriented.
    kind : str
        ``solid``, ``membrane`` or ``rod``.
    order : int
        1 or 2; membranes and rods are linear.
    consistent_mass : bool
        Consistent instead of lumped mass.
    measure : float
        Thickness of a membrane [m], cross-section of a rod [m^2]; 1 for solids.
    regions : list of (cells, law, density)
        Disjoint sets of cells that cover the mesh, each with its law (a NamedTuple of `femdeform.materials`) and
        density [kg/m^3].
    muscles : list of FibreInput
        Cells of a solid that carry muscle fibres beside their law.
    """

    mesh: Mesh
    kind: Kind
    order: int
    consistent_mass: bool
    measure: float
    regions: list[tuple[IntArray, Any, float]]
    muscles: Sequence[FibreInput] = ()


@dataclass(frozen=True)
class ElementGroup:
    """Cells of one body and one material, seen by one rank.

    Attributes
    ----------
    body : str
        Name of the body.
    kind : str
        ``solid``, ``membrane`` or ``rod``.
    law : NamedTuple
        Parameters of the material.
    cells : (n_cells, n_nodes) int32
        Local node numbers.
    gradients : (n_cells, n_q, n_nodes, dim) float64
        Gradients of the shape functions at the quadrature points [1/m].
    weights : (n_cells, n_q) float64
        Quadrature weights times volume [m^3] (2D: per unit thickness).
    cell_ids : (n_cells,) int64
        Cell of the body's mesh that each row is.
    fibres : tuple of FibreCells
        Cells that carry muscle fibres.
    """

    body: str
    kind: Kind
    law: Any
    cells: np.ndarray[Any, np.dtype[np.int32]]
    gradients: FloatArray
    weights: FloatArray
    cell_ids: IntArray
    fibres: tuple[FibreCells, ...] = ()

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return int(self.cells.shape[0])


@dataclass(frozen=True)
class BodyNodes:
    """Where a body's nodes are in the numbering of the whole problem.

    Attributes
    ----------
    first : int
        Number of the body's first node.
    n_vertices, n_nodes : int
        Nodes that are points of the mesh (they come first), and all of them.
    connectivity : (n_cells, n_local) int64
        Nodes of every cell of the body, numbered from 0 in the body, vertices first, then mid-edge nodes in VTK order.
    """

    first: int
    n_vertices: int
    n_nodes: int
    connectivity: IntArray


@dataclass(frozen=True)
class Discretization:
    """All bodies of a scene, discretized; arrays hold this rank's nodes, ghosts last.

    Attributes
    ----------
    dim : int
        Dimension of space.
    points : (n_local, dim) float64
        Reference positions of the nodes [m].
    groups : list of ElementGroup
        Cells this rank owns.
    lumped_mass : (n_local,) float64
        Nodal masses [kg], summed over all ranks' cells.
    row_mass : (n_local,) float64
        Row sums of the consistent mass [kg]: the integral of density times each shape function, the load of a unit
        acceleration. Equal to `lumped_mass` for P1.
    consistent_mass : scipy CSR matrix or None
        Scalar consistent mass of this rank's cells that ask for it [kg] (node by node; the same for each component).
    partition : Partition
        Ownership of the nodes.
    bodies : dict of str to BodyNodes
        Where each body's nodes are in the whole problem.
    all_points : (n_global, dim) float64
        Reference positions of the nodes of the whole problem [m].
    local_numbers : (n_global,) int64
        Local number of each node of the whole problem, -1 where this rank does not hold it.
    """

    dim: int
    points: FloatArray
    groups: list[ElementGroup]
    lumped_mass: FloatArray
    row_mass: FloatArray
    consistent_mass: Any | None
    partition: Partition
    bodies: dict[str, BodyNodes]
    all_points: FloatArray
    local_numbers: IntArray

    @property
    def n_nodes(self) -> int:
        """Number of local nodes, ghosts included."""
        return int(self.points.shape[0])

    @property
    def n_dofs(self) -> int:
        """Degrees of freedom of the whole problem."""
        return self.partition.n_global * self.dim

    def to_local(self, global_nodes: IntArray) -> IntArray:
        """Local numbers of those of the given nodes of the whole problem that this rank holds."""
        local = self.local_numbers[global_nodes]
        return local[local >= 0]


@dataclass(frozen=True)
class _Elements:
    """Shape functions of some cells: gradients, weights, and masses of unit density."""

    gradients: FloatArray
    weights: FloatArray
    mass: FloatArray  # (n_cells, n_local, n_local), integral of N_a N_b


# Edges in the order of the mid-edge nodes of scikit-fem's quadratic simplices, which is also VTK's.
EDGES = {"triangle": ((0, 1), (1, 2), (0, 2)), "tetra": ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))}


def node_connectivity(mesh: Mesh, order: int) -> tuple[FloatArray, IntArray]:
    """Return nodes (n_nodes, dim) and cells (n_cells, n_local) of a mesh's P1 or P2 space, vertices first."""
    if order == 1:
        return mesh.points, mesh.cells
    pairs = np.array(EDGES[mesh.cell_type])
    edges = np.sort(mesh.cells[:, pairs], axis=2).reshape(-1, 2)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    middle = mesh.points[unique].mean(axis=1)
    numbers = mesh.n_points + inverse.reshape(mesh.n_cells, len(pairs))
    return np.concatenate([mesh.points, middle]), np.concatenate([mesh.cells, numbers], axis=1)


def _solid_elements(mesh: Mesh, order: int, cells: IntArray) -> _Elements:
    import skfem

    classes: dict[tuple[str, int], tuple[Any, Any]] = {
        ("triangle", 1): (skfem.MeshTri1, skfem.ElementTriP1),
        ("triangle", 2): (skfem.MeshTri1, skfem.ElementTriP2),
        ("tetra", 1): (skfem.MeshTet1, skfem.ElementTetP1),
        ("tetra", 2): (skfem.MeshTet1, skfem.ElementTetP2),
    }
    mesh_class, element = classes[mesh.cell_type, order]
    part = mesh.cells[cells]
    used, inverse = np.unique(part, return_inverse=True)
    corners = np.ascontiguousarray(inverse.reshape(part.shape).T)
    shape = mesh_class(np.ascontiguousarray(mesh.points[used].T), corners, sort_t=False, validate=False)
    # Degree 2 (P1: 0) integrates the tangent of a constant-strain state exactly; degree 2p the mass.
    basis = skfem.Basis(shape, element(), intorder=2 * (order - 1))
    gradients = np.stack([np.asarray(phi[0].grad).transpose(1, 2, 0) for phi in basis.basis], axis=2)
    mass_basis = skfem.Basis(shape, element(), intorder=2 * order)
    shape_values = np.stack([np.broadcast_to(np.asarray(phi[0]), mass_basis.dx.shape) for phi in mass_basis.basis])
    mass = np.einsum("aeq,beq,eq->eab", shape_values, shape_values, mass_basis.dx, optimize=True)
    return _Elements(gradients, basis.dx, mass)


def _codimensional_elements(mesh: Mesh, measure: float, cells: IntArray) -> _Elements:
    """Constant gradients of triangles and edges in 3D: rows of (T^T T)^-1 T^T."""
    corners = mesh.points[mesh.cells[cells]]
    tangents = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)  # (n, 3, k-1)
    metric = np.swapaxes(tangents, 1, 2) @ tangents
    rows = np.linalg.solve(metric, np.swapaxes(tangents, 1, 2))
    gradients = np.concatenate([-rows.sum(axis=1, keepdims=True), rows], axis=1)
    k = corners.shape[1]
    volume = np.sqrt(np.linalg.det(metric)) / (k - 1) * measure  # length, or half the parallelogram
    mass = volume[:, None, None] * (np.ones((k, k)) + np.eye(k)) / (k * (k + 1))
    return _Elements(gradients[:, None], volume[:, None], mass)


def _elements(body: BodyInput, cells: IntArray) -> Iterator[tuple[slice, _Elements]]:
    """Shape functions of cells of a body, some at a time, with the rows that they are of `cells`."""
    for first in range(0, cells.size, _BATCH):
        part = slice(first, min(first + _BATCH, cells.size))
        if body.kind == "solid":
            yield part, _solid_elements(body.mesh, body.order, cells[part])
        else:
            yield part, _codimensional_elements(body.mesh, body.measure, cells[part])


def harmonic_values(points: FloatArray, cells: IntArray, low: BoolArray, high: BoolArray) -> FloatArray:
    """Nodal values of the harmonic function of linear elements that is 0 on some nodes and 1 on others.

    Parameters
    ----------
    points : (n_points, dim) float64
        All of them nodes of cells [m].
    cells : (n_cells, dim + 1) int64
        Triangles in 2D or tetrahedra, each connected part with nodes of both kinds.
    low, high : (n_points,) bool
        Where the function is 0 and 1.

    Returns
    -------
    (n_points,) float64

    Raises
    ------
    InputError
        If the equations cannot be solved.
    """
    import scipy.sparse
    import scipy.sparse.linalg
    import skfem
    from skfem.models.poisson import laplace

    # Conductivity has no unit: coordinates of the size of one keep the numbers of any mesh in range.
    scaled = (points - points.mean(axis=0)) / np.ptp(points, axis=0).max()
    mesh_class, element = (
        (skfem.MeshTri1, skfem.ElementTriP1) if points.shape[1] == 2 else (skfem.MeshTet1, skfem.ElementTetP1)
    )
    shape = mesh_class(np.ascontiguousarray(scaled.T), np.ascontiguousarray(cells.T), sort_t=False, validate=False)
    A = laplace.assemble(skfem.Basis(shape, element())).tocsr()
    values = high.astype(np.float64)
    free = np.flatnonzero(~(low | high))
    if not free.size:
        return values
    K, b = A[free][:, free], -(A[free] @ values)
    inverse = scipy.sparse.diags(1.0 / K.diagonal())
    values[free], failed = scipy.sparse.linalg.cg(K, b, rtol=1e-12, atol=0.0, M=inverse, maxiter=20 * free.size)
    if failed or not np.isfinite(values).all():
        raise InputError("the harmonic field of fibres cannot be solved for; is the mesh distorted?")
    return values


def _lump(mass: FloatArray, order: int) -> FloatArray:
    """Nodal masses (n_cells, n_local): row sums for P1, diagonal scaling for P2, whose row sums are negative."""
    if order == 1:
        return np.asarray(mass.sum(axis=2))
    diagonal = np.einsum("eaa->ea", mass)
    total = mass.sum(axis=(1, 2))
    return np.asarray(diagonal * (total / diagonal.sum(axis=1))[:, None])


def number_nodes(bodies: Mapping[str, tuple[Mesh, int]]) -> tuple[dict[str, BodyNodes], FloatArray]:
    """Number the nodes of bodies, given by mesh and order, one body after the other.

    Returns
    -------
    nodes : dict of str to BodyNodes
    points : (n_global, dim) float64
        Reference positions [m].
    """
    nodes: dict[str, BodyNodes] = {}
    parts: list[FloatArray] = []
    first = 0
    for name, (mesh, order) in bodies.items():
        points, connectivity = node_connectivity(mesh, order)
        nodes[name] = BodyNodes(first, mesh.n_points, len(points), connectivity)
        parts.append(points)
        first += len(points)
    return nodes, np.concatenate(parts)


def discretize(
    bodies: Mapping[str, BodyInput],
    cell_rank: Mapping[str, IntArray] | None,
    comm: Any | None,
    coupled: tuple[IntArray, IntArray] | None = None,
) -> Discretization:
    """Discretize the bodies of a scene.

    Parameters
    ----------
    bodies : mapping of str to BodyInput
        Bodies in the order of the scene.
    cell_rank : mapping of str to (n_cells,) int64, or None
        Rank that owns each cell of each body; None for a serial run.
    comm : mpi4py communicator or None
        None for a serial run.
    coupled : ((n,) int64, (n,) int64), optional
        Pairs of nodes of the whole problem, numbered as by `number_nodes`: the rank that owns the first holds the
        second too, beside the nodes of its cells.

    Returns
    -------
    Discretization
        This rank's part.

    Raises
    ------
    MeshError
        If the bodies do not share one dimension, or a quadratic element comes out inverted.
    """
    dims = {body.mesh.dim for body in bodies.values()}
    if len(dims) != 1:
        raise MeshError([Fault("", 0, "bodies", "bodies of two and of three dimensions in one scene")])
    dim = dims.pop()
    rank = 0 if comm is None else comm.Get_rank()

    nodes_of, all_points = number_nodes({name: (body.mesh, body.order) for name, body in bodies.items()})
    owner_of: list[IntArray] = []
    touched: list[IntArray] = []
    for name, held in nodes_of.items():
        connectivity = held.connectivity
        if cell_rank is None:
            used = np.zeros(held.n_nodes, dtype=bool)
            used[connectivity] = True
            owner_of.append(np.where(used, 0, np.iinfo(np.int64).max))
            touched.append(held.first + np.flatnonzero(used))
            continue
        ranks = cell_rank[name]
        # A node belongs to the lowest rank among its cells: every rank finds the same answer by itself.
        owner = np.full(held.n_nodes, np.iinfo(np.int64).max)
        np.minimum.at(owner, connectivity.ravel(), np.repeat(ranks, connectivity.shape[1]))
        owner_of.append(owner)
        touched.append(held.first + np.unique(connectivity[ranks == rank]))

    owner = np.concatenate(owner_of)
    if coupled is not None:
        touched.append(np.unique(coupled[1][owner[coupled[0]] == rank]))
    local = np.union1d(np.concatenate(touched), np.flatnonzero(owner == rank))
    partition = Partition(owner, local, comm)
    to_local = np.full(owner.size, -1, dtype=np.int64)
    to_local[partition.nodes] = np.arange(partition.n_local)

    groups: list[ElementGroup] = []
    nodal = np.zeros((partition.n_local, 2))  # lumped mass, row sums
    consistent: list[tuple[IntArray, FloatArray]] = []
    for name, body in bodies.items():
        for cells, law, density in body.regions:
            mine = cells if cell_rank is None else cells[cell_rank[name][cells] == rank]
            if mine.size == 0:
                continue
            groups.append(_element_group(name, body, law, density, mine, nodes_of[name], to_local, nodal, consistent))
    partition.accumulate(nodal)
    lumped = np.ascontiguousarray(nodal[:, 0])
    return Discretization(
        dim=dim,
        points=partition.restrict(all_points),
        groups=groups,
        lumped_mass=lumped,
        row_mass=np.ascontiguousarray(nodal[:, 1]),
        consistent_mass=_assemble_mass(consistent, lumped, bodies, nodes_of, to_local, partition),
        partition=partition,
        bodies=nodes_of,
        all_points=all_points,
        local_numbers=to_local,
    )


def _element_group(
    name: str,
    body: BodyInput,
    law: Any,
    density: float,
    cells: IntArray,
    nodes: BodyNodes,
    to_local: IntArray,
    nodal: FloatArray,
    consistent: list[tuple[IntArray, FloatArray]],
) -> ElementGroup:
    """Cells of one region; their masses go to `nodal` (n_local, 2), lumped and row sums, and to `consistent`."""
    n_corners = nodes.connectivity.shape[1]
    numbers = np.empty((cells.size, n_corners), dtype=np.int32)
    gradients, weights = np.empty(0), np.empty(0)
    for part, elements in _elements(body, cells):
        if part.start == 0:
            gradients = np.empty((cells.size, *elements.gradients.shape[1:]))
            weights = np.empty((cells.size, *elements.weights.shape[1:]))
        here = to_local[nodes.first + nodes.connectivity[cells[part]]]
        numbers[part], gradients[part], weights[part] = here, elements.gradients, elements.weights
        mass = density * elements.mass
        if body.consistent_mass:
            consistent.append((here, mass))
        np.add.at(nodal[:, 0], here, _lump(mass, body.order))
        np.add.at(nodal[:, 1], here, mass.sum(axis=2))
    found = [fibre_cells(muscle, cells, gradients) for muscle in body.muscles]
    fibres = tuple(part for part in found if part.rows.size)
    return ElementGroup(name, body.kind, law, numbers, gradients, weights, cells, fibres)


def _assemble_mass(
    parts: list[tuple[IntArray, FloatArray]],
    lumped: FloatArray,
    bodies: Mapping[str, BodyInput],
    nodes_of: Mapping[str, BodyNodes],
    to_local: IntArray,
    partition: Partition,
) -> Any | None:
    """Scalar mass matrix over local nodes; bodies with lumped mass enter by their diagonal, once per owned node."""
    if not any(body.consistent_mass for body in bodies.values()):
        return None
    import scipy.sparse

    rows = [np.broadcast_to(n[:, :, None], m.shape).ravel() for n, m in parts]
    columns = [np.broadcast_to(n[:, None, :], m.shape).ravel() for n, m in parts]
    values = [m.ravel() for _, m in parts]
    for name, body in bodies.items():
        if not body.consistent_mass:
            held = to_local[nodes_of[name].first : nodes_of[name].first + nodes_of[name].n_nodes]
            held = held[(held >= 0) & (held < partition.n_owned)]
            rows.append(held)
            columns.append(held)
            values.append(lumped[held])
    n = partition.n_local
    if not values:  # a rank without a cell
        return scipy.sparse.csr_matrix((n, n))
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return scipy.sparse.csr_matrix(entries, shape=(n, n))
