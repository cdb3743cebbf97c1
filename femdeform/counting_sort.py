"""Sorting by small whole numbers: which entries have each number, in order."""

from __future__ import annotations

from typing import Any

import numpy as np


def sort_by_number(numbers: np.ndarray[Any, Any], n: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Group entries by their number, without comparing any two.

    Parameters
    ----------
    numbers : (n_entries,) integers
        In 0..n - 1.
    n : int
        How many numbers there are.

    Returns
    -------
    entries : (n_entries,) int32, int64 for 2^31 entries and more
        Entries with number 0, then those with number 1, ...; ascending within a number, as by a stable sort.
    offsets : (n + 1,) int32 or int64
        First entry of each number.
    """
    import scipy.sparse

    size = int(numbers.size)
    kind = np.int32 if max(size, n) < 2**31 - 1 else np.int64
    # One mark in each row, in the column of its number: the rows of a column are the entries of a number.
    marks = np.ones(size, dtype=np.int8)
    rows = scipy.sparse.csr_matrix((marks, numbers.astype(kind), np.arange(size + 1, dtype=kind)), shape=(size, n))
    columns = rows.tocsc()
    return columns.indices, columns.indptr
