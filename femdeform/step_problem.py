"""The contract between what is simulated and how a step is solved.

A nonlinear solver sees a `StepProblem` and nothing else; a time loop sees the solver's `StepResult`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from femdeform.parallel import Partition
from femdeform.types import BoolArray, FloatArray, IntArray

# Called after every nonlinear iteration with its row (iteration, residual_norm, relative_residual, objective, ...) and
# the positions it arrived at, (n_local, dim) [m], which it may read but not change.
IterationObserver = Callable[[Mapping[str, float | int | str], FloatArray], None]


class Budget:
    """What a solver may spend on one step; it looks after every iteration whether something is left.

    An iteration that has begun is finished, so a step may take longer than its seconds by less than one iteration.
    Seconds are for serial runs: the clocks of several ranks would not agree on the last iteration.

    Parameters
    ----------
    iterations : int, optional
        Most nonlinear iterations.
    seconds : float, optional
        Time after which no further iteration begins [s].
    clock : callable
        Gives a time that only grows [s].

    Raises
    ------
    ValueError
        If a limit is not positive.
    """

    def __init__(
        self,
        iterations: int | None = None,
        seconds: float | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        if (iterations is not None and iterations < 1) or (seconds is not None and not seconds > 0.0):
            raise ValueError("a budget has to be positive")
        self.iterations = iterations
        self.seconds = seconds
        self._clock = clock
        self._begin = clock()
        self._lost = 0.0  # time inside `paused` since the start
        self._paused_at: float | None = None

    def start(self) -> None:
        """Begin to count, again from zero; whoever calls the solver does it right before."""
        self._begin, self._lost = self._clock(), 0.0

    def elapsed(self) -> float:
        """Time since the start, without what was paused [s]."""
        now = self._clock() if self._paused_at is None else self._paused_at
        return now - self._begin - self._lost

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Stop the clock: what is measured about a solver is not its time. May be nested."""
        if self._paused_at is not None:
            yield
            return
        self._paused_at = self._clock()
        try:
            yield
        finally:
            self._lost += self._clock() - self._paused_at
            self._paused_at = None

    def spent(self, iteration: int) -> str | None:
        """Why no further iteration may begin after this many, in words; None if one may."""
        if self.iterations is not None and iteration >= self.iterations:
            count = "1 iteration" if self.iterations == 1 else f"{self.iterations} iterations"
            return f"the budget of {count} is spent"
        if self.seconds is not None and self.elapsed() >= self.seconds:
            return f"the budget of {self.seconds:g} s is spent"
        return None


class StepProblem(Protocol):
    """A function Phi of node positions to be minimised in one step; fields are (n_local, dim) with ghosts updated."""

    partition: Partition
    free: BoolArray
    force_scale: float
    value_magnitude: float  # sum of the sizes of the terms of the last `value`, which may cancel [J]
    has_barriers: bool  # whether there is contact that nothing may penetrate: `max_step` then bounds steps
    obstacles_push: bool  # whether obstacles move that nothing may penetrate

    def solver_state(self, state: Any) -> Any:
        """The state from which a step begins in terms of the unknowns, with the step begun: solvers take this one."""

    def node_positions(self, x: FloatArray) -> FloatArray:
        """Positions of the nodes of the bodies [m] for unknowns x."""

    def unknowns_near(self, positions: FloatArray) -> FloatArray:
        """Unknowns for which the nodes of the bodies are at positions [m], as far as there are such."""

    def step_limit(self, state: Any) -> float:
        """Longest step that may be taken from a state of the bodies [s]."""

    def refusal(self, x: FloatArray) -> str:
        """Why a solved step may not be accepted although its equations are solved, or empty."""

    def spin(self, state: Any) -> FloatArray | None:
        """Angular momentum of each node about itself (n_local, 3) [kg m^2/s], where nodes have any."""

    def initial_guess(self, state: Any) -> FloatArray:
        """Positions of the last state with the prescribed values of this step."""

    def value(self, x: FloatArray) -> float:
        """Phi(x) [J]; not finite where the material is not defined."""

    def gradient(self, x: FloatArray) -> FloatArray:
        """Residual [N], zero at prescribed degrees of freedom."""

    def full_gradient(self, x: FloatArray, elastic: bool = True) -> FloatArray:
        """Gradient of Phi at every degree of freedom [N]; without the elastic energy's if not `elastic`."""

    def hessian(self, x: FloatArray, project: bool) -> Any:
        """Hessian for a `LinearSolver`; positive semi-definite cell by cell if `project`."""

    def hessian_times(self, x: FloatArray, step: FloatArray, drift: float = 0.0) -> FloatArray:
        """Projected Hessian times a field, prescribed degrees of freedom included, and `drift` of the obstacles [N]."""

    def place_obstacles(self, progress: float) -> None:
        """Put moving obstacles where they are after that part of the step, from 0, where it begins, to 1."""

    def linearize_at(self, x: FloatArray) -> None:
        """Announce the state from which the next line search starts."""

    def settle_force_scale(self, x: FloatArray) -> None:
        """Complete `force_scale` at the first iterate, where the last state gives none."""

    def residual_norm(self, residual: FloatArray) -> float:
        """The one measure of a residual [N]."""

    def roundoff_norm(self, x: FloatArray) -> float:
        """Residual that rounding alone leaves [N]."""

    def max_step(self, x: FloatArray, step: FloatArray, drift: float = 0.0) -> float:
        """Largest admissible part of a step, in [0, 1], with `drift` of the obstacles' motion along the whole of it."""


