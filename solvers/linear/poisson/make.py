"""The pressure solver that a scene asks for."""

from __future__ import annotations

import numpy as np

from femdeform.flow.pressure_system import PressureSystem
from femdeform.scene import pressure_schema as schema
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.deflation import DeflatedConjugateGradients
from solvers.linear.poisson.incomplete_cholesky import IncompleteCholesky
from solvers.linear.poisson.interface import PoissonSolver
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.petsc_pressure import PETScPressure


def make_pressure_solver(options: schema.PressureSolver, system: PressureSystem) -> PoissonSolver:
    """Make a solver for one system.

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
