"""The step problem of meshes that are embedded in a background grid: its unknowns are the active grid nodes.

Nodes of the meshes follow the grid, ``x_p = sum_I w_pI y_I``; with the weights W of the last accepted state the
function of a step is ``Phi(y) = 1/(2 h^2) |y - y_hat|_M^2 + PE(W y) - f . W y + walls`` with the lumped grid mass ``m_I
= sum_p w_pI m_p`` and ``y_hat = y_n + h v_I``, y_n being the grid at rest. Deformations are total: ``F_e = sum_I y_I
Gt_I^T``, ``Gt_I = sum_{p in e} w_pI grad N_p``.

References
----------
C. Jiang, C. Schroeder, A. Selle, J. Teran, A. Stomakhin, The affine particle-in-cell method (2015), Lagrangian forces.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from femdeform.contact.penalty import PenaltyContact
from femdeform.errors import InputError
from femdeform.fem.assembly import SparseHessian, expand_to_dofs, roundoff, row_sizes
from femdeform.fem.incremental_potential import IncrementalPotential, State
from femdeform.mpm import kernels
from femdeform.mpm.grid import Grid, Stencils, product_pattern
from femdeform.mpm.transfers import momentum_to_grid, spin, velocity_to_points
from femdeform.mpm.walls import Wall, WallRows, inside, wall_rows
from femdeform.parallel import Partition
from femdeform.step_problem import Feature, GatheredCells, LocalCells, NodalTerms
from femdeform.types import BoolArray, FloatArray

# A state whose forces are below this multiple of what rounding may leave is at rest.
_REST = 100.0
# Cells that a node of a mesh may cross in a step that is still accepted: a neighbour's nodes are then still seen.
_CELLS = 1.0


@dataclass(frozen=True)
class _Pattern:
    """Sparsity of the Hessian over grid nodes, and of the half product with the weights.

    Attributes
    ----------
    half_offsets, half_columns
        CSR pattern of K W, mesh nodes times grid nodes.
    row_offsets, columns
        CSR pattern of W^T K W over grid nodes.
    dof_row_offsets, dof_columns
        The same over degrees of freedom.
    """

    half_offsets: np.ndarray
    half_columns: np.ndarray
    row_offsets: np.ndarray
    columns: np.ndarray
    dof_row_offsets: np.ndarray
    dof_columns: np.ndarray


class EmbeddedPotential:
    """Bodies embedded in a background grid; see the module.

    Parameters
    ----------
    mesh : IncrementalPotential
        Energies and loads of the bodies over the nodes of their meshes, without inertia, contact and links: linear
        solids with lumped mass, on one rank.
    grid : Grid
    walls : sequence of Wall
        Obstacles.
    wall_kind : str
        ``separating``, ``slip`` or ``sticky``.
    cfl : float
        Part of a cell that nodes of the meshes may cross in a step, by their velocities before it.

    Attributes
    ----------
    stencils : Stencils
        Weights of the nodes of the meshes in the step begun.
    lumped_mass : (n_nodes,) float64
        m_I [kg].
    points : (n_nodes, dim) float64
        Grid nodes before the step [m].
    layout : int
        Grows with every step begun: unknowns and weights are others.
    force_scale : float
        R0, see `IncrementalPotential`, over the grid nodes [N].

    Limitations
    -----------
    Bodies that share grid nodes move together there: contact sticks while it lasts, begins up to one and a half cells
    (quadratic weights) before surfaces touch, and its resolution is that of the grid. Motion that the grid cannot
    show, of mesh nodes closer together than a cell, does not exist. One rank; linear solids with lumped mass.
    """

    has_barriers = False
    obstacles_push = False
    links = None
    weak_contact = None
    constraints: tuple[()] = ()

    def __init__(
        self,
        mesh: IncrementalPotential,
        grid: Grid,
        walls: Sequence[Wall] = (),
        wall_kind: str = "separating",
        cfl: float = 0.4,
    ) -> None:
        self.mesh = mesh
        self.grid = grid
        self.walls = list(walls)
        self.wall_kind = wall_kind
        self.cfl = cfl
        self.dim = mesh.dim
        self._dims = (0,) * self.dim
        self.discretization = mesh.discretization
        self.elastic = mesh.elastic
        self.quasistatic = False
        self.layout = 0
        self.dt, self.time = 1.0, 0.0
        self.force_scale, self.value_magnitude = 1.0, 0.0
        self._mass = self.discretization.lumped_mass
        self._modulus = self._moduli()
        self._pattern: _Pattern | None = None
        self._is_pattern_old = True
        self._rows: FloatArray | None = None
        self._half, self._values = np.empty((0, self.dim**2)), np.empty(0)
        self._everything = np.ones_like(mesh.free)
        self.stencils: Stencils = grid.stencils(self.discretization.points)
        self.partition = Partition.serial(0)
        self.points: FloatArray = np.empty((0, self.dim))
        self.lumped_mass: FloatArray = np.empty(0)
        self.free: BoolArray = np.empty((0, self.dim), dtype=bool)
        self.rows: WallRows | None = None

    def _moduli(self) -> FloatArray:
        """Largest ``(2 mu + lambda) / dx^2`` times the volume of the cells around each mesh node [N/m]."""
        out = np.zeros(self.discretization.points.shape[0])
        for term in self.elastic:
            group = term.group
            share = group.weights.sum(axis=1) / group.cells.shape[1]
            stiff = (2.0 * group.law.mu + abs(group.law.lmbda)) / self.grid.spacing**2 * share
            np.add.at(out, group.cells, stiff[:, None])
        return out

    # --------------------------------------------------------------------------------------------- the step

    def initial_state(self, x: FloatArray, v: FloatArray) -> State:
        """State at time zero: the affine velocities are the gradients of v in the cells around each node."""
        total = np.zeros((len(x), self.dim, self.dim))
        volume = np.zeros(len(x))
        for term in self.elastic:
            group = term.group
            weights = group.weights.sum(axis=1)
            slope = np.einsum("eac,eab->ecb", v[group.cells], group.gradients[:, 0])
            np.add.at(total, group.cells, (weights[:, None, None] * slope)[:, None])
            np.add.at(volume, group.cells, weights[:, None])
        return State(x, v, affine=total / volume[:, None, None])

    def begin_step(self, state: State, dt: float) -> None:
        """Lay the grid around the bodies, bring mass and momentum to it, and freeze loads, supports and walls.

        Parameters
        ----------
        state : State
            Last accepted state of the meshes, with affine velocities; not changed.
        dt : float
            Step [s].

        Raises
        ------
        InputError
            If two motions that differ hold the same grid nodes.
        """
        self.dt = dt
        self.time = state.time + dt
        assert state.affine is not None
        self.mesh.begin_step(state, dt)
        s = self.stencils = self.grid.stencils(state.x)
        self.layout += 1
        self.points = s.positions
        self.partition = Partition.serial(s.n_nodes)
        self.lumped_mass, self._velocity = momentum_to_grid(s, state.x, self._mass, state.v, state.affine)
        self._y_hat = self.points + dt * self._velocity
        self._load = s.to_nodes(self.mesh.load)
        self._hold(state, dt)
        self._is_pattern_old, self._rows = True, None
        inertia = self.partition.norm(self.lumped_mass[:, None] * (self.points - self._y_hat)) / dt**2
        internal = self.partition.norm(s.to_nodes(self.mesh.internal_forces(state.x)))
        self.force_scale = inertia + internal + self.partition.norm(self._load)

    def _hold(self, state: State, dt: float) -> None:
        """Prescribed positions of grid nodes, and rows of walls."""
        self.free = np.ones(self.points.shape, dtype=bool)
        self._prescribed = self.points.copy()
        before = state.time if state.step > 0 else None
        for motion in self.mesh.conditions.motions:
            nodes = self.stencils.nodes_of(motion.nodes)
            target = motion.carry(self.points[nodes], before, self.time)
            where = np.ix_(nodes, np.flatnonzero(motion.components))
            taken, there = ~self.free[where], target[:, motion.components]
            if np.any(np.abs(self._prescribed[where] - there)[taken] > 1e-9 * self.grid.spacing):
                raise InputError(
                    f"grid.cell_size: at t = {state.time:.6g} s two motions that differ hold the same grid nodes: "
                    "their groups are closer together than the weights of nodes reach; take smaller cells"
                )
            self._prescribed[where] = there
            self.free[where] = False
        found = inside(self.walls, self.points, state.time, self.grid.spacing)
        if self.wall_kind == "sticky":
            for wall, (nodes, _) in zip(self.walls, found, strict=True):
                # Supports hold where an obstacle is in their way.
                loose = nodes[self.free[nodes].all(axis=1)]
                self._prescribed[loose] = self.points[loose] + dt * wall.velocity
                self.free[loose] = False
            self.rows = None
            return
        rows = wall_rows(self.walls, found, self.points, self._node_stiffness(), dt, self.wall_kind == "slip")
        self.rows = rows if rows.nodes.size else None

    def _node_stiffness(self) -> FloatArray:
        """Stiffness of inertia and elasticity of each grid node [N/m]."""
        return self.lumped_mass / self.dt**2 + self.stencils.to_nodes(self._modulus[:, None])[:, 0]

    def _pattern_of(self, s: Stencils) -> _Pattern:
        """Sparsity of the step, found when first asked for; the same object as before where nothing has changed."""
        old = self._pattern
        if old is not None and not self._is_pattern_old:
            return old
        self._is_pattern_old = False
        mesh = self.mesh.pattern
        W = s.pattern()
        half = product_pattern(mesh.columns, mesh.row_offsets, W)
        whole = product_pattern(s.points, s.offsets, half)
        if (
            old is not None
            and np.array_equal(old.row_offsets, whole.indptr)
            and np.array_equal(old.columns, whole.indices)
            and np.array_equal(old.half_offsets, half.indptr)
            and np.array_equal(old.half_columns, half.indices)
        ):
            return old
        dofs = expand_to_dofs(whole.indptr, whole.indices, self.dim)
        self._pattern = _Pattern(half.indptr, half.indices, whole.indptr, whole.indices, *dofs)
        if self._half.shape[0] < half.indices.size:
            self._half = np.empty((half.indices.size, self.dim**2))
        self._values = np.empty(self._pattern.dof_columns.size)
        return self._pattern

    def solver_state(self, state: State) -> State:
        """See `StepProblem`: the grid as the step begun has laid it, with its velocities."""
        return State(self.points, self._velocity, state.time, state.step)

    def node_positions(self, x: FloatArray) -> FloatArray:
        """See `StepProblem`: W y."""
        return self.stencils.to_points(x)

    def unknowns_near(self, positions: FloatArray) -> FloatArray:
        """See `StepProblem`: motions of the nodes of the meshes, taken to the grid by mass."""
        motion = self._mass[:, None] * (positions - self.stencils.to_points(self.points))
        return self.points + self.stencils.to_nodes(motion) / self.lumped_mass[:, None]

    def step_limit(self, state: State) -> float:
        """Longest step by the rule h <= cfl dx / max|v| [s]."""
        fastest = float(np.sqrt(np.max(np.einsum("ic,ic->i", state.v, state.v), initial=0.0)))
        return self.cfl * self.grid.spacing / fastest if fastest > 0.0 else np.inf

    def refusal(self, x: FloatArray) -> str:
        """See `StepProblem`: nodes must not cross more than a cell, whatever their velocity was."""
        motion = self.stencils.to_points(x - self.points)
        longest = float(np.sqrt(np.max(np.einsum("ic,ic->i", motion, motion), initial=0.0)))
        if longest <= _CELLS * self.grid.spacing:
            return ""
        return f"nodes moved by {longest / self.grid.spacing:.3g} cells of the grid in one step"

    def accept(self, state: State, x: FloatArray) -> State:
        """State of the meshes after a solved step: nodes go with the grid, friction acts, velocities come back."""
        velocity = (x - self.points) / self.dt
        if self.rows is not None:
            velocity = np.where(self.free, self.rows.rub(x, velocity, self.lumped_mass, self.dt), velocity)
        v, affine = velocity_to_points(self.stencils, state.x, velocity)
        return State(state.x + self.dt * v, v, self.time, state.step + 1, affine)

    def initial_guess(self, state: State) -> FloatArray:
        """See `StepProblem`."""
        return np.where(self.free, state.x, self._prescribed)

    def predictor(self, state: State) -> FloatArray:
        """See `LocalStepProblem`."""
        free_fall = self._y_hat + self.dt**2 / self.lumped_mass[:, None] * self._load
        return np.where(self.free, free_fall, self._prescribed)

    def place_obstacles(self, progress: float) -> None:
        """Walls act on velocities: there is nothing to place."""

    def arrive_at(self, x: FloatArray) -> None:
        """No contact that depends on the way."""

    def linearize_at(self, x: FloatArray) -> None:
        """See `StepProblem`."""
        self.mesh.linearize_at(self.stencils.to_points(x))

    # ------------------------------------------------------------------------------------------- the function

    def value(self, x: FloatArray) -> float:
        """Phi(y) [J]; inf where a law is not defined."""
        energy = self.mesh.value(self.stencils.to_points(x))
        offset = x - self._y_hat
        inertia = 0.5 / self.dt**2 * self.partition.dot(offset, self.lumped_mass[:, None] * offset)
        walls = 0.0 if self.rows is None else self.rows.value(x)
        self.value_magnitude = self.mesh.value_magnitude + inertia + walls
        return energy + inertia + walls

    def full_gradient(self, x: FloatArray, elastic: bool = True) -> FloatArray:
        """Gradient of Phi at every degree of freedom [N]; without the elastic energy's if not `elastic`."""
        positions = self.stencils.to_points(x)
        out = self.stencils.to_nodes(self.mesh.full_gradient(positions, elastic))
        out += self.lumped_mass[:, None] * (x - self._y_hat) / self.dt**2
        if self.rows is not None:
            self.rows.add_gradient(x, out)
        return out

    def gradient(self, x: FloatArray) -> FloatArray:
        """Residual [N], zero at prescribed degrees of freedom; (n_nodes, dim)."""
        return np.where(self.free, self.full_gradient(x), 0.0)

    def hessian(self, x: FloatArray, project: bool, free: np.ndarray | None = None) -> SparseHessian:
        """Hessian of Phi, W^T K W and blocks of single nodes; see `IncrementalPotential.hessian`."""
        s, pattern = self.stencils, self._pattern_of(self.stencils)
        dim = self.dim
        K = self.mesh.hessian(s.to_points(x), project, free=self._everything)
        diagonal = np.zeros((s.n_nodes, dim * dim))
        diagonal[:, :: dim + 1] = (self.lumped_mass / self.dt**2)[:, None]
        if self.rows is not None:
            self.rows.add_hessian(x, diagonal)
        over_mesh = self.mesh.pattern
        kernels.spread_columns(
            over_mesh.row_offsets,
            over_mesh.columns,
            K.values,
            s.nodes,
            s.weights,
            pattern.half_offsets,
            pattern.half_columns,
            s.n_nodes,
            self._dims,
            self._half,
        )
        mask = self.free if free is None else free
        kernels.sum_rows(
            pattern.half_offsets,
            pattern.half_columns,
            self._half,
            s.weights,
            s.offsets,
            s.entries,
            pattern.row_offsets,
            pattern.columns,
            diagonal,
            mask.view(np.uint8),
            self._dims,
            self._values,
        )
        self._rows = row_sizes(self._values, pattern.dof_row_offsets)
        return SparseHessian(
            pattern.dof_row_offsets, pattern.dof_columns, self._values, self.points, mask, self.partition, pattern
        )

    def hessian_times(self, x: FloatArray, step: FloatArray, drift: float = 0.0) -> FloatArray:
        """Product of the projected Hessian, prescribed degrees of freedom included, with a (n_nodes, dim) field."""
        return self.hessian(x, project=True, free=np.ones_like(self.free)).times(step)

    # -------------------------------------------------------------------------------- parts, for local methods

    def local_cells(self, knows: Collection[Feature] = ()) -> list[LocalCells]:
        """See `LocalStepProblem`: cells here depend on more than their corners.

        Raises
        ------
        InputError
        """
        raise InputError("grid: this method knows cells of meshes only; use projected_newton, pbng, xpbd or b_pxpbd")

    def gathered_cells(self) -> list[GatheredCells]:
        """See `LocalStepProblem`: ``Gt_I = sum_{p in e} w_pI grad N_p``."""
        s = self.stencils
        W = s.pattern()
        result = []
        for part in self.mesh.local_cells():
            over_grid = product_pattern(part.cells.ravel(), np.arange(0, part.cells.size + 1, self.dim + 1), W)
            gradients = np.empty((over_grid.indices.size, self.dim))
            kernels.cell_gradients(
                part.cells,
                part.gradients,
                s.nodes,
                s.weights,
                over_grid.indptr,
                over_grid.indices,
                s.n_nodes,
                gradients,
            )
            offsets, nodes = over_grid.indptr.astype(np.int64), over_grid.indices.astype(np.int32)
            result.append(GatheredCells(part.law, offsets, nodes, gradients, part.volumes))
        return result

    def nodal_terms(self) -> NodalTerms:
        """See `LocalStepProblem`."""
        return NodalTerms(self.lumped_mass / self.dt**2, self._y_hat, self._load)

    def node_contacts(self) -> list[PenaltyContact]:
        """See `LocalStepProblem`: walls are `rows`."""
        return []

    def follower_forces(self, x: FloatArray) -> FloatArray | None:
        """See `LocalStepProblem`: pressure."""
        follower = self.mesh.follower_forces(self.stencils.to_points(x))
        return None if follower is None else self.stencils.to_nodes(follower)

    # --------------------------------------------------------------------------------------------- judgement

    def residual_norm(self, residual: FloatArray) -> float:
        """Euclidean norm of a residual over the free degrees of freedom [N]."""
        return self.partition.norm(residual)

    def settle_force_scale(self, x: FloatArray) -> None:
        """Take the forces at the first iterate as R0 if the last state has none but rounding."""
        rounding = self.roundoff_norm(x)
        if rounding == 0.0:
            # Sweeps never ask for a Hessian.
            rounding = float(np.sqrt(roundoff(np.repeat(self._node_stiffness(), self.dim), x)))
        if self.force_scale <= _REST * rounding:
            self.force_scale = self.partition.norm(self.full_gradient(x))

    def roundoff_norm(self, x: FloatArray) -> float:
        """Residual that rounding alone can leave [N]."""
        return 0.0 if self._rows is None else float(np.sqrt(roundoff(self._rows, x)))

    def max_step(self, x: FloatArray, step: FloatArray, drift: float = 0.0) -> float:
        """See `StepProblem`: walls are energies, laws set no bound."""
        return 1.0

    # --------------------------------------------------------------------------------------- of the meshes

    def apply_mass(self, field: FloatArray) -> FloatArray:
        """Mass of the meshes' nodes times a field (n_mesh_nodes, dim)."""
        return self.mesh.apply_mass(field)

    def elastic_energy(self, x: FloatArray) -> float:
        """Elastic energy of the meshes at positions of their nodes [J]."""
        return self.mesh.elastic_energy(x)

    def kinetic_energy(self, v: FloatArray) -> float:
        """Kinetic energy of the meshes' nodes [J]."""
        return self.mesh.kinetic_energy(v)

    def load_potential(self, x: FloatArray) -> float:
        """Minus the work of gravity and dead loads from the reference positions [J]."""
        return self.mesh.load_potential(x)

    def contact_energy(self, x: FloatArray) -> float:
        """Walls act on velocities: nothing is stored."""
        return 0.0

    def contact_forces(self, x: FloatArray) -> FloatArray:
        """Bodies touch through the grid: no node of a mesh has a force of contact."""
        return np.zeros_like(x)

    def link_energy(self, x: FloatArray) -> float:
        """There are no links."""
        return 0.0

    def spin(self, state: State) -> FloatArray:
        """Angular momentum of each node about itself that its affine velocity carries [kg m^2/s], (n, 3)."""
        assert state.affine is not None
        return spin(self.grid.spacing, self.grid.degree, state.x, self._mass, state.affine)
