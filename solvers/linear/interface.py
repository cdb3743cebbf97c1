"""What a nonlinear solver may ask of a linear solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from femdeform.fem.assembly import SparseHessian
from femdeform.types import FloatArray


@dataclass(frozen=True)
class LinearResult:
    """Answer of a linear solver.

    Attributes
    ----------
    x : (n_local, dim) float64
        Solution, ghosts updated; the caller must not trust it unless `converged`.
    iterations : int
        Iterations; 1 for a direct solver.
    converged : bool
        Whether the solver reached its own tolerance.
    reason : str
        Why it stopped, in words.
    ran_out : bool
        Whether it stopped because it had made all the iterations it was allowed.
    """

    x: FloatArray
    iterations: int
    converged: bool
    reason: str
    ran_out: bool = False


class LinearSolver(Protocol):
    """Solves K x = b with symmetric K, again and again, mostly with the same sparsity (`SparseHessian.pattern`)."""

    name: str

    def solve(self, K: SparseHessian, b: FloatArray) -> LinearResult:
        """Solve for a right-hand side (n_local, dim) that is consistent on ghosts."""

    def reset(self) -> None:
        """Forget everything learnt in earlier solves, so that the next one does not depend on them."""

    def destroy(self) -> None:
        """Free what the solver holds; it cannot be used afterwards."""
