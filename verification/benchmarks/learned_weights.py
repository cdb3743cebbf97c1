"""Learned solvers of the pressure in benchmarks: whose weights, and why there are none."""

from __future__ import annotations

import os
from pathlib import Path

from femdeform.errors import InputError
from femdeform.flow.pressure_system import PressureSystem
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.dcdm import DeepConjugateDirections
from solvers.linear.poisson.dcdm_network import Architecture, NetworkDirections
from solvers.linear.poisson.interface import PoissonSolver
from solvers.linear.poisson.spd_lmg import LearnedMultigrid
from solvers.linear.poisson.weights_file import Weights, load_weights

WEIGHTS_VARIABLE = "FEMDEFORM_BENCH_WEIGHTS"


def bench_weights(method: str, dim: int) -> Weights:
    """Weights of a method and a dimension: the first such file of FEMDEFORM_BENCH_WEIGHTS, or the shipped ones.

    The variable holds paths of files `.npz`, separated by semicolons.

    Raises
    ------
    InputError
        If there are none, or a file is damaged.
    """
    for name in os.environ.get(WEIGHTS_VARIABLE, "").split(";"):
        if not name.strip():
            continue
        path = str(Path(name.strip()).resolve())
        try:
            return load_weights(path, method, dim)
        except InputError as error:
            # Of another method or dimension: that is no fault here.
            if "holds weights of method" not in str(error):
                raise
    return load_weights(None, method, dim)


def missing_weights(method: str, dim: int) -> str:
    """Why there are no weights; an empty text if there are."""
    try:
        bench_weights(method, dim)
    except InputError as error:
        return str(error).strip()
    return ""


def learned_solver(method: str, system: PressureSystem, sweeps: int = 1) -> PoissonSolver:
    """A learned solver by itself, without the guard that would let another one finish; `sweeps` are of cycles."""
    weights = bench_weights(method, system.dim)
    if method == "spd_lmg":
        return ConjugateGradients(system, LearnedMultigrid(system, weights.parameters, sweeps), method)
    return dcdm_solver(system, weights)


def dcdm_solver(system: PressureSystem, weights: Weights, kept: int | None = 2) -> PoissonSolver:
    """Deep conjugate directions with these weights."""
    architecture = Architecture(system.dim, **weights.meta["architecture"])
    return DeepConjugateDirections(system, NetworkDirections(system, architecture, weights.parameters), kept)
