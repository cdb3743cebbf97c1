"""Entries grouped by number are those of a stable sort."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.counting_sort import sort_by_number


@pytest.mark.parametrize("kind", [np.int32, np.int64, np.uint32])
def test_entries_are_those_of_a_stable_sort(kind: type) -> None:
    numbers = np.random.default_rng(7).integers(0, 40, 1000).astype(kind)
    numbers[numbers == 13] = 12  # a number without entries
    entries, offsets = sort_by_number(numbers, 45)
    np.testing.assert_array_equal(entries, np.argsort(numbers, kind="stable"))
    np.testing.assert_array_equal(np.diff(offsets), np.bincount(numbers, minlength=45))
    assert (offsets[0], offsets[-1]) == (0, 1000)


def test_nothing_to_sort() -> None:
    entries, offsets = sort_by_number(np.empty(0, dtype=np.int32), 3)
    assert entries.size == 0
    np.testing.assert_array_equal(offsets, [0, 0, 0, 0])
