"""PETSc's conjugate gradients and multigrids on the pressure system."""

from __future__ import annotations

import itertools
from typing import Any, Literal

import numpy as np

from femdeform.errors import MissingDependencyError
from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear import blas, coo
from solvers.linear.poisson.interface import PoissonResult, starting_point

_numbers = itertools.count()

OPTIONS: dict[str, dict[str, str]] = {
    # The last pivot of a singular matrix is zero but for rounding, which a shift keeps away from.
    "icc": {"pc_type": "icc", "pc_factor_shift_type": "positive_definite"},
    "gamg": {"pc_type": "gamg"},
    "hypre": {"pc_type": "hypre", "pc_hypre_type": "boomeramg", "pc_hypre_boomeramg_strong_threshold": "0.5"},
}


class PETScPressure:
    """A Krylov solver of PETSc on the assembled pressure matrix, with its null space attached.

    Parameters
    ----------
    system : PressureSystem
    preconditioner : str
        ``icc``, ``gamg`` or ``hypre``.

    Raises
    ------
    MissingDependencyError
        If petsc4py is not installed.

    References
    ----------
    S. Balay et al., PETSc/TAO Users Manual.

    Limitations
    -----------
    One process. Setting up takes longer than a solve; a grid with moving solids pays it in every step.
    """

    def __init__(self, system: PressureSystem, preconditioner: Literal["icc", "gamg", "hypre"]) -> None:
        try:
            from petsc4py import PETSc
        except ImportError as error:
            raise MissingDependencyError(f"petsc4py cannot be imported: {error}") from None
        self.system, self.name = system, preconditioner
        A = system.matrix()
        self._matrix = PETSc.Mat().createAIJ(
            A.shape, csr=(A.indptr.astype(PETSc.IntType), A.indices.astype(PETSc.IntType), A.data), comm=PETSc.COMM_SELF
        )
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._modes = self._attach_null_space(PETSc)
        prefix = f"femdeform_pressure_{next(_numbers)}_"
        table = PETSc.Options(prefix)
        options = {"ksp_type": "cg", "ksp_norm_type": "unpreconditioned", **OPTIONS[preconditioner]}
        for key, value in options.items():
            table.setValue(key, value)
        self._solver = PETSc.KSP().create(comm=PETSc.COMM_SELF)
        self._solver.setOptionsPrefix(prefix)
        self._solver.setOperators(self._matrix)
        self._solver.setFromOptions()
        self._solver.setInitialGuessNonzero(True)
        with blas.one_thread():
            self._solver.setUp()
        unused = [key for key in options if not coo.option_was_used(prefix + key)]
        for key in options:
            table.delValue(key)
        if unused:
            raise RuntimeError(f"PETSc did not use {', '.join(unused)}")
        self._x, self._b = self._matrix.createVecs()

    def _attach_null_space(self, PETSc: Any) -> Any:
        component = self.system.component[self.system.unknown]
        vectors = []
        for number in range(self.system.n_closed):
            vector = self._matrix.createVecRight()
            vector.setArray((component == number).astype(float))
            vector.normalize()
            vectors.append(vector)
        if not vectors:
            return None
        modes = PETSc.NullSpace().create(vectors=vectors, comm=PETSc.COMM_SELF)
        self._matrix.setNullSpace(modes)
        for vector in vectors:
            vector.destroy()
        return modes

    def destroy(self) -> None:
        """Free the matrix, the solver and the vectors."""
        for thing in (self._solver, self._matrix, self._x, self._b, self._modes):
            if thing is not None:
                thing.destroy()

    def solve(self, b: GridArray, tolerance: float, max_iterations: int, x: GridArray | None = None) -> PoissonResult:
        """Solve A x = b; see `PoissonSolver`."""
        system = self.system
        at, r = starting_point(system, b, x)
        target = tolerance * system.norm(b)
        residuals = [system.norm(r)]
        if residuals[0] <= target:
            return PoissonResult(at, 0, True, "residual below tolerance", residuals)
        self._b.setArray(system.restrict(b))
        self._x.setArray(system.restrict(at))
        self._solver.setTolerances(rtol=1e-300, atol=target, max_it=max_iterations)
        self._solver.setConvergenceHistory(max_iterations + 1, reset=True)
        with blas.one_thread():
            self._solver.solve(self._b, self._x)
        solution, true = starting_point(system, b, system.extend(np.array(self._x.getArray(readonly=True))))
        residuals = [float(value) for value in self._solver.getConvergenceHistory()]
        residuals[-1] = system.norm(true)
        iterations = int(self._solver.getIterationNumber())
        converged = residuals[-1] <= 1.01 * target
        reason = "residual below tolerance" if converged else f"PETSc stopped, code {self._solver.getConvergedReason()}"
        return PoissonResult(solution, iterations, converged, reason, residuals)
