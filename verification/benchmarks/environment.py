"""What the surroundings say about a benchmark: its size, and which linear solvers there are."""

from __future__ import annotations

import os
from importlib.util import find_spec

from femdeform.errors import InputError

CELLS_VARIABLE = "FEMDEFORM_BENCH_CELLS"
ONLY_VARIABLE = "FEMDEFORM_BENCH_ONLY"


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


def is_wanted(case: str) -> bool:
    """Whether a case is to run: all of them, or those whose name has one of the texts of FEMDEFORM_BENCH_ONLY in it.

    The texts are separated by semicolons.
    """
    texts = [text.strip() for text in os.environ.get(ONLY_VARIABLE, "").split(";") if text.strip()]
    return not texts or any(text in case for text in texts)


def has_petsc() -> bool:
    """Whether petsc4py is installed."""
    return find_spec("petsc4py") is not None
