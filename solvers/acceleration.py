"""Acceleration of fixed-point iterations x -> S(x): Chebyshev's semi-iteration, second-order SOR, Anderson's mixing.

All work on flat arrays and know nothing of what S is. They may make things worse, at first or for good: whoever uses
them watches the energy and goes back.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from femdeform.types import FloatArray

# Directions whose part beyond the others is smaller than this are rounding and are left out of Anderson's mixing.
_DEPENDENT = 1e-12


class Accelerator(Protocol):
    """Turns the result of a sweep into the next iterate."""

    def restart(self) -> None:
        """Forget the iterates so far."""

    def mix(self, before: FloatArray, swept: FloatArray) -> None:
        """Overwrite ``swept = S(before)`` with the next iterate."""


class Chebyshev:
    """``x+ = w (gamma (S(x) - x) + x - x_old) + x_old``; w = 2/(2 - rho^2), then 4/(4 - rho^2 w); one plain step.

    Parameters
    ----------
    rho : float
        Estimate of the convergence rate of the sweeps, below 1.
    gamma : float
        Relaxation. The rates of Gauss-Seidel sweeps lie in [0, rho]: 2/(2 - rho) centres them.

    References
    ----------
    H. Wang, A Chebyshev semi-iterative approach for accelerating projective and position-based dynamics (2015);
    dissertation, eq. 6.39.
    """

    def __init__(self, rho: float, gamma: float) -> None:
        self.rho = rho
        self.gamma = gamma
        self._old: FloatArray | None = None
        self._weight = 1.0

    def restart(self) -> None:
        """See `Accelerator`."""
        self._old = None

    def mix(self, before: FloatArray, swept: FloatArray) -> None:
        """See `Accelerator`."""
        if self._old is None:
            self._old, self._weight = before.copy(), 1.0
            return
        first = self._weight == 1.0
        self._weight = 2.0 / (2.0 - self.rho**2) if first else 4.0 / (4.0 - self.rho**2 * self._weight)
        kind = before.dtype.type
        swept -= before
        swept *= kind(self.gamma)
        swept += before
        swept -= self._old
        swept *= kind(self._weight)
        swept += self._old
        self._old[:] = before


class SOR:
    """``x+ = omega (S(x) - x_old) + x_old``, the second-order Richardson iteration that goes by the name of SOR.

    Its rate is sqrt(omega - 1) for all rates of S up to 2 sqrt(omega - 1)/omega; the first step is plain. Relaxation
    inside a sweep is something else, and often better.

    Parameters
    ----------
    omega : float
        In [1, 2).

    References
    ----------
    M. Fratarcangeli et al., Vivace (2016); dissertation, eq. 6.40.
    """

    def __init__(self, omega: float) -> None:
        self.omega = omega
        self._old: FloatArray | None = None

    def restart(self) -> None:
        """See `Accelerator`."""
        self._old = None

    def mix(self, before: FloatArray, swept: FloatArray) -> None:
        """See `Accelerator`."""
        if self._old is None:
            self._old = before.copy()
            return
        swept -= self._old
        swept *= before.dtype.type(self.omega)
        swept += self._old
        self._old[:] = before


class Anderson:
    """The combination of the last sweeps whose residual S(x) - x is smallest.

    ``x+ = S(x) - sum_k g_k (S_k+1 - S_k)`` with the g that make ``|r - sum_k g_k (r_k+1 - r_k)|`` least. A residual
    twice as large as the one before means that the last combination was a bad one: its history is dropped and the
    iteration goes on from the plain sweep.

    Parameters
    ----------
    window : int
        Differences that are kept.

    References
    ----------
    H. F. Walker, P. Ni, Anderson acceleration for fixed-point iterations (2011).
    """

    def __init__(self, window: int) -> None:
        self.window = window
        self._residuals: FloatArray | None = None
        self._images: FloatArray | None = None
        self._count = 0
        self._last: tuple[FloatArray, FloatArray] | None = None
        self._norm = np.inf

    def restart(self) -> None:
        """See `Accelerator`."""
        self._count, self._last, self._norm = 0, None, np.inf

    def mix(self, before: FloatArray, swept: FloatArray) -> None:
        """See `Accelerator`."""
        residual = swept - before
        norm = float(np.linalg.norm(residual))
        if not norm <= 2.0 * self._norm:
            self.restart()
        self._norm = norm
        last = self._last
        self._last = (residual, swept.copy())
        if last is None:
            return
        if self._residuals is None or self._images is None or self._residuals.shape[1] != residual.size:
            self._residuals = np.empty((self.window, residual.size), dtype=residual.dtype)
            self._images = np.empty_like(self._residuals)
        row = self._count % self.window
        np.subtract(residual, last[0], out=self._residuals[row])
        np.subtract(swept, last[1], out=self._images[row])
        self._count += 1
        used = min(self._count, self.window)
        differences = self._residuals[:used]
        # Normal equations with scaled unknowns; what rounding makes of dependent directions is cut off.
        gram = (differences @ differences.T).astype(np.float64)
        scale = np.sqrt(np.diag(gram))
        if not np.all(scale > 0.0) or not np.all(np.isfinite(scale)):
            self.restart()
            return
        values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
        kept = values > max(_DEPENDENT, 10.0 * float(np.finfo(residual.dtype).eps)) * values[-1]
        right = vectors.T @ ((differences @ residual).astype(np.float64) / scale)
        weights = (vectors[:, kept] @ (right[kept] / values[kept])) / scale
        swept -= weights.astype(residual.dtype) @ self._images[:used]
