"""How many threads the BLASes of a process start with.

NumPy and SciPy each bring an OpenBLAS of their own, whose threads wait busily for the next of many small calls: beside
other programs they wait for cores that these have. They get one thread. The BLAS of PETSc, whose dense blocks in
factorisations use threads well, is loaded later, and gets as many as the kernels. Each reads the environment once, when
it is loaded; what the user has set there stands.
"""

from __future__ import annotations

import os

_THREADS = "OPENBLAS_NUM_THREADS"
# Also read by OpenBLAS, after the first.
_OTHERS = ("GOTO_NUM_THREADS", "OMP_NUM_THREADS")
# Tells a child process that the first variable is not the user's wish but ours, for this process.
_OURS = "FEMDEFORM_OPENBLAS_THREADS"


def is_chosen() -> bool:
    """Whether the user has set the number of threads."""
    chosen = os.environ.get(_THREADS)
    return chosen is not None and chosen != os.environ.get(_OURS)


def _export(count: int) -> None:
    os.environ[_THREADS] = os.environ[_OURS] = str(count)


def begin_with_one() -> None:
    """Give one thread to what is loaded from here on, unless the user has chosen."""
    if not is_chosen() and not any(name in os.environ for name in _OTHERS):
        _export(1)


def go_on_with(threads: int) -> None:
    """Give so many threads to what is loaded from here on, unless the user has chosen."""
    if not is_chosen():
        _export(threads)
