"""Deflated conjugate gradients for the pressure, with Ritz vectors of a Lanczos run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear.poisson.interface import PoissonResult, starting_point

# A Krylov space ends where the next vector is as short as this, over the largest value found: what is left is noise.
_USED_UP = 1e-9


class DeflatedConjugateGradients:
    """Conjugate gradients beside a space W of Ritz vectors, in which the error is zero from the start.

    W holds the `n_vectors` Ritz vectors of smallest Ritz value of a Lanczos run of `n_steps` steps with full
    reorthogonalisation. Directions are kept A-orthogonal to it:
    ``p <- r + beta p - W (W^T A W)^-1 W^T A r``.

    Parameters
    ----------
    system : PressureSystem
    n_vectors : int
    n_steps : int, optional
        Of Lanczos; default twelve times the vectors, at most the unknowns.
    seed : int
        Of the vector that Lanczos starts with.

    References
    ----------
    Y. Saad, M. Yeung, J. Erhel, F. Guyomarc'h, A deflated version of the conjugate gradient algorithm (2000), algorithm
    3.5.

    Limitations
    -----------
    A comparison. Making W costs more than solving once without it, and holds ``n_steps`` vectors.
    """

    name = "deflated_cg"

    def __init__(self, system: PressureSystem, n_vectors: int = 16, n_steps: int | None = None, seed: int = 0) -> None:
        self.system = system
        room = system.n_unknowns - system.n_closed
        steps = min(12 * n_vectors if n_steps is None else n_steps, room)
        self.W = _ritz_vectors(system, min(n_vectors, steps), steps, seed)
        self.AW = np.column_stack([self._times(w) for w in self.W.T]) if self.W.size else self.W
        self._coarse = np.linalg.cholesky(self.W.T @ self.AW) if self.W.size else np.empty((0, 0))

    def destroy(self) -> None:
        """Nothing to free."""

    def _times(self, values: Any) -> Any:
        out = self.system.new_field()
        self.system.apply(self.system.extend(values), out)
        return self.system.restrict(out)

    def _coarse_solve(self, values: Any) -> Any:
        import scipy.linalg

        return scipy.linalg.cho_solve((self._coarse, True), values) if self.W.size else values

    def solve(self, b: GridArray, tolerance: float, max_iterations: int, x: GridArray | None = None) -> PoissonResult:
        """Solve A x = b; see `PoissonSolver`."""
        system = self.system
        at, residual = starting_point(system, b, x)
        position, r = system.restrict(at), system.restrict(residual)
        target = tolerance * system.norm(b)
        position = position + self.W @ self._coarse_solve(self.W.T @ r)
        r = system.restrict(starting_point(system, b, system.extend(position))[1])
        residuals = [float(np.linalg.norm(r))]
        p = r - self.W @ self._coarse_solve(self.AW.T @ r)
        rr, iteration, reason = r @ r, 0, ""
        while residuals[-1] > target and iteration < max_iterations:
            Ap = self._times(p)
            curvature = p @ Ap
            if not curvature > 0.0:
                reason = "the matrix is not positive definite, or not finite"
                break
            step = rr / curvature
            position = position + step * p
            r = r - step * Ap
            previous, rr = rr, r @ r
            iteration += 1
            residuals.append(math.sqrt(rr))
            p = r + (rr / previous) * p - self.W @ self._coarse_solve(self.AW.T @ r)
        solution, true = starting_point(system, b, system.extend(position))
        residuals[-1] = system.norm(true)
        converged = residuals[-1] <= target
        if converged:
            reason = "residual below tolerance"
        return PoissonResult(solution, iteration, converged, reason or f"{iteration} iterations", residuals)


def _ritz_vectors(system: PressureSystem, n_vectors: int, n_steps: int, seed: int) -> Any:
    """Orthonormal Ritz vectors of the smallest Ritz values, (n_unknowns, n_vectors)."""
    if n_vectors == 0 or n_steps == 0:
        return np.empty((system.n_unknowns, 0))
    start = system.extend(np.random.default_rng(seed).standard_normal(system.n_unknowns))
    system.project(start)
    Q = np.empty((n_steps, system.n_unknowns))
    alpha, beta = np.zeros(n_steps), np.zeros(n_steps)
    q = system.restrict(start)
    q /= np.linalg.norm(q)
    out = system.new_field()
    n = 0
    while n < n_steps:
        Q[n] = q
        system.apply(system.extend(q), out)
        v = system.restrict(out)
        alpha[n] = q @ v
        for _ in range(2):  # once is not enough for full orthogonality
            v -= Q[: n + 1].T @ (Q[: n + 1] @ v)
        # Rounding brings the null space back in, and grows where the space is almost used up.
        again = system.extend(v)
        system.project(again)
        v = system.restrict(again)
        beta[n] = np.linalg.norm(v)
        n += 1
        if beta[n - 1] <= _USED_UP * alpha[:n].max():
            break
        q = v / beta[n - 1]
    T = np.diag(alpha[:n]) + np.diag(beta[: n - 1], 1) + np.diag(beta[: n - 1], -1)
    vectors = np.linalg.eigh(T)[1][:, : min(n_vectors, n)]
    return Q[:n].T @ vectors
