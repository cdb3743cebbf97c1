"""A product that checks answers: never timed."""

from __future__ import annotations

import numpy as np

from femdeform.fem.assembly import SparseHessian
from femdeform.types import FloatArray


def matrix_times(K: SparseHessian, field: FloatArray) -> FloatArray:
    """K times a (n_local, dim) field, on any number of ranks."""
    import scipy.sparse

    matrix = scipy.sparse.csr_matrix((K.values, K.columns, K.row_offsets), shape=(field.size, field.size))
    product = np.ascontiguousarray((matrix @ field.ravel()).reshape(field.shape))
    K.partition.accumulate(product)
    return product
