"""Assembly of PETSc matrices from coordinate lists.

``MatSetPreallocationCOO`` and ``MatSetValuesCOO`` sort the coordinates once and then take new values in one call.
petsc4py offers them from release 3.19 on; the C functions exist since PETSc 3.17 and are called directly where the
Python names are missing.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np

from femdeform.types import FloatArray

_INSERT_VALUES = 1


@cache
def library() -> Any:
    """PETSc as a C library, with the argument types of the functions used here declared."""
    from petsc4py import PETSc

    # The extension module is linked against PETSc, so its symbols are found through it.
    library = ctypes.CDLL(PETSc.__file__)
    library.MatSetPreallocationCOO.argtypes = [ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_void_p, ctypes.c_void_p]
    library.MatSetValuesCOO.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int]
    library.PetscOptionsUsed.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    return library


def check(error: int, function: str) -> None:
    """Raise if a PETSc function returned an error code."""
    if error != 0:
        raise RuntimeError(f"{function} failed with PETSc error {error}")


def preallocate(matrix: Any, rows: np.ndarray, columns: np.ndarray) -> None:
    """Fix the sparsity of a matrix from global coordinates; entries with the same coordinates add up.

    Parameters
    ----------
    matrix : PETSc.Mat
        Created, with sizes and type set.
    rows, columns : (n,) int arrays
        Global indices, rows of other ranks included. Overwritten.
    """
    from petsc4py import PETSc

    # PETSc uses these arrays as scratch and may change them.
    i = np.array(rows, dtype=PETSc.IntType)
    j = np.array(columns, dtype=PETSc.IntType)
    if hasattr(matrix, "setPreallocationCOO"):
        matrix.setPreallocationCOO(i, j)
        return
    error = library().MatSetPreallocationCOO(matrix.handle, i.size, i.ctypes.data, j.ctypes.data)
    check(error, "MatSetPreallocationCOO")


def set_values(matrix: Any, values: FloatArray) -> None:
    """Replace the values of a matrix, in the order of the coordinates given to `preallocate`."""
    if hasattr(matrix, "setValuesCOO"):
        matrix.setValuesCOO(values, addv=_INSERT_VALUES)
        return
    check(library().MatSetValuesCOO(matrix.handle, values.ctypes.data, _INSERT_VALUES), "MatSetValuesCOO")


def option_was_used(name: str) -> bool:
    """Whether PETSc has asked for an option (with its prefix, without dash) since it was set."""
    used = ctypes.c_int(0)
    check(library().PetscOptionsUsed(None, name.encode(), ctypes.byref(used)), "PetscOptionsUsed")
    return bool(used.value)
