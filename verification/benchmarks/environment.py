"""What the surroundings say about a benchmark: its size, its threads, which linear solvers and peers there are."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

from femdeform import jit
from femdeform.errors import InputError

CELLS_VARIABLE = "FEMDEFORM_BENCH_CELLS"
ONLY_VARIABLE = "FEMDEFORM_BENCH_ONLY"
PEERS_VARIABLE = "FEMDEFORM_PEERS"
_NOT = "not "


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

    The texts are separated by semicolons. A text after the word ``not`` takes away the cases that have it.
    """
    texts = [text.strip() for text in os.environ.get(ONLY_VARIABLE, "").split(";") if text.strip()]
    barred = [text.removeprefix(_NOT).strip() for text in texts if text.startswith(_NOT)]
    wanted = [text for text in texts if not text.startswith(_NOT)]
    return (not wanted or any(text in case for text in wanted)) and not any(text in case for text in barred)


def has_petsc() -> bool:
    """Whether petsc4py is installed."""
    return find_spec("petsc4py") is not None


def thread_counts() -> list[int]:
    """All threads, and one."""
    return sorted({jit.default_threads(), 1}, reverse=True)


def peers_python() -> tuple[Path | None, str]:
    """Return the Python of the environment with the peers, or None and the reason.

    FEMDEFORM_PEERS names the environment's folder or its Python; default: ``.venv-peers`` in the source tree or in
    the current folder, as `make peers` leaves it.
    """
    named = os.environ.get(PEERS_VARIABLE, "").strip()
    folders = [Path(named)] if named else [Path(__file__).resolve().parents[2] / ".venv-peers", Path(".venv-peers")]
    for folder in folders:
        for candidate in (folder / "bin" / "python", folder):
            if candidate.is_file() and os.access(candidate, os.X_OK):
                return candidate.absolute(), ""
    if named:
        return None, f"there is no Python at {named} ({PEERS_VARIABLE})"
    return None, "no environment with peers: make one with `make peers`"
