"""The way from the last state to one that carries the prescribed motion of a step, past contact that is in the way."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.step_problem import Budget, StepProblem
from femdeform.types import FloatArray
from solvers.linear.interface import LinearResult

# Portions into which contact may break the motion of a step. What it lets through each time is about nine tenths of
# the narrowest gap; after this many a smaller time step is the better way.
_PORTIONS = 40
# Portions of less than this part of the motion, one after another, after which there is no way.
_STUCK = (1e-3, 3)
# Halvings of a portion at whose end a material is not defined.
_HALVINGS = 20
# Iterations that let bodies give way between two portions.
RELAXATIONS = 3

# Solves with the definite Hessian at positions (n_local, dim) for a right-hand side [N], zero where x is prescribed.
Solve = Callable[[FloatArray, FloatArray], LinearResult]


@dataclass(frozen=True)
class FirstIterate:
    """Where a step's iteration starts, and what the way there took.

    Attributes
    ----------
    x : (n_local, dim) float64
        Positions with the prescribed values of the step [m], unless `failure` says why not.
    objective : float
        Phi before the motion was spread over the bodies [J]; not a number where it was carried in portions.
    length : float
        1 if the motion was spread over the bodies, 0 if only the supports were moved.
    iterations, linear_iterations : int
        Zero if nothing moves, else one for each portion and what bodies took to give way.
    failure : str
        Why the motion cannot be carried out, or empty.
    """

    x: FloatArray
    objective: float
    length: float
    iterations: int
    linear_iterations: int
    failure: str = ""


def carry_supports(
    problem: StepProblem,
    state: Any,
    solve: Solve,
    relax: Callable[[FloatArray], tuple[FloatArray, int, int]],
    budget: Budget,
) -> FirstIterate:
    """Carry out the prescribed motion of supports and obstacles.

    One linearised step spreads it over the bodies instead of crushing the elements at the supports. Where contact
    forbids that step, it is taken as far as contact allows, bodies give way, and the rest follows.

    Parameters
    ----------
    problem : StepProblem
        With the step begun.
    state : State
        Last accepted state; not changed.
    solve : callable
        Solves for the answer of the bodies with the definite Hessian: takes positions and a right-hand side.
    relax : callable
        Takes positions to lower Phi at the same supports: returns new positions, iterations, linear iterations.
    budget : Budget
        Looked at before every further portion.

    Returns
    -------
    FirstIterate
    """
    guess = problem.initial_guess(state)
    motion = guess - state.x
    if problem.partition.max(float(np.abs(motion).max(initial=0.0))) == 0.0 and not problem.obstacles_push:
        return FirstIterate(guess, math.nan, 0.0, 0, 0)
    response, linear_iterations, converged = _response(problem, state.x, motion, 1.0, solve)
    problem.linearize_at(state.x)
    part = problem.max_step(state.x, motion + response, 1.0) if converged else 1.0
    if part == 1.0:
        problem.place_obstacles(1.0)
        objective = problem.value(guess)
        if converged:
            spread = guess + response
            value = problem.value(spread)
            if math.isfinite(value) and not objective < value:
                return FirstIterate(spread, objective, 1.0, 1, linear_iterations)
        if math.isfinite(objective) or not problem.has_barriers:
            return FirstIterate(guess, objective, 0.0, 1, linear_iterations)
        problem.place_obstacles(0.0)

    x, left, iterations, stuck = state.x, 1.0, 0, 0
    spent: str | None = None
    for portion in range(_PORTIONS):
        if portion > 0:
            spent = budget.spent(iterations)
            if spent is not None:
                break
            motion = np.where(problem.free, 0.0, guess - x)
            response, linear, converged = _response(problem, x, motion, left, solve)
            linear_iterations += linear
            part = problem.max_step(x, motion + response, left) if converged else 0.0
        if not converged:
            break
        before = 1.0 - left
        for _ in range(_HALVINGS):
            ahead = x + part * (motion + response)
            if part == 1.0:
                ahead = np.where(problem.free, ahead, guess)
            problem.place_obstacles(before + part * left)
            if math.isfinite(problem.value(ahead)):
                break
            part *= 0.5
        else:
            break
        stuck = stuck + 1 if part * left < _STUCK[0] else 0
        x, left, iterations = ahead, left * (1.0 - part), iterations + 1
        if part == 1.0:
            return FirstIterate(x, math.nan, 1.0, iterations, linear_iterations)
        if stuck == _STUCK[1]:
            break
        x, relaxations, linear = relax(x)
        iterations += relaxations
        linear_iterations += linear
    reason = spent or "contact or a material is in the way"
    if not converged:
        reason = "the linear solver failed on the way"
    failure = f"only {100.0 * (1.0 - left):.3g} % of the prescribed motion could be carried out: {reason}"
    return FirstIterate(x, math.nan, 0.0, iterations, linear_iterations, failure)


def _response(
    problem: StepProblem, x: FloatArray, motion: FloatArray, drift: float, solve: Solve
) -> tuple[FloatArray, int, bool]:
    """Linearised answer of the free degrees of freedom to a motion of supports and obstacles."""
    force = problem.full_gradient(x) + problem.hessian_times(x, motion, drift)
    answer = solve(x, -np.where(problem.free, force, 0.0))
    return np.where(problem.free, answer.x, 0.0), answer.iterations, answer.converged
