"""PETSc's conjugate gradients and multigrids on the pressure system."""

from __future__ import annotations

import itertools
from collections.abc import Callable
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

# Part of the tolerance that PETSc aims at first.
_AIM = 0.99

# Why a Krylov method of PETSc stopped without an answer.
_STOPPED = {
    "DIVERGED_NULL": "it gave no reason",
    "DIVERGED_MAX_IT": "no answer after the most iterations allowed",
    "DIVERGED_DTOL": "the residual has grown",
    "DIVERGED_BREAKDOWN": "the method broke down",
    "DIVERGED_NONSYMMETRIC": "the matrix is not symmetric",
    "DIVERGED_INDEFINITE_PC": "the preconditioner is not positive definite",
    "DIVERGED_NANORINF": "numbers are not finite",
    "DIVERGED_INDEFINITE_MAT": "the matrix is not positive definite",
    "DIVERGED_PCSETUP_FAILED": "the preconditioner could not be set up",
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
    One process. Setting up takes longer than a solve; a grid with moving solids pays it in every step. Hypre breaks on
    some domains that solids divide into many small closed parts: the answer says so, and the memory of that solver is
    not freed before the process ends.
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
        reasons = PETSc.KSP.ConvergedReason
        self._words = {int(getattr(reasons, name)): text for name, text in _STOPPED.items()}
        self._error = PETSc.Error
        # What went wrong in PETSc for good: it answers no more.
        self._fault = ""
        with blas.one_thread():
            self._try(self._solver.setUp, "the set-up")
        unused = [key for key in options if not coo.option_was_used(prefix + key)]
        for key in options:
            table.delValue(key)
        if unused and not self._fault:
            raise RuntimeError(f"PETSc did not use {', '.join(unused)}")
        self._x, self._b = self._matrix.createVecs()

    def _try(self, call: Callable[[], None], what: str) -> None:
        """Call PETSc; remember what it says where it breaks."""
        try:
            call()
        except self._error as error:
            last = str(error).splitlines()[-1].split("] ", 1)[-1]
            self._fault = f"{self.name} broke in {what}: {last}"
            # Hypre would answer with this error to all who ask from now on.
            if hasattr(coo.library(), "HYPRE_ClearAllErrors"):
                coo.library().HYPRE_ClearAllErrors()
            # What is left half-way can be neither used again nor freed, which would break a second time.
            self._solver.incRef()

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
        if self._fault:
            return PoissonResult(at, 0, False, self._fault, residuals)
        self._b.setArray(system.restrict(b))
        self._x.setArray(system.restrict(at))
        iterations, code = 0, 0
        # The residual is computed anew, and differs from PETSc's by rounding: it aims lower, and once more if need be.
        for aim in (_AIM * target, 0.5 * target):
            left = max_iterations - iterations
            if left < 1 or residuals[-1] <= target:
                break
            self._solver.setTolerances(rtol=1e-300, atol=aim, max_it=left)
            self._solver.setConvergenceHistory(left + 1, reset=True)
            with blas.one_thread():
                self._try(lambda: self._solver.solve(self._b, self._x), "a solve")
            if self._fault:
                return PoissonResult(at, iterations, False, self._fault, residuals)
            done, code = int(self._solver.getIterationNumber()), int(self._solver.getConvergedReason())
            history = [float(value) for value in self._solver.getConvergenceHistory()]
            at, r = starting_point(system, b, system.extend(np.array(self._x.getArray(readonly=True))))
            residuals += history[1 : done + 1]
            residuals[-1] = system.norm(r)
            iterations += done
            if code < 0:
                break
        converged = residuals[-1] <= target
        if converged:
            reason = "residual below tolerance"
        elif code < 0:
            reason = f"PETSc stopped: {self._words.get(code, f'code {code}')}"
        else:
            reason = "PETSc's residual is below the tolerance, the true one is not"
        return PoissonResult(at, iterations, converged, reason, residuals)
