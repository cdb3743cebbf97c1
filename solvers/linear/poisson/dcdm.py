"""Deep conjugate directions: search directions from any function of the residual, A-orthogonal to the last ones."""

from __future__ import annotations

import math
from collections.abc import Callable

from femdeform.flow import grid_kernels
from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear.poisson.interface import PoissonResult
from solvers.linear.poisson.recurrence import Progress, Watch, solve_by

Directions = Callable[[GridArray], GridArray]
"""Turns a residual into a search direction, both zero where there is no unknown."""


class DeepConjugateDirections:
    """Search directions of a function f of the residual, usually a network.

    ``q = Pi f(r)``, from which the parts along the last directions are taken, ``q <- q - d (q.A d)/(d.A d)``, and a
    step of length ``(r.q)/(q.A q)``. Pi takes the mean of each closed component away. One product with A an iteration.
    The answer's residual is computed anew in double precision. f sees the residual as it is; `NetworkDirections` scales
    it.

    Parameters
    ----------
    system : PressureSystem
    directions : callable
        f. It need not be linear, symmetric or positive.
    kept : int or None
        Directions that a new one is made A-orthogonal to; None for all of them, which is robust with a poor f and needs
        two fields an iteration. f is not linear, so two do not imply the others, as they do in conjugate gradients.
    name : str
        For tables and logs.

    References
    ----------
    A. Kaneda, O. Akar, J. Chen, V. Kala, D. Hyde, J. Teran, A deep conjugate direction method for iteratively solving
    linear systems, ICML 2023. The printed algorithm sets the new direction to its part along the old ones in line 7;
    that part has to be subtracted.

    Limitations
    -----------
    A network evaluation costs as much as many iterations of anything else. Each is a step of a line search: the energy
    never rises, but there is no bound on the number of iterations.
    """

    def __init__(
        self, system: PressureSystem, directions: Directions, kept: int | None = 2, name: str = "dcdm"
    ) -> None:
        if kept is not None and kept < 1:
            raise ValueError("at least one direction has to be kept")
        self.system = system
        self.directions = directions
        self.kept = kept
        self.name = name
        self.last: list[tuple[GridArray, GridArray, float]] = []
        """Directions d that are kept, A d and d.A d."""

    def destroy(self) -> None:
        """Forget directions."""
        self.last = []

    def solve(
        self,
        b: GridArray,
        tolerance: float,
        max_iterations: int,
        x: GridArray | None = None,
        watch: Watch | None = None,
    ) -> PoissonResult:
        """Solve A x = b; see `PoissonSolver`. `watch` may stop it."""
        self.last = []
        return solve_by(self._iterate, self.system, b, tolerance, max_iterations, x, watch)

    def _iterate(self, r: GridArray, x: GridArray, progress: Progress) -> str:
        while progress.goes_on:
            reason = self._step(r, x) or progress.add(r)
            if reason:
                return reason
        return ""

    def _step(self, r: GridArray, x: GridArray) -> str:
        """Take one step; what prevented it."""
        system = self.system
        q = self.directions(r).astype(float)
        q[~system.unknown] = 0.0
        system.project(q)
        for d, Ad, dAd in self.last:
            grid_kernels.axpy(-system.dot(q, Ad) / dAd, d, q)
        Aq = system.new_field()
        system.apply(q, Aq)
        curvature = system.dot(q, Aq)
        if not math.isfinite(curvature):
            return "the direction is not finite"
        if not curvature > 0.0:
            return "the direction has no energy"
        step = system.dot(r, q) / curvature
        if step == 0.0:
            return "the direction is orthogonal to the residual"
        grid_kernels.axpy(step, q, x)
        grid_kernels.axpy(-step, Aq, r)
        self.last.append((q, Aq, curvature))
        if self.kept is not None:
            self.last = self.last[-self.kept :]
        return ""
