"""The pressure solver that a scene asks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from femdeform.errors import InputError
from femdeform.flow.pressure_system import PressureSystem
from femdeform.scene import pressure_schema as schema
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.deflation import DeflatedConjugateGradients
from solvers.linear.poisson.guard import MULTIGRID_LIMITS, FasterOf, Guarded, Noticed, SlowNotice, SpeedRule
from solvers.linear.poisson.incomplete_cholesky import MODIFIED, IncompleteCholesky
from solvers.linear.poisson.interface import PoissonSolver
from solvers.linear.poisson.make_learned import make_learned_solver
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.petsc_pressure import PETScPressure
from solvers.linear.poisson.trained_range import TrainedRange
from solvers.linear.poisson.weights_file import Weights, load_weights


class PressureSolverMaker:
    """Makes a solver for one system after another: the voxels of moving solids change.

    Parameters
    ----------
    options : PressureSolver
    folder : Path
        Where files of weights are named from.

    Attributes
    ----------
    events : list of str
        A line for each time that a learned solver was stopped or put aside.
    notices : list of str
        A line where a learned solver is used though multigrid is the faster one.
    """

    def __init__(self, options: schema.PressureSolver, folder: Path) -> None:
        self._options = options
        self._folder = folder
        self.events: list[str] = []
        self.notices: list[str] = []
        self._weights: Weights | None = None
        self.reset()

    def reset(self) -> None:
        """Forget which solver was the faster one, and what was said of the weights."""
        self._rule = SpeedRule(self.events)
        self._slow = SlowNotice(self.notices)
        self._refused = ""

    def __call__(self, system: PressureSystem) -> PoissonSolver:
        """Make a solver.

        Raises
        ------
        MissingDependencyError
            If it needs PETSc, which is not there.
        InputError
            If there are no such weights, or they are damaged or of another kind.
        """
        options = self._options
        if not isinstance(options, schema.LearnedPressureSolver):
            return make_classical_solver(options, system)
        if self._weights is None:
            self._weights = load_weights(weights_path(options.weights, self._folder), options.method, system.dim)
        weights = self._weights

        def multigrid() -> PoissonSolver:
            return make_fallback(system, self.events)

        def learned() -> PoissonSolver:
            solver, limits = make_learned_solver(options, system, weights)
            return solver if options.fallback == "none" else Guarded(solver, limits, multigrid, self.events)

        if options.fallback != "none" and self._refuses(system, weights):
            return multigrid()
        if options.compare_times:
            return FasterOf(learned, multigrid, self._rule)
        if options.fallback == "none":
            return learned()
        # Not the fallback itself, whose events are those of the run.
        return Noticed(learned(), lambda: make_fallback(system, []), self._slow)

    def _refuses(self, system: PressureSystem, weights: Weights) -> bool:
        """Whether the weights are not for this grid; says so when that, or the reason, changes."""
        known = TrainedRange.of(weights.meta)
        reason = known.refusal(system) if known is not None else ""
        if reason != self._refused:
            method = self._options.method
            self.events.append(f"{method} not used ({reason}); mg_pcg instead" if reason else f"{method} used again")
            self._refused = reason
        return bool(reason)


def weights_path(name: str | None, folder: Path) -> str | None:
    """A file of weights as seen from `folder`; names stay as they are."""
    return str((folder / name).resolve()) if name is not None and name.endswith(".npz") else name


def weights_fault(options: schema.LearnedPressureSolver, folder: Path, dim: int) -> str:
    """What is wrong with the weights that a scene in `folder` names for a grid; empty if they can be used."""
    try:
        load_weights(weights_path(options.weights, folder), options.method, dim)
    except InputError as error:
        return str(error).removeprefix("linear_solver.weights: ").removeprefix("linear_solver: ")
    return ""


def make_fallback(system: PressureSystem, events: list[str]) -> PoissonSolver:
    """Multigrid, and incomplete Cholesky factors where that takes too long."""
    multigrid = ConjugateGradients(system, Multigrid(system), "mg_pcg")
    return Guarded(
        multigrid,
        MULTIGRID_LIMITS,
        lambda: ConjugateGradients(system, IncompleteCholesky(system, MODIFIED), "icc"),
        events,
    )


def make_classical_solver(options: schema.ClassicalPressureSolver, system: PressureSystem) -> PoissonSolver:
    """Make a solver that has learned nothing.

    Raises
    ------
    MissingDependencyError
        If it needs PETSc, which is not there.
    """
    if isinstance(options, schema.MultigridPressureSolver):
        dtype = np.float32 if options.precision == "float32" else np.float64
        return ConjugateGradients(system, Multigrid(system, options.sweeps, dtype), options.method)
    if isinstance(options, schema.CGPressureSolver):
        return ConjugateGradients(system)
    if isinstance(options, schema.DeflatedPressureSolver):
        return DeflatedConjugateGradients(system, options.n_vectors, seed=options.seed)
    if isinstance(options, schema.ICCPressureSolver) and options.backend == "femdeform":
        return ConjugateGradients(system, IncompleteCholesky(system, options.modification), options.method)
    return PETScPressure(system, options.method)
