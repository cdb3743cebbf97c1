"""What the surroundings say about a benchmark: its size, and which linear solvers there are."""

from __future__ import annotations

import os
from importlib.util import find_spec

from femdeform.errors import InputError

CELLS_VARIABLE = "FEMDEFORM_BENCH_CELLS"


def chosen_cells() -> int | None:
    """Grid cells along an edge from FEMDEFORM_BENCH_CELLS; None if it is not set.

    Raises
    ------
    InputError
        If it is not a whole number of at least 2.
    """
    text = os.environ.get(CELLS_VARIABLE, "").strip()
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and int(text) >= 2):
        raise InputError(f"{CELLS_VARIABLE}: expected a whole number of at least 2, got {text!r}")
    return int(text)


def has_petsc() -> bool:
    """Whether petsc4py is installed."""
    return find_spec("petsc4py") is not None
