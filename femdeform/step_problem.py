"""The contract between what is simulated and how a step is solved.

A nonlinear solver sees a `StepProblem` and nothing else; a time loop sees the solver's `StepResult`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from femdeform.parallel import Partition
from femdeform.types import BoolArray, FloatArray

# Called with one row per nonlinear iteration: iteration, residual_norm, relative_residual, objective, ...
IterationObserver = Callable[[Mapping[str, float | int | str]], None]


class StepProblem(Protocol):
    """A function Phi of node positions to be minimised in one step; fields are (n_local, dim) with ghosts updated."""

    partition: Partition
    free: BoolArray
    force_scale: float
    value_magnitude: float  # sum of the sizes of the terms of the last `value`, which may cancel [J]

    def initial_guess(self, state: Any) -> FloatArray:
        """Positions of the last state with the prescribed values of this step."""

    def value(self, x: FloatArray) -> float:
        """Phi(x) [J]; not finite where the material is not defined."""

    def gradient(self, x: FloatArray) -> FloatArray:
        """Residual [N], zero at prescribed degrees of freedom."""

    def full_gradient(self, x: FloatArray) -> FloatArray:
        """Gradient of Phi at every degree of freedom [N]."""

    def hessian(self, x: FloatArray, project: bool) -> Any:
        """Hessian for a `LinearSolver`; positive semi-definite cell by cell if `project`."""

    def hessian_times(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """Projected Hessian times a field, prescribed degrees of freedom included [N]."""

    def linearize_at(self, x: FloatArray) -> None:
        """Announce the state from which the next line search starts."""

    def settle_force_scale(self, x: FloatArray) -> None:
        """Complete `force_scale` at the first iterate, where the last state gives none."""

    def residual_norm(self, residual: FloatArray) -> float:
        """The one measure of a residual [N]."""

    def roundoff_norm(self, x: FloatArray) -> float:
        """Residual that rounding alone leaves [N]."""

    def max_step(self, x: FloatArray, step: FloatArray) -> float:
        """Largest admissible step length in (0, 1]."""


@dataclass(frozen=True)
class StepResult:
    """What a solver made of a step.

    Attributes
    ----------
    x : (n_local, dim) float64
        Last positions [m]; to be used only if `converged`.
    converged : bool
        Whether the residual is below its tolerance.
    reason : str
        Why the solver stopped, in words.
    iterations, linear_iterations : int
        Nonlinear iterations, and linear ones over all of them.
    residual_norm : float
        Residual at `x` [N].
    relative_residual : float
        The same over `StepProblem.force_scale` [-].
    """

    x: FloatArray
    converged: bool
    reason: str
    iterations: int
    linear_iterations: int
    residual_norm: float
    relative_residual: float


class StepSolver(Protocol):
    """A nonlinear solver."""

    def step(self, problem: Any, state: Any, observe: IterationObserver | None = None) -> StepResult:
        """Solve one step from an accepted state."""
