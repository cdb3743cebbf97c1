"""One implicit step of the grid: solve, find which walls hold, keep the momentum, rub."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femdeform.mpm.point_potential import PointPotential
from femdeform.step_problem import Budget, IterationObserver, StepSolver
from femdeform.types import FloatArray

# Solves with different sets of nodes in contact after which there is none that fits.
_PASSES = 20


@dataclass(frozen=True)
class GridSolution:
    """What became of a step; arrays are those of all nodes on every rank.

    Attributes
    ----------
    velocity : (n_nodes, dim) float64
        Velocities of the nodes after walls, friction and the momentum's correction [m/s]; to be used only if
        `converged`.
    converged : bool
    reason : str
        Why the last solve ended, or what is wrong with the contact.
    iterations, linear_iterations, passes : int
        Nonlinear and linear iterations over all solves, and solves.
    residual_norm, relative_residual : float
        Of the last solve [N], [-].
    velocity_error : float
        Bound of the error of the velocities that the residual leaves, their root mean square by mass [m/s].
    wall_forces : (n_nodes, dim) float64
        Forces of the walls without friction [N].
    momentum_shift : (dim,) float64
        What was added to all velocities to make the momentum exact [m/s]; zero where a wall holds.
    """

    velocity: FloatArray
    converged: bool
    reason: str
    iterations: int
    linear_iterations: int
    passes: int
    residual_norm: float
    relative_residual: float
    velocity_error: float
    wall_forces: FloatArray
    momentum_shift: FloatArray


def solve_step(
    problem: PointPotential,
    solver: StepSolver,
    tolerance: float,
    observe: IterationObserver | None = None,
    budget: Budget | None = None,
) -> GridSolution:
    """Solve the step begun.

    Parameters
    ----------
    problem : PointPotential
        With the step begun.
    solver : StepSolver
        `ProjectedNewton`, or another solver that sees nothing but a `StepProblem`.
    tolerance : float
        The solver's, residual over `force_scale` [-]: reactions below it count as none.
    observe, budget
        See `StepSolver`.

    Returns
    -------
    GridSolution
        Nothing is raised if a solve does not converge or no set of nodes in contact fits.
    """
    iterations, linear_iterations, passes = 0, 0, 0
    while True:
        result = solver.step(problem, problem.solver_state(None), observe, budget)
        iterations += result.iterations
        linear_iterations += result.linear_iterations
        passes += 1
        converged, reason = result.converged, result.reason
        if not converged:
            reason += problem.obstacle(result.x)
            break
        if not problem.update_contact(result.x, tolerance):
            break
        if passes == _PASSES:
            converged, reason = False, f"walls: no set of nodes in contact was found in {passes} solves"
            break
    velocity = problem.grid_velocity(result.x)
    forces, shift = np.zeros_like(velocity), np.zeros(problem.dim)
    everywhere = problem.partition.everywhere
    if problem.is_held():
        gradient = problem.node_forces(result.x)
        held = problem.contact.held.any(axis=1)
        forces[held] = gradient[held]
        forces = everywhere(forces)
        velocity = everywhere(problem.contact.rub(velocity, gradient, problem.mass))
    else:
        forces, velocity = everywhere(forces), everywhere(velocity)
        # Deformations do not see it: the residual's resultant is all that an inexact solve adds to the momentum.
        mass = problem.every_mass
        total = mass.sum()
        wanted = mass @ problem.every_velocity + problem.dt * total * problem.gravity
        shift = (wanted - mass @ velocity) / total
        velocity = velocity + shift
    return GridSolution(
        velocity,
        converged,
        reason,
        iterations,
        linear_iterations,
        passes,
        result.residual_norm,
        result.relative_residual,
        problem.velocity_error(result.residual_norm),
        forces,
        shift,
    )