@dataclass(frozen=True)
class LocalCells:
    """Simplices of one law, as sweeps over nodes or cells need them; read only.

    Attributes
    ----------
    law : NamedTuple
        The law with its parameters.
    cells : (n_cells, dim + 1) int32
        Local node numbers, positively oriented.
    gradients : (n_cells, dim + 1, dim) float64
        Constant gradients of the shape functions [1/m].
    volumes : (n_cells,) float64
        Rest volumes [m^3] (2D: areas, per unit thickness).
    fibres : sequence of FibreCells
        Cells that carry muscle fibres (`femdeform.fem.fibres`), with the muscles' laws at the time of the step begun.
    """

    law: Any
    cells: np.ndarray[Any, np.dtype[np.int32]]
    gradients: FloatArray
    volumes: FloatArray
    fibres: Sequence[Any] = ()


@dataclass(frozen=True)
class GatheredCells:
    """Cells of one law whose deformation any number of nodes decides: ``F = sum_t x_{nodes[t]} gradients[t]^T``.

    Attributes
    ----------
    law : NamedTuple
        The law with its parameters.
    offsets : (n_cells + 1,) int64
        First entry of each cell in the arrays below.
    nodes : (n_entries,) int32
        Nodes of the problem, ascending in each cell.
    gradients : (n_entries, dim) float64
        Their gradients, which add up to zero over a cell [1/m].
    volumes : (n_cells,) float64
        Rest volumes [m^3] (2D: areas, per unit thickness).
    """

    law: Any
    offsets: IntArray
    nodes: np.ndarray[Any, np.dtype[np.int32]]
    gradients: FloatArray
    volumes: FloatArray


class StepRows(Protocol):
    """Conditions on single nodes, ``k/2 min(n . x - target, 0)^2`` each, or of either sign; see `mpm.walls`."""

    nodes: IntArray
    normals: FloatArray
    targets: FloatArray
    stiffness: FloatArray
    two_sided: bool

    def add_gradient(self, y: FloatArray, out: FloatArray) -> None:
        """Add the gradient at y [N] to `out`, both (n_local, dim)."""


@dataclass(frozen=True)
class NodalTerms:
    """Terms of Phi on single nodes in the step begun: ``sum_i w_i/2 |x_i - c_i|^2 - f_i . x_i``.

    Attributes
    ----------
    weights : (n_local,) float64
        m_i / h^2 [N/m]; zero in statics.
    centers : (n_local, dim) float64
        ``x_n + h v_n`` [m].
    loads : (n_local, dim) float64
        Gravity and dead loads [N].
    """

    weights: FloatArray
    centers: FloatArray
    loads: FloatArray


