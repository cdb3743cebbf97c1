"""What solvers of the pressure system share: how they are called, and what they answer."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from femdeform.flow.pressure_system import GridArray, PressureSystem


@dataclass
class PoissonResult:
    """Answer of a pressure solver.

    Attributes
    ----------
    x : (nx + 2, ny + 2, nz + 2) float64
        Solution, without mean on closed components.
    iterations : int
    converged : bool
        Whether the residual, computed anew in double precision, meets the tolerance.
    reason : str
        Why it stopped, in words.
    residuals : list of float
        Euclidean norm of the residual at the start and after each iteration, the last one computed anew [m/s].
    """

    x: GridArray
    iterations: int
    converged: bool
    reason: str
    residuals: list[float] = field(default_factory=list)


class Preconditioner(Protocol):
    """A symmetric positive definite operator close to the inverse of A, for fields without mean."""

    def apply(self, r: GridArray, z: GridArray) -> None:
        """Write the operator times `r` to `z`; both are zero where there is no unknown."""


class PoissonSolver(Protocol):
    """Solves A x = b on one grid, for one right-hand side after another."""

    @property
    def name(self) -> str:
        """What it is, in a word."""

    def solve(self, b: GridArray, tolerance: float, max_iterations: int, x: GridArray | None = None) -> PoissonResult:
        """Solve to |r| <= tolerance |b|; `x` is where to start, if not at zero. b has no mean on closed components."""

    def destroy(self) -> None:
        """Free what Python does not."""


def starting_point(system: PressureSystem, b: GridArray, x: GridArray | None) -> tuple[GridArray, GridArray]:
    """Return a copy of the start and its residual, both without mean on closed components."""
    at = system.new_field() if x is None else x.astype(float)
    at[~system.unknown] = 0.0
    r = system.new_field()
    set_residual(system, b, at, r)
    system.project(at)
    return at, r


def set_residual(system: PressureSystem, b: GridArray, x: GridArray, r: GridArray) -> None:
    """Write b - A x to `r`, without mean on closed components."""
    system.apply(x, r)
    r[...] = b - r
    r[~system.unknown] = 0.0
    system.project(r)
