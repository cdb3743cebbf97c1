"""Time integration by the trapezoidal rule, for comparison with benchmarks that were computed with it.

Backward Euler damps: a vibration of circular frequency w decays like exp(-w^2 h t / 2). Over ten periods of a benchmark
that leaves nothing to compare, whatever the elements are like. The trapezoidal rule (Newmark's with beta = 1/4, gamma =
1/2; Crank and Nicolson's for the first-order system) keeps the amplitude, and its step has the same form.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.fem.incremental_potential import IncrementalPotential, State
from femdeform.types import FloatArray


class TrapezoidalPotential(IncrementalPotential):
    """The step problem of the trapezoidal rule: backward Euler's with half the step and another inertial position.

    From x' = x + h (v + v')/2 and v' = v + h (a + a')/2, with M a' = f(x'), follows M (x' - x_hat) / (h/2)^2 = f(x')
    with x_hat = x + h v + h^2/4 a.

    Parameters
    ----------
    *args, **kwargs
        Those of `IncrementalPotential`.

    References
    ----------
    N. M. Newmark, A method of computation for structural dynamics, Journal of the Engineering Mechanics Division 85
    (1959).

    Limitations
    -----------
    Supports may not move; no contact with friction; serial; every step must be accepted before the next begins.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._acceleration: FloatArray | None = None
        self._h = 0.0

    def begin_step(self, state: State, dt: float) -> None:
        """Set what a step from `state` to ``state.time + dt`` freezes."""
        if self._acceleration is None:
            self.set_loads(state.time)
            self._acceleration = self._free_acceleration(self.load - self.internal_forces(state.x))
        super().begin_step(state, dt)
        self._h = dt
        self.dt = 0.5 * dt
        moved = state.x + dt * state.v + 0.25 * dt**2 * self._acceleration
        self._x_hat = np.where(self.free, moved, state.x)

    def accept(self, state: State, x: FloatArray) -> State:
        """Return the state after a solved step."""
        h, acceleration = self._h, self._acceleration
        if acceleration is None:
            raise RuntimeError("begin_step comes before accept")
        moved = x - state.x - h * state.v
        self._acceleration = np.where(self.free, 4.0 / h**2 * moved - acceleration, 0.0)
        v = np.where(self.free, 2.0 / h * (x - state.x) - state.v, 0.0)
        return State(x.copy(), v, state.time + h, state.step + 1)

    def _free_acceleration(self, force: FloatArray) -> FloatArray:
        """Solve M a = f on the free degrees of freedom, component by component."""
        import scipy.sparse
        import scipy.sparse.linalg

        mass = self.discretization.consistent_mass
        if mass is None:
            return np.where(self.free, force / self.discretization.lumped_mass[:, None], 0.0)
        matrix = scipy.sparse.csc_matrix(mass)
        result = np.zeros_like(force)
        for component in range(self.dim):
            free = np.flatnonzero(self.free[:, component])
            part = matrix[free][:, free].tocsc()
            result[free, component] = scipy.sparse.linalg.spsolve(part, force[free, component])
        return result
