"""Small functions that always become a part of the loop that calls them.

Compilers turn a loop over the cells of a chunk into vectors only if no call is left in it, and what they inline on
their own depends on the size of a function: matrix products as tuples of nine are too long for them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.extending import overload

from femdeform.jit import FASTMATH

Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS = {"error_model": "numpy", "fastmath": set(FASTMATH), "forceinline": True}


def inlined(function: Function) -> Function:
    """Compile a function as `femdeform.jit.njit` does, inlined wherever compiled code calls it; not kept by itself."""
    compiled: Function = numba.njit(**_OPTIONS)(function)
    return compiled


def inlined_overload(function: Callable[..., Any]) -> Callable[[Function], Function]:
    """As `numba.extending.overload`, what is chosen being inlined like a function that is `inlined`."""
    decorate: Callable[[Function], Function] = overload(function, jit_options=_OPTIONS)
    return decorate
