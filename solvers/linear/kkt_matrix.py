"""Sparse symmetric indefinite matrices with a factorisation: PETSc with MUMPS, or SciPy's SuperLU."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from femdeform.errors import Fault, InputError
from femdeform.parallel import Partition
from femdeform.types import FloatArray, IntArray
from solvers.linear import blas, coo
from solvers.linear.ksp import load_preset

_numbers = itertools.count()

# Room for pivoting in per cent, tried in turn; the code with which MUMPS asks for more.
_ROOM = (60, 300, 1500)
_NEEDS_ROOM = (-8, -9)


class Numbering(Protocol):
    """What a matrix needs to know of the system's numbering."""

    @property
    def partition(self) -> Partition:
        """Ownership of the nodes."""

    @property
    def n_owned(self) -> int:
        """Unknowns of this rank."""

    @property
    def n_global(self) -> int:
        """Unknowns of all ranks."""


class SaddleMatrix(Protocol):
    """A matrix with fixed sparsity; vectors are this rank's part, (n_owned,)."""

    def set_values(self, values: FloatArray) -> None:
        """Set the entries, in the order of the coordinates; entries with the same ones add up."""

    def multiply(self, v: FloatArray) -> FloatArray:
        """Return K v."""

    def factorise(self) -> str:
        """Factorise; the reason in words if that fails, else empty."""

    def apply_inverse(self, b: FloatArray) -> FloatArray:
        """Return K^-1 b by the last factors."""

    def reset(self) -> None:
        """Drop the factors."""

    def destroy(self) -> None:
        """Free everything."""


def make_matrix(
    use_petsc: bool,
    numbering: Numbering,
    rows: IntArray,
    columns: IntArray,
    options: Mapping[str, Any] | None = None,
) -> SaddleMatrix:
    """Make an empty matrix with entries at global coordinates; `options` of PETSc replace those of kkt-direct."""
    return PETScMatrix(numbering, rows, columns, options) if use_petsc else SciPyMatrix(numbering, rows, columns)


class PETScMatrix:
    """AIJ matrix, factorised by MUMPS as a symmetric indefinite one."""

    def __init__(
        self, numbering: Numbering, rows: IntArray, columns: IntArray, options: Mapping[str, Any] | None = None
    ) -> None:
        from petsc4py import PETSc

        blas.follow_kernels()
        self._PETSc = PETSc
        comm = PETSc.COMM_SELF if numbering.partition.comm is None else numbering.partition.comm
        self._prefix = f"femdeform_kkt_{next(_numbers)}_"
        self._options = dict(options) if options else load_preset("kkt-direct").options
        self._matrix = PETSc.Mat().create(comm=comm)
        self._matrix.setSizes(((numbering.n_owned, numbering.n_global),) * 2)
        self._matrix.setType(PETSc.Mat.Type.AIJ)
        coo.preallocate(self._matrix, rows, columns)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._x, self._b = self._matrix.createVecs()
        self._solver: Any = None

    def _make_solver(self) -> None:
        table = self._PETSc.Options(self._prefix)
        for key, value in self._options.items():
            table.setValue(key, "" if value is None else value)
        self._solver = self._PETSc.KSP().create(comm=self._matrix.getComm())
        self._solver.setOptionsPrefix(self._prefix)
        self._solver.setOperators(self._matrix)
        self._solver.setFromOptions()

    def set_values(self, values: FloatArray) -> None:
        """See `SaddleMatrix`."""
        coo.set_values(self._matrix, values)

    def multiply(self, v: FloatArray) -> FloatArray:
        """See `SaddleMatrix`."""
        self._x.setArray(v)
        self._matrix.mult(self._x, self._b)
        return np.array(self._b.getArray(readonly=True))

    def factorise(self) -> str:
        """See `SaddleMatrix`."""
        if self._solver is None:
            self._make_solver()
        try:
            for room in _ROOM:
                self._PETSc.Options(self._prefix).setValue("mat_mumps_icntl_14", room)
                self._solver.setUp()
                self._check_options()
                state = self._solver.getPC().getFactorMatrix().getMumpsInfog(1)
                if state not in _NEEDS_ROOM:
                    break
                self.reset()
        except self._PETSc.Error as error:
            return f"PETSc: {error}"
        return "" if state >= 0 else f"MUMPS ended with code {state}"

    def _check_options(self) -> None:
        unused = [key for key in self._options if not coo.option_was_used(self._prefix + key)]
        if unused:
            raise InputError(
                [Fault("", 0, f"linear_solver.options.{key}", "PETSc did not use this option") for key in unused]
            )

    def apply_inverse(self, b: FloatArray) -> FloatArray:
        """See `SaddleMatrix`; not finite where the factorisation failed."""
        self._b.setArray(b)
        self._solver.solve(self._b, self._x)
        if self._solver.getConvergedReason() < 0:
            return np.full_like(b, np.nan)
        return np.array(self._x.getArray(readonly=True))

    def reset(self) -> None:
        """See `SaddleMatrix`."""
        if self._solver is not None:
            self._solver.reset()
            self._solver.setOperators(self._matrix)

    def destroy(self) -> None:
        """See `SaddleMatrix`."""
        for thing in (self._solver, self._matrix, self._x, self._b):
            if thing is not None:
                thing.destroy()
        if self._solver is not None:
            table = self._PETSc.Options(self._prefix)
            for key in (*self._options, "mat_mumps_icntl_14"):
                table.delValue(key)
        self._solver = None


class SciPyMatrix:
    """CSC matrix, factorised by SuperLU with partial pivoting; serial only."""

    def __init__(self, numbering: Numbering, rows: IntArray, columns: IntArray) -> None:
        import scipy.sparse

        if numbering.partition.comm is not None:
            raise InputError("saddle systems on several ranks need PETSc")
        n = numbering.n_global
        self._n = n
        key = rows * n + columns
        unique, self._place = np.unique(key, return_inverse=True)
        # The matrix is symmetric: its rows are its columns.
        offsets = np.searchsorted(unique, np.arange(n + 1, dtype=np.int64) * n)
        self._matrix = scipy.sparse.csc_matrix(
            (np.zeros(unique.size), (unique % n).astype(np.int32), offsets.astype(np.int32)), shape=(n, n)
        )
        self._factors: Any = None

    def set_values(self, values: FloatArray) -> None:
        """See `SaddleMatrix`."""
        self._matrix.data[:] = np.bincount(self._place, weights=values, minlength=self._matrix.data.size)

    def multiply(self, v: FloatArray) -> FloatArray:
        """See `SaddleMatrix`."""
        return np.asarray(self._matrix @ v)

    def factorise(self) -> str:
        """See `SaddleMatrix`."""
        import scipy.sparse.linalg

        try:
            self._factors = scipy.sparse.linalg.splu(self._matrix, permc_spec="COLAMD")
        except RuntimeError as error:
            return str(error)
        return ""

    def apply_inverse(self, b: FloatArray) -> FloatArray:
        """See `SaddleMatrix`."""
        return np.asarray(self._factors.solve(b))

    def reset(self) -> None:
        """See `SaddleMatrix`."""
        self._factors = None

    def destroy(self) -> None:
        """See `SaddleMatrix`."""
        self._factors = None
