"""Linear systems by PETSc's Krylov and direct solvers, chosen by a named preset."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from femdeform.errors import Fault, InputError, MissingDependencyError
from femdeform.fem.assembly import SparseHessian
from femdeform.registry import preset_names
from femdeform.types import FloatArray
from solvers.linear import blas, coo
from solvers.linear.interface import LinearResult

_numbers = itertools.count()
_OUT_OF_MEMORY = 55  # PETSC_ERR_MEM


@dataclass(frozen=True)
class Preset:
    """A named set of PETSc options.

    Attributes
    ----------
    name : str
    options : dict
        PETSc options without prefix and dash; a value of None is a flag.
    near_nullspace : bool
        Attach the rigid-body modes of the reference positions to the matrix.
    global_solve : str
        For a preset of saddle systems the mixed method's word for it, else empty.
    """

    name: str
    options: dict[str, Any]
    near_nullspace: bool = False
    global_solve: str = ""


def load_preset(name: str) -> Preset:
    """Read a shipped preset.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    from ruamel.yaml import YAML

    if name not in preset_names():
        raise InputError(
            [Fault("", 0, "linear_solver.preset", f"unknown preset {name!r}; there are {', '.join(preset_names())}")]
        )
    text = (resources.files("solvers.presets") / f"{name}.yaml").read_text(encoding="utf-8")
    data = YAML(typ="safe", pure=True).load(text)
    near_nullspace, global_solve = bool(data.get("near_nullspace", False)), str(data.get("global_solve", ""))
    return Preset(name, dict(data["options"]), near_nullspace, global_solve)


def _petsc() -> Any:
    try:
        from petsc4py import PETSc
    except ImportError as error:
        raise MissingDependencyError(f"petsc4py cannot be imported: {error}") from None
    blas.follow_kernels()
    return PETSc


