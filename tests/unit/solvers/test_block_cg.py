"""Conjugate gradients with blocks of nodes: the answer, its measure, and honest failure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.fem.assembly import SparseHessian
from femdeform.parallel import Partition
from solvers.linear.block_cg import BlockCG

Array = NDArray[np.float64]


@dataclass
class Dense:
    matrix: Array
    dim: int

    def __post_init__(self) -> None:
        self.partition = Partition.serial(len(self.matrix) // self.dim)

    def times(self, field: Array) -> Array:
        return np.asarray((self.matrix @ field.ravel()).reshape(field.shape))

    def diagonal_blocks(self) -> Array:
        n = len(self.matrix) // self.dim
        return self.matrix.reshape(n, self.dim, n, self.dim)[np.arange(n), :, np.arange(n)]


def definite(n: int, dim: int, spread: float, seed: int = 0) -> Dense:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n * dim, n * dim))
    scale = np.repeat(10.0 ** rng.uniform(-spread, 0.0, n), dim)
    return Dense(np.sqrt(scale)[:, None] * (A @ A.T / (n * dim) + np.eye(n * dim)) * np.sqrt(scale), dim)


@pytest.mark.parametrize("dim", [2, 3])
def test_answer(dim: int) -> None:
    K = definite(20, dim, 9.0)
    b = K.times(np.random.default_rng(1).standard_normal((20, dim)))
    found = BlockCG(1e-12, 500).solve(K, b)
    assert found.converged
    np.testing.assert_allclose(K.times(found.x), b, rtol=0.0, atol=1e-9 * np.abs(b).max())


def test_blocks_make_iterations_independent_of_the_scale_of_nodes() -> None:
    counts = []
    for spread in (0.0, 9.0):
        K = definite(30, 3, spread)
        b = K.times(np.sqrt(1.0 / np.einsum("icc->i", K.diagonal_blocks()))[:, None] * np.ones((30, 3)))
        counts.append(BlockCG(1e-8).solve(K, b).iterations)
    assert counts[0] > 5
    assert abs(counts[1] - counts[0]) <= 2


def test_block_diagonal_matrix_takes_one_iteration() -> None:
    blocks = definite(1, 3, 0.0).matrix
    K = Dense(np.kron(np.diag([1.0, 1e-8, 3.0]), blocks), 3)
    b = np.arange(1.0, 10.0).reshape(3, 3)
    found = BlockCG().solve(K, b)
    assert found.iterations == 1
    np.testing.assert_allclose(found.x, np.linalg.solve(K.matrix, b.ravel()).reshape(3, 3), rtol=1e-10)
    assert BlockCG().solve(K, np.zeros((3, 3))).iterations == 0


def test_assembled_matrices_are_taken_too() -> None:
    import scipy.sparse

    dense = definite(12, 3, 6.0).matrix
    dense[:9, 24:] = dense[24:, :9] = 0.0  # not full
    dense += 2.0 * np.diag(np.diag(dense))
    matrix = scipy.sparse.csr_matrix(dense)
    points, free = np.zeros((12, 3)), np.ones((12, 3), dtype=bool)
    K = SparseHessian(matrix.indptr, matrix.indices, matrix.data, points, free, Partition.serial(12), object())
    np.testing.assert_array_equal(K.diagonal_blocks(), Dense(dense, 3).diagonal_blocks())
    b = np.random.default_rng(2).standard_normal((12, 3))
    found = BlockCG(1e-10).solve(K, b)
    assert found.converged
    np.testing.assert_allclose(found.x.ravel(), np.linalg.solve(dense, b.ravel()), rtol=1e-6)


def test_failure_is_said() -> None:
    K = definite(20, 2, 0.0)
    b = np.ones((20, 2))
    short = BlockCG(1e-12, 3).solve(K, b)
    assert not short.converged
    assert short.ran_out
    assert "3" in short.reason
    indefinite = Dense(K.matrix - 1.5 * np.eye(40), 2)
    found = BlockCG().solve(indefinite, b)
    assert not found.converged
    assert "not positive definite" in found.reason
    broken = Dense(K.matrix.copy(), 2)
    broken.matrix[0, 0] = np.nan
    assert BlockCG().solve(broken, b).reason == "matrix is not finite"
    singular = Dense(np.zeros((4, 4)), 2)
    assert "singular" in BlockCG().solve(singular, np.ones((2, 2))).reason
