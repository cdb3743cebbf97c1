"""How many threads a computation gets."""

from __future__ import annotations

import os

from femdeform.blas_threads import go_on_with
from femdeform.jit import set_threads

# Cells of bodies, and voxels of flows, whose loops are worth a second thread.
THREADED_CELLS, THREADED_VOXELS = 2000, 30_000


def use_threads(threads: int | None, n_cells: int, worth: int = THREADED_CELLS) -> int:
    """Set the threads of the kernels and of the linear algebra behind the linear solvers.

    Parameters
    ----------
    threads : int, optional
        As the user asked; default: cores divided by ranks, but one where there are few cells.
    n_cells : int
        Cells of all bodies.
    worth : int
        Below that many a second thread costs more than it does.

    Returns
    -------
    int
        The number in effect.
    """
    if threads is None and n_cells < worth and "FEMDEFORM_THREADS" not in os.environ:
        # Few cells are done before a second thread has woken up.
        threads = 1
    used = set_threads(threads)
    # PETSc's BLAS is loaded later and would take all cores on every rank.
    go_on_with(used)
    return used
