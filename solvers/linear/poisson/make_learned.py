"""A learned pressure solver from its weights."""

from __future__ import annotations

from femdeform.flow.pressure_system import PressureSystem
from femdeform.scene import pressure_schema as schema
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.dcdm import DeepConjugateDirections
from solvers.linear.poisson.dcdm_network import Architecture, NetworkDirections
from solvers.linear.poisson.guard import DCDM_LIMITS, LMG_LIMITS, Limits, WatchedSolver
from solvers.linear.poisson.spd_lmg import LearnedMultigrid
from solvers.linear.poisson.weights_file import Weights


def make_learned_solver(
    options: schema.LearnedPressureSolver, system: PressureSystem, weights: Weights
) -> tuple[WatchedSolver, Limits]:
    """The solver, and when it is to be stopped."""
    if isinstance(options, schema.SPDLMGPressureSolver):
        cycle = LearnedMultigrid(system, weights.parameters, options.sweeps)
        return ConjugateGradients(system, cycle, options.method), LMG_LIMITS
    architecture = Architecture(system.dim, **weights.meta["architecture"])
    kept = None if options.kept == "all" else options.kept
    directions = NetworkDirections(system, architecture, weights.parameters)
    return DeepConjugateDirections(system, directions, kept), DCDM_LIMITS
