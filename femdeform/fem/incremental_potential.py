"""The function that every solver of the deformable family minimises in a step, and the one residual they share.

Backward Euler: ``Phi(x) = 1/(2 h^2) |x - x_hat|_M^2 + PE(x) - f.x`` with ``x_hat = x_n + h v_n``; quasistatic: ``Phi(x)
= PE(x) - f.x`` (docs/methods/finite-elements.md). Its gradient over the free degrees of freedom is the residual [N].
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from femdeform.contact.obstacle_barrier import ObstacleBarrier
from femdeform.contact.penalty import PenaltyContact
from femdeform.contact.terms import ContactTerm, CouplingContact, NodeBlocks, NodeContact
from femdeform.contact.weak_constraints import WeakConstraints
from femdeform.contact.weak_contact import WeakContact
from femdeform.errors import InputError
from femdeform.fem import kernels
from femdeform.fem.assembly import BlockPattern, SlotSum, SparseHessian, roundoff, row_sizes
from femdeform.fem.conditions import Conditions
from femdeform.fem.discretization import Discretization
from femdeform.fem.energies import CellTerm, ElasticEnergy, FollowerPressure
from femdeform.fem.thin_constraints import ThinConstraintEnergy, ThinConstraints
from femdeform.parallel import Partition
from femdeform.step_problem import Feature, LocalCells, NodalTerms
from femdeform.types import FloatArray

# A state whose forces are below this multiple of what rounding may leave is at rest.
_REST = 100.0


@dataclass
class State:
    """What a run carries from step to step, on this rank.

    Attributes
    ----------
    x, v : (n_local, dim) float64
        Positions [m] and velocities [m/s], ghosts included.
    time : float
        Time [s].
    step : int
        Number of accepted steps.
    affine : (n_local, dim, dim) float64, optional
        Gradients of the velocity that the nodes of grid-embedded bodies carry [1/s].
    """

    x: FloatArray
    v: FloatArray
    time: float = 0.0
    step: int = 0
    affine: FloatArray | None = None

    def copy(self) -> State:
        """Return an independent copy."""
        affine = None if self.affine is None else self.affine.copy()
        return State(self.x.copy(), self.v.copy(), self.time, self.step, affine)


class IncrementalPotential:
    """The step problem of deformable bodies.

    Parameters
    ----------
    discretization : Discretization
    conditions : Conditions
    quasistatic : bool
        Leave inertia out.
    contacts : sequence of NodeContact
        Contact with obstacles.
    couplings : sequence of CouplingContact
        Contact of bodies with one another, serial only.
    links : WeakConstraints, optional
        Ties, springs and attachments.
    weak_contact : WeakContact, optional
        Contact of bodies with one another that may be penetrated, serial only.
    constraints : mapping of str to ThinConstraints, optional
        By membrane or rod, in place of the energy of its cells.

    Attributes
    ----------
    partition : Partition
        Ownership of nodes; `x` has one row per local node.
    free : (n_local, dim) bool
        Degrees of freedom that are solved for.
    force_scale : float
        R0, the size of the forces in the step [N]: ``|M (x_n - x_hat)/h^2| + |dPE/dx(x_n)| + |f|``, over all degrees
        of freedom, reactions included. Forces of stiff links and of weak contact say little of those in the bodies:
        they do not count. If all of that is rounding (a body at rest whose support is moved), the forces of the first
        iterate, see `settle_force_scale`.
    """

    def __init__(
        self,
        discretization: Discretization,
        conditions: Conditions,
        quasistatic: bool,
        contacts: Sequence[NodeContact] = (),
        couplings: Sequence[CouplingContact] = (),
        links: WeakConstraints | None = None,
        weak_contact: WeakContact | None = None,
        constraints: Mapping[str, ThinConstraints] | None = None,
    ) -> None:
        self.discretization = discretization
        self.conditions = conditions
        self.quasistatic = quasistatic
        self.contacts = list(contacts)
        self.couplings = list(couplings)
        self.links = links
        self.weak_contact = weak_contact
        self._barriers = [contact for contact in self.contacts if isinstance(contact, ObstacleBarrier)]
        self.has_barriers = bool(self._barriers or self.couplings)
        # Obstacles that nothing penetrates push bodies along: a solver has to move them together.
        self.obstacles_push = any(barrier.moves for barrier in self._barriers)
        self.partition: Partition = discretization.partition
        self.free = conditions.free
        self.dim = discretization.dim

        thin = {} if constraints is None else constraints
        self.elastic = [
            ThinConstraintEnergy(group, thin[group.body]) if group.body in thin else ElasticEnergy(group)
            for group in discretization.groups
        ]
        self.pressures = [FollowerPressure(load) for load in conditions.pressures]
        self._link_terms = [] if links is None else links.terms
        self._terms: list[CellTerm] = [*self.elastic, *self.pressures, *self._link_terms]
        n = discretization.n_nodes
        cells = [term.cells for term in self._terms]
        # Found when a Hessian is first asked for: methods that sweep never do, and it is the largest of all arrays.
        self._cell_pattern: BlockPattern | None = None
        self._extended: BlockPattern | None = None
        self._mass_scalars: FloatArray | None = None
        self._sum = SlotSum(cells, n)
        self._first_row = np.concatenate([[0], np.cumsum([c.size for c in cells])]).astype(int)
        self._slots = np.empty((self._sum.n_slots, self.dim))
        self._blocks: FloatArray | None = None
        self._values: FloatArray | None = None
        self._part_values: FloatArray | None = None
        self._rows: FloatArray | None = None
        self._elastic_rows: FloatArray | None = None
        self._diagonal: FloatArray | None = None
        mass = discretization.consistent_mass
        self._mass = None if quasistatic else mass

        self.layout = 0
        self.dt = 1.0
        self.time = 0.0
        self.force_scale = 1.0
        self.value_magnitude = 0.0
        self.load = np.zeros((n, self.dim))
        self._x_hat = np.zeros((n, self.dim))
        self._in_use = np.empty(0, dtype=np.int64)

    # --------------------------------------------------------------------------------------------- the step

    def begin_step(self, state: State, dt: float) -> None:
        """Set everything that a step from `state` to ``state.time + dt`` freezes: loads, inertia, friction.

        Parameters
        ----------
        state : State
            Last accepted state; not changed.
        dt : float
            Step [s].
        """
        self.dt = dt
        self.time = state.time + dt
        self.set_loads(self.time)
        self._x_hat = state.x + dt * state.v
        for contact in (*self.contacts, *self.couplings):
            contact.begin_step(state.x, self.time, dt)
        if self.links is not None:
            self.links.begin_step(state.x, self.time)
        if self.weak_contact is not None:
            self.weak_contact.begin_step(state.x, self.predictor(state))
        # What a pair of nodes was coupled by in earlier steps must not decide how rounding falls in this one.
        self._in_use = np.empty(0, dtype=np.int64)
        self._reference = state.x
        self.linearize_at(state.x)
        inertia = 0.0 if self.quasistatic else self.partition.norm(self.apply_mass(state.x - self._x_hat)) / dt**2
        internal = self.partition.norm(self.internal_forces(state.x, links=False))
        self.force_scale = inertia + internal + self.partition.norm(self.load)

    def solver_state(self, state: State) -> State:
        """See `StepProblem`: the unknowns are the positions of the nodes."""
        return state

    def node_positions(self, x: FloatArray) -> FloatArray:
        """See `StepProblem`: the unknowns themselves."""
        return x

    def unknowns_near(self, positions: FloatArray) -> FloatArray:
        """See `StepProblem`: the positions themselves."""
        return positions

    def step_limit(self, state: State) -> float:
        """See `StepProblem`: no limit."""
        return np.inf

    def refusal(self, x: FloatArray) -> str:
        """See `StepProblem`: whatever solves the equations will do."""
        return ""

    def spin(self, state: State) -> FloatArray | None:
        """See `StepProblem`: nodes are points."""
        return None

    def set_loads(self, time: float) -> None:
        """Evaluate gravity, dead loads, pressures and the activation of muscles at a time."""
        self.conditions.dead_load(time, self.load)
        mass = self.discretization.row_mass if self.quasistatic else self._load_mass()
        self.load += mass[:, None] * self.conditions.acceleration(time)
        for pressure in self.pressures:
            pressure.set_time(time)
        for term in self.elastic:
            term.set_time(time)

    def _load_mass(self) -> FloatArray:
        # Free fall is exact when gravity acts on the same mass as inertia.
        if self.discretization.consistent_mass is None:
            return self.discretization.lumped_mass
        return self.apply_mass(np.ones((self.discretization.n_nodes, 1)))[:, 0]

    def initial_guess(self, state: State) -> FloatArray:
        """Return the positions from which a solver starts: the last state with the prescribed values of the step."""
        x = state.x.copy()
        self.conditions.set_prescribed(self.time, x)
        return x

    def predictor(self, state: State) -> FloatArray:
        """Positions that inertia and dead loads alone would give, with the prescribed values of the step.

        ``x + h v + h^2 M^-1 f`` with the lumped mass; quasistatic: as `initial_guess`.
        """
        if self.quasistatic:
            return self.initial_guess(state)
        x = self._x_hat + self.dt**2 / self.discretization.lumped_mass[:, None] * self.load
        x = np.where(self.free, x, state.x)
        self.conditions.set_prescribed(self.time, x)
        return x

    def place_obstacles(self, progress: float) -> None:
        """Put moving barriers where they are after that part of the step, from 0 (after `begin_step`) to 1 (its end).

        A solver that starts from the last state has to bring them to 1, moving bodies out of their way.
        """
        for barrier in self._barriers:
            barrier.place(progress)

    def arrive_at(self, x: FloatArray) -> None:
        """Let contact between bodies judge `x` by itself, not by whether the straight way there is free.

        For positions that another problem's solver has reached: its way may have bent.
        """
        for term in self.couplings:
            term.arrive_at(x)

    def linearize_at(self, x: FloatArray) -> None:
        """Tell terms without a potential that a line search will start from `x`."""
        for pressure in self.pressures:
            pressure.set_reference(x)

    # ------------------------------------------------------------------------------------------- the function

    def apply_mass(self, field: FloatArray) -> FloatArray:
        """M times a node field, ghosts updated."""
        mass = self.discretization.consistent_mass
        if mass is None:
            return self.discretization.lumped_mass[:, None] * field
        result = np.ascontiguousarray(mass @ field)
        self.partition.accumulate(result)
        return result

    def elastic_energy(self, x: FloatArray) -> float:
        """Elastic energy of all bodies [J]; infinite or NaN where a law is not defined."""
        return self.partition.sum(sum(term.value(x) for term in self.elastic))

    def value(self, x: FloatArray) -> float:
        """Phi(x) [J], without the constant that pressure has none of; inf where a law is not defined."""
        # One sum over the ranks a kind: a rank has terms only of the bodies it has cells of.
        kinds: list[Sequence[CellTerm | NodeContact | CouplingContact]]
        kinds = [self.elastic, self.pressures, self.contacts, self.couplings, self._link_terms]
        parts = [self.partition.sum(sum(term.value(x) for term in kind)) for kind in kinds]
        if self.weak_contact is not None:
            parts.append(self.weak_contact.value(x))
        parts.append(-self.partition.dot(self.load, x - self._reference))
        if not self.quasistatic:
            offset = x - self._x_hat
            parts.append(0.5 / self.dt**2 * self.partition.dot(offset, self.apply_mass(offset)))
        self.value_magnitude = sum(abs(part) for part in parts)
        return sum(parts)

    def internal_forces(self, x: FloatArray, elastic: bool = True, links: bool = True) -> FloatArray:
        """Gradient of the elastic energy and of pressure, contact and links [N], no inertia, no dead load.

        `elastic` = False leaves the elastic forces out, `links` = False those of links and of weak contact.
        (n_local, dim).
        """
        first_link = len(self._terms) - len(self._link_terms)
        counts = [(elastic or k >= len(self.elastic)) and (links or k < first_link) for k in range(len(self._terms))]
        out = np.zeros((self.discretization.n_nodes, self.dim))
        if any(counts):
            for k, term in enumerate(self._terms):
                if counts[k]:
                    term.gradient(x, self._slots, self._first_row[k])
                else:
                    self._slots[self._first_row[k] : self._first_row[k + 1]] = 0.0
            self._sum(self._slots, out)
        for contact in (*self.contacts, *self.couplings):
            contact.add_gradient(x, out)
        if self.weak_contact is not None and links:
            self.weak_contact.add_gradient(x, out)
        self.partition.accumulate(out)
        return out

    def contact_forces(self, x: FloatArray) -> FloatArray:
        """Forces of obstacles and other surfaces on the nodes, as the last step begun has frozen them [N]."""
        out = np.zeros((self.discretization.n_nodes, self.dim))
        for contact in (*self.contacts, *self.couplings):
            contact.add_gradient(x, out)
        if self.weak_contact is not None:
            self.weak_contact.add_gradient(x, out)
        self.partition.accumulate(out)
        return -out

    def slots_of(self, k: int) -> tuple[FloatArray, int]:
        """Buffer (n_slots, dim) for nodal forces of cells and the first row of elastic term k in it."""
        return self._slots, int(self._first_row[k])

    def sum_elastic_slots(self) -> FloatArray:
        """Sum at the nodes what was written to the rows of the elastic terms [N], (n_local, dim)."""
        self._slots[self._first_row[len(self.elastic)] :] = 0.0
        out = np.empty((self.discretization.n_nodes, self.dim))
        self._sum(self._slots, out)
        self.partition.accumulate(out)
        return out

    def full_gradient(self, x: FloatArray, elastic: bool = True) -> FloatArray:
        """Gradient of Phi at every degree of freedom [N]; minus the reaction where it is prescribed.

        `elastic` = False leaves the elastic forces out.
        """
        out = self.internal_forces(x, elastic) - self.load
        if not self.quasistatic:
            out += self.apply_mass(x - self._x_hat) / self.dt**2
        return out

    def gradient(self, x: FloatArray) -> FloatArray:
        """Residual [N]: the gradient of Phi, zero at prescribed degrees of freedom; (n_local, dim)."""
        return np.where(self.free, self.full_gradient(x), 0.0)

    def hessian(
        self,
        x: FloatArray,
        project: bool,
        free: np.ndarray | None = None,
        elastic: Callable[[int, FloatArray, int], None] | None = None,
        is_part: bool = False,
    ) -> SparseHessian:
        """Hessian of Phi, every cell's part clamped to positive semi-definite if `project`.

        Parameters
        ----------
        x : (n_local, dim) float64
            Positions [m].
        project : bool
            Clamp, so that the matrix is positive definite wherever inertia or supports leave no free mode.
        free : (n_local, dim) bool, optional
            Degrees of freedom whose rows and columns to keep; default: those of the problem.
        elastic : callable, optional
            Writes the cell blocks of the elastic terms in their place: called with the number of the term, the
            buffer (n_slots, dim^2) and the term's first row in it.
        is_part : bool
            `elastic` gives only a part of the Hessian: it goes to a buffer of its own, and the magnitude by which
            rounding is judged stays that of the last whole one.

        Returns
        -------
        SparseHessian
            Its values are a buffer that the next call overwrites.
        """
        dim = self.dim
        coupled = [term.hessian_blocks(x, project) for term in self.couplings]
        if self.weak_contact is not None:
            coupled.append(self.weak_contact.hessian_blocks(x, project))
        if coupled:
            self._adapt_pattern(coupled)
        pattern = self.pattern
        if self._blocks is None:
            self._blocks = np.empty((pattern.n_slots, dim * dim))
        if self._diagonal is None:
            self._diagonal = np.empty((self.discretization.n_nodes, dim * dim))
        if self._mass_scalars is None:
            self._mass_scalars = np.empty(0) if self._mass is None else pattern.block_scalars(self._mass)
        values = self._part_values if is_part else self._values
        if values is None:
            values = np.empty(pattern.n_values)
            if is_part:
                self._part_values = values
            else:
                self._values = values
        for k, (term, first) in enumerate(zip(self._terms, pattern.first_slot, strict=True)):
            if elastic is not None and k < len(self.elastic):
                elastic(k, self._blocks, first)
            else:
                term.hessian(x, project, self._blocks, first)
        self._diagonal[:] = 0.0
        if not self.quasistatic and self._mass is None:
            self._diagonal[:, :: dim + 1] = (self.discretization.lumped_mass / self.dt**2)[:, None]
        for contact in self.contacts:
            contact.add_hessian(x, project, self._diagonal)
        first_pair = pattern.n_slots - pattern.pairs.size
        self._blocks[first_pair:] = 0.0
        for part in coupled:
            pairs = part.rows * pattern.n_nodes + part.columns
            self._blocks[first_pair + np.searchsorted(pattern.pairs, pairs)] += part.blocks
            self._diagonal[part.nodes] += part.diagonal
        mask = self.free if free is None else free
        kernels.sum_blocks(
            self._blocks,
            pattern.row_offsets,
            pattern.columns,
            pattern.mirrors,
            pattern.offsets,
            pattern.entries,
            self._diagonal,
            self._mass_scalars / self.dt**2,
            mask.view(np.uint8),
            self.partition.n_owned,
            (0,) * dim,
            values,
        )
        return SparseHessian(
            pattern.dof_row_offsets,
            pattern.dof_columns,
            values,
            self.discretization.points,
            mask,
            self.partition,
            pattern,
        )

    @property
    def cell_pattern(self) -> BlockPattern:
        """Sparsity of the Hessian without contact between bodies; found on the first call."""
        if self._cell_pattern is None:
            cells = [term.cells for term in self._terms]
            self._cell_pattern = BlockPattern(cells, self.discretization.n_nodes, self.dim)
        return self._cell_pattern

    @property
    def pattern(self) -> BlockPattern:
        """Sparsity of the Hessian with the pairs of nodes that were last in contact."""
        return self.cell_pattern if self._extended is None else self._extended

    def _adapt_pattern(self, coupled: Sequence[NodeBlocks]) -> None:
        """Make room for the pairs of nodes in contact; pairs that were coupled in this step keep theirs."""
        n = self.discretization.n_nodes
        wanted = np.concatenate([part.rows * n + part.columns for part in coupled])
        self._in_use = np.union1d(self._in_use, wanted)
        if np.array_equal(self._in_use, self.pattern.pairs):
            return
        if self._values is not None:
            # Rounding is judged by the last whole Hessian, also where further ones are made in parts only.
            self._rows = self._row_scale(self._values)
        self._extended = self.cell_pattern.extended(self._in_use) if self._in_use.size else None
        self._blocks, self._values, self._part_values, self._mass_scalars = None, None, None, None

    def hessian_times(self, x: FloatArray, step: FloatArray, drift: float = 0.0) -> FloatArray:
        """Product of the projected Hessian, prescribed degrees of freedom included, with a (n_local, dim) field.

        `drift` adds the first-order effect of that part of the motion of the obstacles over the step.
        """
        import scipy.sparse

        everything = np.ones_like(self.free)
        K = self.hessian(x, project=True, free=everything)
        n = self.discretization.n_nodes * self.dim
        matrix = scipy.sparse.csr_matrix((K.values, K.columns, K.row_offsets), shape=(n, n))
        product = np.ascontiguousarray((matrix @ step.ravel()).reshape(step.shape))
        for barrier in self._barriers:
            barrier.drift_force(x, drift, product)
        self.partition.accumulate(product)
        return product

    # -------------------------------------------------------------------------------- parts, for local methods

    @property
    def points(self) -> FloatArray:
        """Reference positions (n_local, dim) [m]."""
        return self.discretization.points

    @property
    def lumped_mass(self) -> FloatArray:
        """Nodal masses (n_local,) [kg]."""
        return self.discretization.lumped_mass

    @property
    def constraints(self) -> list[ThinConstraints]:
        """Constraints of membranes and rods in place of the energy of their cells."""
        return [term.constraints for term in self.elastic if isinstance(term, ThinConstraintEnergy)]

    def local_cells(self, knows: Collection[Feature] = ()) -> list[LocalCells]:
        """See `LocalStepProblem`: the cells of all bodies, merged by law."""
        if self.weak_contact is not None and "weak_contact" not in knows:
            raise InputError("contact: this method does not know weak constraints; use projected_newton or pbng")
        if "fibres" not in knows and any(term.group.fibres for term in self.elastic):
            raise InputError("muscle: this method does not know fibres; use projected_newton, pbng or fp_pxpbd")
        if self.links is not None and "links" not in knows:
            raise InputError("links: this method does not know them")
        if self.partition.n_owned < self.partition.n_global:
            raise InputError("solver.method: a sweep over the nodes runs on one rank, with threads")
        if self.couplings or self._barriers:
            raise InputError("contact: a sweep over the nodes does not know `method: ipc`")
        if not self.quasistatic and self.discretization.consistent_mass is not None:
            raise InputError("bodies: a sweep over the nodes needs `mass: lumped`")
        by_law: dict[tuple[type, object], list[LocalCells]] = {}
        for term in self.elastic:
            group = term.group
            if "constraints" in knows and isinstance(term, ThinConstraintEnergy):
                continue
            if group.kind != "solid" or group.cells.shape[1] != self.dim + 1:
                raise InputError(
                    f"bodies.{group.body}: a sweep over the nodes knows linear triangles in 2D and tetrahedra in 3D"
                )
            # Gradients are constant: a rule of several points adds up to one.
            part = LocalCells(group.law, group.cells, group.gradients[:, 0], group.weights.sum(axis=1), group.fibres)
            by_law.setdefault((type(group.law), tuple(group.law)), []).append(part)
        return [
            parts[0]
            if len(parts) == 1
            else LocalCells(
                parts[0].law,
                np.concatenate([part.cells for part in parts]),
                np.concatenate([part.gradients for part in parts]),
                np.concatenate([part.volumes for part in parts]),
                tuple(
                    fibres.shifted(sum(len(before.cells) for before in parts[:k]))
                    for k, part in enumerate(parts)
                    for fibres in part.fibres
                ),
            )
            for parts in by_law.values()
        ]

    def gathered_cells(self) -> None:
        """See `LocalStepProblem`: cells have their corners only."""
        return

    @property
    def rows(self) -> None:
        """See `LocalStepProblem`: contact is penalty."""
        return

    def nodal_terms(self) -> NodalTerms:
        """See `LocalStepProblem`."""
        mass = self.discretization.lumped_mass
        return NodalTerms(np.zeros_like(mass) if self.quasistatic else mass / self.dt**2, self._x_hat, self.load)

    def node_contacts(self) -> list[PenaltyContact]:
        """See `LocalStepProblem`."""
        return [contact for contact in self.contacts if isinstance(contact, PenaltyContact)]

    def follower_forces(self, x: FloatArray) -> FloatArray | None:
        """See `LocalStepProblem`: pressure."""
        if not self.pressures:
            return None
        first = len(self.elastic)
        self._slots[:] = 0.0
        for k, term in enumerate(self.pressures):
            term.gradient(x, self._slots, self._first_row[first + k])
        out = np.empty((self.discretization.n_nodes, self.dim))
        self._sum(self._slots, out)
        return -out

    # --------------------------------------------------------------------------------------------- judgement

    def residual_norm(self, residual: FloatArray) -> float:
        """Euclidean norm of a residual over the free degrees of freedom [N]: the one measure of all solvers."""
        return self.partition.norm(residual)

    def settle_force_scale(self, x: FloatArray) -> None:
        """Take the forces at the first iterate, reactions included, as R0 if the last state has none but rounding."""
        rounding = self.roundoff_norm(x)
        if rounding == 0.0:
            # Sweeps over nodes or cells never ask for a Hessian.
            rounding = self._rounding_of(self._stiffness_of_rows(), x)
        if self.force_scale <= _REST * rounding:
            pushed = np.zeros_like(x)
            if self.weak_contact is not None:
                self.weak_contact.add_gradient(x, pushed)
            self.force_scale = self.partition.norm(self.full_gradient(x) - pushed)

    def roundoff_norm(self, x: FloatArray) -> float:
        """Residual that rounding alone can leave at `x` [N]: no solver can be asked for less."""
        # The magnitude of K from the rows of the last Hessian.
        rows = self._rows if self._values is None else self._row_scale(self._values)
        return 0.0 if rows is None else self._rounding_of(rows, x)

    def _rounding_of(self, rows: FloatArray, x: FloatArray) -> float:
        """|K| |x| eps [N], from the magnitude of every owned row of K [N/m]."""
        return float(np.sqrt(self.partition.sum(roundoff(rows, x[: self.partition.n_owned]))))

    def _stiffness_of_rows(self) -> FloatArray:
        """Magnitude of the rows of the elastic Hessian at rest [N/m], from moduli and the gradients of the cells."""
        if self._elastic_rows is None:
            nodes = np.zeros((self.discretization.n_nodes, 1))
            for term in self.elastic:
                term.add_stiffness(nodes[:, 0])
            self.partition.accumulate(nodes)
            self._elastic_rows = np.repeat(nodes[: self.partition.n_owned, 0], self.dim)
        return self._elastic_rows

    def _row_scale(self, values: FloatArray) -> FloatArray:
        return row_sizes(values, self.pattern.dof_row_offsets)[: self.partition.n_owned * self.dim]

    def max_step(self, x: FloatArray, step: FloatArray, drift: float = 0.0) -> float:
        """Largest part in [0, 1] of a step that contact leaves free; laws set no bound.

        `drift` is the part of the obstacles' motion over the time step that goes along with the whole of `step`.
        """
        part = min((barrier.max_step(x, step, drift) for barrier in self._barriers), default=1.0)
        for term in self.couplings:
            part *= term.max_step(x, part * step)
        return self.partition.min(part) if self._barriers else part

    def accept(self, state: State, x: FloatArray) -> State:
        """Return the state after a solved step."""
        v = np.zeros_like(x) if self.quasistatic else (x - state.x) / self.dt
        return State(x.copy(), v, self.time, state.step + 1)

    def kinetic_energy(self, v: FloatArray) -> float:
        """Kinetic energy [J]."""
        return 0.5 * self.partition.dot(v, self.apply_mass(v))

    def link_energy(self, x: FloatArray) -> float:
        """Energy of ties, springs and attachments, where they are after the last step begun [J]."""
        return 0.0 if self.links is None else self.partition.sum(self.links.energy(x))

    def contact_energy(self, x: FloatArray) -> float:
        """Energy of penetration and of barriers, obstacles being where the step ends [J]; no work of friction."""
        terms: list[ContactTerm | WeakContact] = [*self.contacts, *self.couplings]
        if self.weak_contact is not None:
            terms.append(self.weak_contact)
        return self.partition.sum(sum(term.stored_energy(x) for term in terms)) if terms else 0.0

    def load_potential(self, x: FloatArray) -> float:
        """Minus the work of gravity and dead loads from the reference positions, at their present size [J]."""
        return -self.partition.dot(self.load, x - self.discretization.points)