def _cause(error: Exception) -> str:
    """Last line of PETSc's error, which names the cause; the lines before it are its call stack."""
    lines = [line.split("] ", 1)[-1].strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__


class KSP:
    """A PETSc Krylov solver (or a direct one, as ``preonly``) that keeps its matrix between solves.

    As long as the sparsity stays (`SparseHessian.pattern` is the same object) a solve sets values only, and
    factorisations reuse their symbolic part; a new pattern makes a new matrix.

    Parameters
    ----------
    preset : str
        Name of a preset, see `femdeform.registry.preset_names`.
    options : mapping
        PETSc options over the preset's, without prefix and dash.

    Raises
    ------
    MissingDependencyError
        If petsc4py is not installed.
    InputError
        If the preset is unknown, or PETSc did not use one of the options (raised by the first solve).

    References
    ----------
    S. Balay et al., PETSc/TAO Users Manual.

    Limitations
    -----------
    A change of sparsity, as contact between bodies makes it, costs a new symbolic factorisation.
    """

    def __init__(self, preset: str = "newton-mumps", options: Mapping[str, Any] | None = None) -> None:
        self._PETSc = _petsc()
        self.preset = load_preset(preset)
        self.name = f"ksp/{preset}"
        self._options = {**self.preset.options, **(options or {})}
        # Each object has options of its own: PETSc's option table is global.
        self._prefix = f"femdeform_{next(_numbers)}_"
        self._matrix: Any = None
        self._solver: Any = None
        self._modes: Any = None
        self._pattern: object = None
        self._checked = False

    @property
    def saddle_options(self) -> dict[str, Any]:
        """PETSc options for the factors of a saddle system, where the preset is one of those."""
        return self._options if self.preset.global_solve else {}

    def _set_up(self, K: SparseHessian) -> None:
        PETSc = self._PETSc
        partition, dim = K.partition, K.dim
        comm = PETSc.COMM_SELF if partition.comm is None else partition.comm
        n = partition.n_owned * dim
        self._matrix = PETSc.Mat().create(comm=comm)
        self._matrix.setSizes(((n, partition.n_global * dim),) * 2)
        self._matrix.setBlockSize(dim)
        self._matrix.setType(PETSc.Mat.Type.AIJ)
        dofs = (partition.global_index[:, None] * dim + np.arange(dim)).ravel()
        rows = np.repeat(dofs, np.diff(K.row_offsets))
        coo.preallocate(self._matrix, rows, dofs[K.columns])
        if partition.size > 1:
            # PETSc makes this rank's own part without a block size; Jacobi's blocks would then be read past their end.
            self._matrix.getDiagonalBlock().setBlockSize(dim)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        if self.preset.near_nullspace:
            coordinates = PETSc.Vec().createMPI((n, partition.n_global * dim), bsize=dim, comm=comm)
            coordinates.setArray(K.points[: partition.n_owned].ravel())
            self._modes = PETSc.NullSpace().createRigidBody(coordinates)
            self._matrix.setNearNullSpace(self._modes)
            coordinates.destroy()
        table = PETSc.Options(self._prefix)
        for key, value in self._options.items():
            table.setValue(key, "" if value is None else value)
        self._solver = PETSc.KSP().create(comm=comm)
        self._solver.setOptionsPrefix(self._prefix)
        self._solver.setOperators(self._matrix)
        self._solver.setFromOptions()
        self._x, self._b = self._matrix.createVecs()

    def _check_options(self) -> None:
        unused = [key for key in self._options if not coo.option_was_used(self._prefix + key)]
        self._checked = True
        if unused:
            raise InputError(
                [Fault("", 0, f"linear_solver.options.{key}", "PETSc did not use this option") for key in unused]
            )

    def solve(self, K: SparseHessian, b: FloatArray) -> LinearResult:
        """Solve K x = b; see `LinearSolver`."""
        if self.preset.global_solve:
            message = (
                f"{self.preset.name} is for saddle systems: solver mixed_fem, global_solve {self.preset.global_solve}"
            )
            raise InputError([Fault("", 0, "linear_solver.preset", message)])
        partition, dim = K.partition, K.dim
        try:
            if self._solver is None or K.pattern is not self._pattern:
                self._free()
                self._set_up(K)
                self._pattern = K.pattern
            is_direct = self._options.get("ksp_type") == "preonly"
            with nullcontext() if is_direct else blas.one_thread():
                coo.set_values(self._matrix, K.values)
                self._b.setArray(b[: partition.n_owned].ravel())
                self._x.set(0.0)
                self._solver.solve(self._b, self._x)
        except self._PETSc.Error as error:
            if error.ierr == _OUT_OF_MEMORY:
                raise MemoryError("PETSc") from None
            if self._checked:
                return LinearResult(np.zeros_like(b), 0, False, f"PETSc: {_cause(error)}")
            # The first solve is where PETSc reads its options.
            message = f"PETSc refuses preset {self.preset.name} with these options: {_cause(error)}"
            raise InputError([Fault("", 0, "linear_solver", message)]) from None
        if not self._checked:
            self._check_options()
        code = int(self._solver.getConvergedReason())
        x = np.empty((partition.n_local, dim))
        x[: partition.n_owned] = self._x.getArray(readonly=True).reshape(-1, dim)
        partition.update_ghosts(x)
        ran_out = code == int(self._PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT)
        return LinearResult(x, int(self._solver.getIterationNumber()), code > 0, self._reason(code), ran_out)

    def _reason(self, code: int) -> str:
        reasons = self._PETSc.KSP.ConvergedReason
        names = [n for n in dir(reasons) if not n.startswith("_") and getattr(reasons, n) == code]
        return min(names, key=len).lower().replace("_", " ") if names else f"reason {code}"

    def reset(self) -> None:
        """Drop factors and preconditioners; the next solve is that of a new object, on the same sparsity."""
        if self._solver is not None:
            self._solver.reset()
            self._solver.setOperators(self._matrix)

    def destroy(self) -> None:
        """Free the matrix, the solver and their options."""
        self._free()

    def _free(self) -> None:
        if self._solver is not None:
            for thing in (self._solver, self._matrix, self._x, self._b):
                thing.destroy()
            if self._modes is not None:
                self._modes.destroy()
            table = self._PETSc.Options(self._prefix)
            for key in self._options:
                table.delValue(key)
            self._solver = None
            self._modes = None
            self._pattern = None
