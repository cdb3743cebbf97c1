"""Acceleration of fixed-point iterations x -> S(x): Chebyshev's semi-iteration, second-order SOR, Anderson's mixing.

All work on flat arrays and know nothing of what S is. They may make things worse, at first or for good: whoever uses
them watches the energy and goes back.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from femdeform.types import FloatArray
from solvers.mixing_kernels import inner_products, subtract_rows, take_differences

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
        self._buffers: _Buffers | None = None
        self._count = -1  # differences so far; -1: not even a residual
        self._norm = np.inf

    def restart(self) -> None:
        """See `Accelerator`."""
        self._count, self._norm = -1, np.inf

    def mix(self, before: FloatArray, swept: FloatArray) -> None:
        """See `Accelerator`."""
        own = self._buffers
        if own is None or own.image.size != swept.size or own.image.dtype != swept.dtype:
            own = self._buffers = _Buffers(self.window, swept)
            self.restart()
        row = max(self._count, 0) % self.window
        square = take_differences(before, swept, own.residual, own.image, own.residuals[row], own.images[row])
        norm = float(np.sqrt(square))
        first = self._count < 0 or not norm <= 2.0 * self._norm
        self._norm = norm
        if first:
            # What was written to the row is overwritten by the next difference.
            self._count = 0
            return
        self._count += 1
        used = min(self._count, self.window)
        products = own.products[:used]
        inner_products(own.residuals, used, row, own.residual, products)
        own.gram[:used, row] = own.gram[row, :used] = products[:, 0]
        # Scaled unknowns; what rounding makes of dependent directions is cut off.
        scale = np.sqrt(np.diag(own.gram)[:used])
        if not np.all(scale > 0.0) or not np.all(np.isfinite(scale)):
            self.restart()
            return
        values, vectors = np.linalg.eigh(own.gram[:used, :used] / np.outer(scale, scale))
        kept = values > max(_DEPENDENT, 10.0 * float(np.finfo(swept.dtype).eps)) * values[-1]
        right = vectors.T @ (products[:, 1] / scale)
        weights = (vectors[:, kept] @ (right[kept] / values[kept])) / scale
        subtract_rows(weights.astype(swept.dtype), own.images, swept)


class _Buffers:
    """What Anderson's mixing keeps, for vectors like the one given."""

    def __init__(self, window: int, vector: FloatArray) -> None:
        self.residual = np.zeros_like(vector)
        self.image = np.zeros_like(vector)
        self.residuals = np.zeros((window, vector.size), dtype=vector.dtype)
        self.images = np.zeros_like(self.residuals)
        self.gram = np.zeros((window, window))
        self.products = np.empty((window, 2))
