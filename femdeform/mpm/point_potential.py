"""Backward Euler over the grid nodes of material points: the function of one step, and nothing about how it is solved.

With positions ``y = x + u`` of the nodes after the step, ``Phi(u) = sum_i m_i/(2 h^2) |u_i - h v_i - h^2 g|^2 +
e(u)``; e is the energy of material points and of the samples of their surface, by the deformation ``F^ = I + sum_i u_i
G_i^T`` of the step (see `mpm.point_laws`).

Unknowns are the displacements along the axes of each node (see `WallContact`), counted from ``-dx`` instead of zero:
solvers judge steps by the size of the unknowns, and rounding of unknowns of the size of a cell is less than that of
positions.

The measure of a residual r is ``sqrt(sum_i (m/m_i) |r_i|^2)`` with the mean mass m, the Euclidean norm where masses
are equal. Nodes at a surface may have 1e-9 of the mass of others; their residuals are as small, yet their velocities as
wrong as any. As the projected Hessian is M/h^2 and something semi-definite, its Newton step changes the velocities by
at most ``h |r| / (m sqrt(n))``, in the root mean square weighted by mass: a small residual in this measure is a small
step in that one, while the Euclidean norm promises nothing of the sort.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from femdeform.fem.assembly import roundoff
from femdeform.fem.incremental_potential import State
from femdeform.mpm import cell_kernels, point_kernels
from femdeform.mpm.grid import Stencils
from femdeform.mpm.node_shares import share_out
from femdeform.mpm.node_walls import NodeWall, WallContact
from femdeform.mpm.particles import Particles
from femdeform.mpm.point_hessian import PointHessian, Tangents
from femdeform.mpm.point_quadrature import NodePattern, Quadrature
from femdeform.mpm.point_terms import (
    LiquidTerm,
    PointMaterials,
    PointTerm,
    SolidTerm,
    SurfaceTension,
    SurfaceTerm,
    rows_of,
)
from femdeform.parallel import Partition
from femdeform.types import BoolArray, FloatArray

# No point may shrink to less than this in a step; a line search begins a little before that.
SMALLEST_J = 0.1
_CAUTION = 0.9
# A state whose forces are below this multiple of what rounding may leave is at rest.
_REST = 100.0


class PointPotential:
    """The function of one backward Euler step of material points; see the module.

    Parameters
    ----------
    gravity : (dim,) float64
        [m/s^2].
    symmetric_surface : bool
        Surface energy of the symmetric part of F^: drops of liquid keep their angular momentum.
    comm : mpi4py communicator or None
        Ranks that share the nodes and the points of a step out among them (`mpm.node_shares`). All have the same
        points, samples and masses; arrays over nodes below are those of this rank, ghosts last.

    Attributes
    ----------
    points : (n_nodes, dim) float64
        Grid nodes before the step [m].
    mass, velocity : (n_nodes,), (n_nodes, dim) float64
        Of the nodes before the step [kg], [m/s].
    every_mass, every_velocity
        The same of the nodes of all ranks.
    partition : Partition
        Of the nodes.
    contact : WallContact
        What walls hold; `update_contact` changes it between solves.
    free : (n_nodes, dim) bool
        Unknowns that no wall prescribes.
    force_scale : float
        R0: inertia, gravity and each kind of force where the step begins, in the measure of residuals [N].

    References
    ----------
    D. Hyde, S. Gagniere, A. Marquez-Razon, J. Teran, An implicit updated Lagrangian formulation for liquids with large
    surface energy (2020); J. Chen, V. Kala, A. Marquez-Razon, E. Gueidon, D. Hyde, J. Teran, A momentum-conserving
    implicit material point method for surface tension with contact angles and spatial gradients (2021).

    Limitations
    -----------
    Quadratic splines. Backward Euler keeps linear momentum; angular momentum only where the stress of every
    point is symmetric: liquids with `symmetric_surface`, not solids. Surfaces of negative coefficient have no lower
    bound of their own.
    """

    has_barriers = False
    obstacles_push = False

    def __init__(
        self, gravity: Sequence[float] | FloatArray, symmetric_surface: bool = False, comm: Any | None = None
    ) -> None:
        self.comm = comm
        self.gravity = np.array(gravity, dtype=np.float64)
        self.dim = int(self.gravity.size)
        self.symmetric_surface = symmetric_surface
        self.dt = 1.0
        self.force_scale, self.value_magnitude = 1.0, 0.0
        self.terms: list[PointTerm] = []
        self._dims = (0,) * self.dim
        self._pattern: NodePattern | None = None
        self._pattern_fits = False
        self._buffer = np.empty(0)

    def begin_step(
        self,
        stencils: Stencils,
        mass: FloatArray,
        velocity: FloatArray,
        points: Particles,
        materials: PointMaterials,
        dt: float,
        tension: SurfaceTension | None = None,
        walls: Sequence[NodeWall] = (),
    ) -> None:
        """Take what the transfer to the grid has left, and freeze materials, surface and walls for a step.

        Parameters
        ----------
        stencils : Stencils
            Quadratic weights of the material points, then of the samples of `tension`, then of any other points that
            carry mass, over one set of active nodes.
        mass : (n_nodes,) float64
            m_i, all positive [kg].
        velocity : (n_nodes, dim) float64
            v_i [m/s].
        points : Particles
            Read during the step, not changed.
        materials : PointMaterials
            Constants of this step.
        dt : float
            h [s].
        tension : SurfaceTension, optional
            Of the samples.
        walls : sequence of NodeWall
            At the active nodes.

        Raises
        ------
        ValueError
            If a node has no mass, the stencils have too few points, or a body with solid points has no law.
        """
        n_samples = 0 if tension is None else tension.samples.n
        n = points.n + n_samples
        if len(stencils.weights) < n:
            raise ValueError("stencils of the material points and of all samples are needed")
        if not (mass > 0.0).all():
            raise ValueError("an active node has no mass")
        share = share_out(stencils, points.n, n_samples, self.comm)
        self.partition: Partition = share.partition
        self.every_mass, self.every_velocity = mass, velocity
        # Every rank has every kind of points, if only none of them: sums over kinds are sums over ranks too.
        liquid, solids = rows_of(points, materials)
        has_liquid, has_samples = liquid.size > 0, n_samples > 0
        if self.comm is not None:
            mass, velocity = self.partition.restrict(mass), self.partition.restrict(velocity)
            stencils, points = share.stencils, points.take(share.particles)
            materials = materials.take(share.particles)
            tension = None if tension is None else tension.take(share.samples)
            walls = [wall.take(self.partition.nodes) for wall in walls]
            liquid = np.flatnonzero(np.isin(share.particles, liquid))
            solids = {body: np.flatnonzero(np.isin(share.particles, rows)) for body, rows in solids.items()}
            n_samples = share.samples.size
            n = points.n + n_samples
        self.dt, self.stencils, self._particles = dt, stencils, points
        self.points, self._pattern_fits = stencils.positions, False
        self.mass, self.velocity = np.ascontiguousarray(mass), np.ascontiguousarray(velocity)
        self._stencil = (0,) * stencils.weights.shape[1]
        self._drift = dt * self.velocity + dt**2 * self.gravity
        self._measure = np.sqrt(self.every_mass.mean() / self.mass)[:, None]

        every_solid = np.sort(np.concatenate([np.empty(0, np.int64), *solids.values()]))
        self.quadrature = Quadrature.of(stencils, n, points.F, every_solid)
        place = np.full(n, -1, dtype=np.int64)
        place[every_solid] = np.arange(every_solid.size)
        place[points.n :] = every_solid.size + np.arange(n_samples)
        n_matrices = every_solid.size + n_samples
        matrices = np.zeros((n_matrices, self.dim**2, self.dim**2))
        self._tangents = Tangents(place, matrices, np.zeros(n), np.zeros(n))
        self._symmetric = np.zeros(n, dtype=np.uint8)
        self._symmetric[points.n :] = self.symmetric_surface
        self.terms = []
        if has_liquid:
            self.terms.append(LiquidTerm(points, liquid, materials, dt, self._tangents.alpha, self._tangents.beta))
        for body, rows in solids.items():
            law, base = materials.solids[body], self.quadrature.base
            self.terms.append(SolidTerm(law, rows, base, points.volume, place, materials.moduli))
        if tension is not None and has_samples:
            self.terms.append(SurfaceTerm(tension, points.n, self.symmetric_surface, place))
        self._D, self._P, self._S = np.zeros((3, n, self.dim**2))
        self._energies, self._lengths = np.zeros(n), np.empty(n)
        self._sizes: FloatArray | None = None

        self.contact = WallContact(walls, stencils.n_nodes, self.dim, dt, self._drift)
        self._start = np.zeros_like(self.points)
        self._hold()
        size = self.dt**-2 * self.mass[:, None]
        self.force_scale = self.residual_norm(size * self.dt * self.velocity)
        self.force_scale += self.residual_norm(self.mass[:, None] * self.gravity)
        for term in self.terms:
            self.force_scale += self.residual_norm(self._term_gradient(term, np.zeros_like(self.points)))

    def _hold(self) -> None:
        """Unknowns and their prescribed values, from the contact as it is."""
        self.frames = self.contact.frames
        self.free: BoolArray = ~self.contact.held

    # ------------------------------------------------------------------------------------------- the unknowns

    def displacement(self, x: FloatArray) -> FloatArray:
        """Displacements u of the nodes [m] for unknowns x."""
        return np.asarray(np.einsum("iab,ib->ia", self.frames, x - self.stencils.spacing))

    def unknowns(self, u: FloatArray) -> FloatArray:
        """Unknowns for displacements u of the nodes [m]."""
        return np.asarray(np.einsum("iba,ib->ia", self.frames, u) + self.stencils.spacing)

    def grid_velocity(self, x: FloatArray) -> FloatArray:
        """Velocities of the nodes at the end of the step [m/s]; friction is not in them."""
        return self.displacement(x) / self.dt

    def solver_state(self, state: Any) -> State:
        """See `StepProblem`; of `state` nothing is read: the step begun has everything."""
        return State(self.unknowns(self._start), self.velocity)

    def initial_guess(self, state: State) -> FloatArray:
        """See `StepProblem`."""
        return np.where(self.free, state.x, self.contact.shift + self.stencils.spacing)

    def start_from(self, u: FloatArray) -> None:
        """Let the next solve of this step begin at displacements u (n_nodes, dim) [m] instead of at rest."""
        self._start = np.array(u)

    def update_contact(self, x: FloatArray, tolerance: float) -> bool:
        """Adapt which separating walls hold to a solved step; tell whether that changes the problem.

        Parameters
        ----------
        x : (n_nodes, dim) float64
            Solution.
        tolerance : float
            Residual over `force_scale` to which it was solved [-]: no reaction is known better.
        """
        if not self.contact.walls:
            return False
        u = self.displacement(x)
        smallest = tolerance * self.force_scale / self._measure[:, 0]
        gap = 1e-10 * self.stencils.spacing
        changed = self.contact.update(u, self._gradient(u), smallest, gap)
        if not self.partition.max(float(changed)):
            return False
        self._start = u
        self._hold()
        return True

    def is_held(self) -> bool:
        """Whether a wall holds any node, on whatever rank."""
        return bool(self.partition.max(float(self.contact.any)))

    def node_positions(self, x: FloatArray) -> FloatArray:
        """See `StepProblem`: material points, on several ranks those integrated here, (n, dim) [m]."""
        motion = self.stencils.to_points(self.displacement(x))
        return np.asarray(self._particles.x + motion[: self._particles.n])

    def unknowns_near(self, positions: FloatArray) -> FloatArray:
        """See `StepProblem`: motions of the material points, averaged at the nodes by their weights."""
        motion = np.zeros((len(self.stencils.weights), self.dim + 1))
        motion[: self._particles.n, : self.dim] = positions - self._particles.x
        motion[: self._particles.n, self.dim] = 1.0
        total = self.stencils.to_nodes(motion)
        self.partition.accumulate(total)
        weight = total[:, self.dim :]
        u = np.divide(total[:, : self.dim], weight, out=np.zeros_like(self.points), where=weight > 0.0)
        return np.where(self.free, self.unknowns(u), self.contact.shift + self.stencils.spacing)

    def step_limit(self, state: Any) -> float:
        """See `StepProblem`: whoever moves the points chooses the step."""
        return np.inf

    def refusal(self, x: FloatArray) -> str:
        """See `StepProblem`: whoever moves the points looks at how far they went, as friction acts after the solve."""
        return ""

    def obstacle(self, x: FloatArray) -> str:
        """What may have kept a solve from converging, to be added to its reason: points at the bound of `max_step`.

        Nodes that only samples of a surface reach have little mass: in a step longer than capillary waves on the grid
        allow (`mpm.time_step.capillary_limit`), they move so far that their samples shrink to nothing.
        """
        D = self._deform(self.displacement(x), self._D)
        n = self._particles.n
        for what, rows in (("samples of the surface", slice(n, None)), ("material points", slice(0, n))):
            smallest = self.partition.min(float(self._volume_ratios(D)[rows].min(initial=np.inf)))
            if smallest < 2.0 * SMALLEST_J:
                return f"; {what} shrink to {smallest:.2g} of their volume: take a smaller time step"
        return ""

    def _volume_ratios(self, D: FloatArray) -> FloatArray:
        """det F^ of the points, (n_points,), of its symmetric part where that is what counts."""
        dim = self.dim
        base = self.quadrature.base.reshape(-1, dim, dim)
        change = D.reshape(-1, dim, dim)
        change = np.where(self._symmetric[:, None, None] == 1, 0.5 * (change + np.swapaxes(change, 1, 2)), change)
        return np.asarray(np.linalg.det(base + change) / np.linalg.det(base))

    def spin(self, state: Any) -> FloatArray | None:
        """See `StepProblem`: grid nodes have none."""
        return None

    def place_obstacles(self, progress: float) -> None:
        """Walls act on the velocities of a step: there is nothing to place."""

    def linearize_at(self, x: FloatArray) -> None:
        """Nothing depends on where a line search starts."""

    # ------------------------------------------------------------------------------------------- the function

    def _deform(self, u: FloatArray, out: FloatArray) -> FloatArray:
        q = self.quadrature
        point_kernels.deformations(np.ascontiguousarray(u), q.nodes, q.gradients, self._dims, self._stencil, out)
        return out

    def _inertia(self, u: FloatArray) -> float:
        offset = u - self._drift
        return 0.5 / self.dt**2 * self.partition.dot(offset, self.mass[:, None] * offset)

    def value(self, x: FloatArray) -> float:
        """Phi [J]; not finite where a law is not defined."""
        u = self.displacement(x)
        D = self._deform(u, self._D)
        for term in self.terms:
            term.energies(D, self._energies)
        inertia, total = self._inertia(u), self.partition.sum
        self.value_magnitude = total(float(np.sum(np.abs(self._energies)))) + inertia
        return total(float(np.sum(self._energies))) + inertia

    def energies(self, x: FloatArray) -> Mapping[str, float]:
        """Energy of each kind of points here [J]: ``liquid`` (with what viscosity takes up), ``solid``, ``surface``."""
        D = self._deform(self.displacement(x), self._D)
        total: dict[str, float] = {}
        for term in self.terms:
            self._energies[:] = 0.0
            term.energies(D, self._energies)
            total[term.name] = total.get(term.name, 0.0) + float(np.sum(self._energies))
        return total

    def _forces(self, P: FloatArray) -> FloatArray:
        q = self.quadrature
        at_cells = q.cells.empty(self.dim)
        cell_kernels.forces(P, q.gradients, q.cells.offsets, q.cells.points, self._dims, self._stencil, at_cells)
        out = q.cells.gather(at_cells)
        self.partition.accumulate(out)
        return out

    def _term_gradient(self, term: PointTerm, u: FloatArray) -> FloatArray:
        self._P[:] = 0.0
        term.stresses(self._deform(u, self._D), self._P)
        return self._forces(self._P)

    def _gradient(self, u: FloatArray, elastic: bool = True) -> FloatArray:
        """Gradient by the displacements of the nodes [N], (n_nodes, dim)."""
        out = self.mass[:, None] / self.dt**2 * (u - self._drift)
        if elastic:
            D = self._deform(u, self._D)
            for term in self.terms:
                term.stresses(D, self._P)
            out += self._forces(self._P)
        return np.asarray(out)

    def full_gradient(self, x: FloatArray, elastic: bool = True) -> FloatArray:
        """See `StepProblem`."""
        return np.asarray(np.einsum("iba,ib->ia", self.frames, self._gradient(self.displacement(x), elastic)))

    def gradient(self, x: FloatArray) -> FloatArray:
        """See `StepProblem`."""
        return np.where(self.free, self.full_gradient(x), 0.0)

    def node_forces(self, x: FloatArray) -> FloatArray:
        """Forces of the walls on the nodes that they hold [N], (n_nodes, dim); zero elsewhere in a solved step."""
        return self._gradient(self.displacement(x))

    def hessian(self, x: FloatArray, project: bool, free: BoolArray | None = None) -> PointHessian:
        """Hessian of Phi by the unknowns; every point's part is positive semi-definite if `project`.

        Parameters
        ----------
        x : (n_nodes, dim) float64
            Unknowns.
        project : bool
            Clamp.
        free : (n_nodes, dim) bool, optional
            Unknowns whose rows and columns are kept; those that no wall prescribes, if not given.
        """
        D = self._deform(self.displacement(x), self._D)
        for term in self.terms:
            term.tangents(D, project, self._tangents.matrices)
        mask = self.free if free is None else free
        weights = self.mass / self.dt**2
        K = PointHessian(self.quadrature, self._tangents, weights, self.frames, mask, self.points, self.partition, self)
        self._sizes = np.abs(K.diagonal_blocks()).max(axis=2)
        return K

    def hessian_times(self, x: FloatArray, step: FloatArray, drift: float = 0.0) -> FloatArray:
        """See `StepProblem`."""
        return self.hessian(x, project=True, free=np.ones_like(self.free)).times(step)

    def node_pattern(self) -> NodePattern:
        """Sparsity of the Hessian; the same object as long as the active nodes are the same, and where they are."""
        if self._pattern is None or not (self._pattern_fits or self._pattern.is_of(self.stencils, self.partition)):
            self._pattern = NodePattern(self.stencils, self.partition)
        self._pattern_fits = True
        return self._pattern

    def matrix_values(self, n: int) -> FloatArray:
        """A buffer of n values."""
        if self._buffer.size < n:
            self._buffer = np.empty(n + n // 4)
        return self._buffer[:n]

    # ---------------------------------------------------------------------------------------------- judgement

    def residual_norm(self, residual: FloatArray) -> float:
        """``sqrt(sum_i (m/m_i) |r_i|^2)`` with the mean mass m [N]; see the module."""
        return self.partition.norm(self._measure * residual)

    def velocity_error(self, residual_norm: float) -> float:
        """Bound of what a solve can still change of the velocities, their root mean square by mass [m/s]."""
        return self.dt * residual_norm / float(self.every_mass.mean() * np.sqrt(len(self.every_mass)))

    def settle_force_scale(self, x: FloatArray) -> None:
        """Take the forces at the first iterate as R0 if the step begins with none but rounding."""
        if self.force_scale <= _REST * self.roundoff_norm(x):
            self.force_scale = self.residual_norm(self.full_gradient(x))

    def roundoff_norm(self, x: FloatArray) -> float:
        """Residual that rounding alone can leave [N]."""
        if self._sizes is None:
            return 0.0
        own = slice(self.partition.n_owned)
        return float(np.sqrt(self.partition.sum(roundoff((self._measure * self._sizes)[own].ravel(), x[own]))))

    def max_step(self, x: FloatArray, step: FloatArray, drift: float = 0.0) -> float:
        """See `StepProblem`: no point may shrink to a tenth of its volume along the way."""
        D = self._deform(self.displacement(x), self._D)
        S = self._deform(np.einsum("iab,ib->ia", self.frames, step), self._S)
        point_kernels.longest_steps(D, S, self.quadrature.base, self._symmetric, SMALLEST_J, self._dims, self._lengths)
        return min(1.0, _CAUTION * self.partition.min(float(self._lengths.min(initial=np.inf))))