Feature = Literal["links", "weak_contact", "fibres", "constraints"]


class LocalStepProblem(StepProblem, Protocol):
    """A step problem that also shows its parts, for methods that move a node or a cell at a time."""

    points: FloatArray  # (n_local, dim) reference positions [m]
    links: Any  # weak constraints between nodes (`femdeform.contact.weak_constraints.WeakConstraints`), or None
    weak_contact: Any  # contact found anew in each step (`femdeform.contact.weak_contact.WeakContact`), or None
    constraints: Sequence[Any]  # of membranes and rods (`femdeform.fem.thin_constraints.ThinConstraints`)
    lumped_mass: FloatArray  # (n_local,) [kg]
    dt: float  # length of the step begun [s]
    layout: int  # changes with the nodes that there are and the cells over them

    def local_cells(self, knows: Collection[Feature] = ()) -> Sequence[LocalCells]:
        """Cells of all bodies, one entry per law with its parameters.

        Parameters
        ----------
        knows : collection of str
            What the method takes in itself besides the cells; a scene with anything else is refused. Cells of membranes
            and rods with ``constraints`` are left out for who knows them.

        Raises
        ------
        InputError
            If a part of the problem has no such form: other elements, consistent mass, contact that couples nodes,
            several ranks.
        """

    def gathered_cells(self) -> Sequence[GatheredCells] | None:
        """Cells that depend on more nodes than their corners, in the same order every step; None where none do."""

    @property
    def rows(self) -> StepRows | None:
        """Conditions on single nodes in the step begun."""

    def nodal_terms(self) -> NodalTerms:
        """Inertia and dead loads of the step begun."""

    def node_contacts(self) -> Sequence[Any]:
        """Penalty contacts of single nodes (`femdeform.contact.penalty.PenaltyContact`), frozen by the step begun."""

    def follower_forces(self, x: FloatArray) -> FloatArray | None:
        """Forces at the nodes that depend on the positions of others [N], (n_local, dim); None if there are none."""

    def predictor(self, state: Any) -> FloatArray:
        """Positions that inertia and dead loads alone would give, with the prescribed values of the step."""


@dataclass(frozen=True)
class StepResult:
    """What a solver made of a step.

    Attributes
    ----------
    x : (n_local, dim) float64
        Last positions [m]; a time loop uses them only if `accepted`.
    converged : bool
        Whether the residual is below its tolerance.
    reason : str
        Why the solver stopped, in words.
    iterations, linear_iterations : int
        Nonlinear iterations, and linear ones over all of them.
    residual_norm : float
        Residual at `x` [N].
    relative_residual : float
        The same over `StepProblem.force_scale` [-].
    is_fixed_work : bool
        The solver did the work it was asked for and no tolerance was promised: an interactive scheme, whose steps are
        taken whatever their residual is.
    """

    x: FloatArray
    converged: bool
    reason: str
    iterations: int
    linear_iterations: int
    residual_norm: float
    relative_residual: float
    is_fixed_work: bool = False

    @property
    def accepted(self) -> bool:
        """Whether a time loop goes on from `x`."""
        return self.converged or self.is_fixed_work


class StepSolver(Protocol):
    """A nonlinear solver."""

    def step(
        self, problem: Any, state: Any, observe: IterationObserver | None = None, budget: Budget | None = None
    ) -> StepResult:
        """Solve one step from an accepted state.

        Parameters
        ----------
        problem : StepProblem
            With the step begun.
        state : State
            Last accepted state; not changed.
        observe : callable, optional
            Called after every iteration, the first one included. `seconds` of its row is the time since the start of
            the step, by the budget's clock if there is a budget.
        budget : Budget, optional
            Started by the caller. Once it is spent the step ends: not converged, with the budget's reason and the
            last iterate.

        Returns
        -------
        StepResult
            Nothing is raised if the step does not converge.
        """

    def reset(self) -> None:
        """Forget what was learnt in earlier steps: the next one depends on its state alone."""

    def destroy(self) -> None:
        """Free what the solver holds besides its linear solver."""
