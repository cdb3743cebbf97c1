"""What the comparisons with exact and published solutions share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from femdeform.jit import set_threads


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    """These problems are too small to share: on a busy machine a second thread makes them several times slower."""
    import numba

    before = numba.get_num_threads()
    set_threads(1)
    yield
    set_threads(before)
