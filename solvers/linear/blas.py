"""Threads of the BLAS that PETSc calls."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from femdeform.blas_threads import is_chosen
from femdeform.jit import threads
from solvers.linear import coo


def follow_kernels() -> None:
    """Give PETSc's BLAS the threads of the kernels, unless the user has chosen.

    It has them already where it was loaded after their number was known and is a library of its own; not where PETSc
    was loaded earlier, or shares the library of NumPy, which begins with one.
    """
    library = coo.library()
    if hasattr(library, "openblas_set_num_threads") and not is_chosen():
        library.openblas_set_num_threads(threads())


@contextmanager
def one_thread() -> Iterator[None]:
    """Run PETSc's BLAS on one thread, as the vectors of a Krylov method want it.

    OpenBLAS splits vectors of more than 10,000 numbers over all its threads, which then wait busily for the next call
    and take the cores from the kernels that assemble: whole steps take two to four times as long. Factorisations,
    whose dense blocks use the threads well, run outside. Does nothing where the BLAS is another one.
    """
    library = coo.library()
    if not hasattr(library, "openblas_set_num_threads"):
        yield
        return
    before = library.openblas_get_num_threads()
    library.openblas_set_num_threads(1)
    try:
        yield
    finally:
        library.openblas_set_num_threads(before)
