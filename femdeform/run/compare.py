"""`femdeform compare`: several methods or option sets on one scene, from one start, judged by one residual."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from femdeform import parallel
from femdeform.errors import InputError
from femdeform.fem.incremental_potential import State
from femdeform.info import versions
from femdeform.jit import CompilationAnnouncer
from femdeform.run.compare_judge import mean_edge_length, stiffness_number
from femdeform.run.compare_reference import Reference, Row
from femdeform.run.compare_trial import DIVERGED, RESIDUAL_PARTS, Outcome, Trial
from femdeform.run.compare_variants import REFERENCE, Prepared, Variant, prepare, solver_options
from femdeform.run.output import FrameSource
from femdeform.run.status_line import StatusLine
from femdeform.run.threads import use_threads
from femdeform.run.vtu import FrameMesh
from femdeform.scene import schema
from femdeform.step_problem import Budget
from femdeform.types import FloatArray

__all__ = ["Comparison", "Plan", "Variant", "compare", "compare_prepared", "require_one_rank"]


@dataclass(frozen=True)
class Plan:
    """What is asked of every variant.

    Attributes
    ----------
    iterations, seconds : int or float
        Budget of every step; exactly one of them. A step whose budget is spent is accepted as it is.
    steps : int
        Steps; after the first each variant goes its own way.
    start_step : int
        The reference goes this many steps from the initial state first; all start from there.
    repeat : int
        Runs of each variant. The one of median length is reported, whole.
    threads : int, optional
        Threads of the kernels; default: all cores, but one for a small mesh.
    """

    iterations: int | None = None
    seconds: float | None = None
    steps: int = 1
    start_step: int = 0
    repeat: int = 1
    threads: int | None = None

    def check(self, scene: schema.DeformableScene) -> None:
        """Refuse what cannot be done.

        Raises
        ------
        InputError
            If there is not one budget, a number is out of range, or the scene ends before the last step.
        """
        if (self.iterations is None) == (self.seconds is None):
            raise InputError("give a budget of either iterations or seconds")
        if self.iterations is not None and self.iterations < 1:
            raise InputError(f"the budget of iterations must be positive, not {self.iterations}")
        if self.seconds is not None and not 0.0 < self.seconds < math.inf:
            raise InputError(f"the budget of seconds must be positive, not {self.seconds:g}")
        if self.steps < 1 or self.repeat < 1 or self.start_step < 0:
            raise InputError("steps and repeat must be positive, start_step must not be negative")
        available = math.ceil(scene.time.end / scene.time.dt - 1e-9)
        if self.start_step + self.steps > available:
            wanted = f"{self.start_step} steps to the start and {self.steps} to compare"
            raise InputError(f"{wanted} go beyond the scene's end: it has {available} steps of {scene.time.dt:g} s")


@dataclass(frozen=True)
class Comparison:
    """What was found.

    Attributes
    ----------
    steps : list of dict
        A row for every variant and step: variant, step, time, dt, iterations, linear_iterations, seconds, status,
        stopped_by, reported_residual (the solver's own), residual_norm, relative_residual, residual_max, force_scale,
        objective, distance, distance_max, kinetic_energy, elastic_energy, load_potential, contact_energy, total_energy,
        volume_ratio, min_jacobian, inverted_cells, and components of linear_momentum and angular_momentum.
    iterations : list of dict
        A row for every iteration, 0 being the start of the step: variant, step, iteration, seconds, residual_norm,
        relative_residual, residual_max, force_scale, objective, distance, distance_max; where a solver reports
        them also primary_residual and secondary_residual.
    reference : list of dict
        Rows of the converged reference, with the columns of `steps`.
    stiffness_number : float
        kappa = h^2 E / (rho dx^2), see `femdeform.run.compare_judge.stiffness_number`.
    facts : dict
        Scene, budget, tolerances, the solver of every variant, versions.
    mesh : FrameMesh
        Mesh of `states`.
    states : dict of str to dict of str to (n_nodes, ...) float64
        Point data of the last state, by label, of the reference and every variant that did not diverge:
        `displacement` and `deviation` from the reference [m], `velocity` [m/s] if the scene asks for it.
    notices : list of str
        What the user should be told.
    """

    steps: list[Row]
    iterations: list[Row]
    reference: list[Row]
    stiffness_number: float
    facts: dict[str, Any]
    mesh: FrameMesh
    states: dict[str, dict[str, FloatArray]]
    notices: list[str] = field(default_factory=list)

    @property
    def labels(self) -> list[str]:
        """Labels of the variants, in their order."""
        return list(self.facts["variants"])

    def of(self, label: str) -> list[Row]:
        """Rows of `steps` of a variant, or of the reference."""
        return self.reference if label == REFERENCE else [row for row in self.steps if row["variant"] == label]

    @property
    def split_labels(self) -> list[str]:
        """Labels of the variants whose solver takes its residual apart, see `RESIDUAL_PARTS`."""
        reporting = {row["variant"] for row in self.iterations if RESIDUAL_PARTS[0] in row}
        return [label for label in self.labels if label in reporting]

    @property
    def all_diverged(self) -> bool:
        """Whether no variant got through."""
        return all(self.of(label)[-1]["status"] == DIVERGED for label in self.labels)


def require_one_rank() -> None:
    """Refuse a run under ``mpiexec``.

    Raises
    ------
    InputError
        If there are several ranks.
    """
    if parallel.launched_ranks() > 1:
        raise InputError("compare is serial: run it without mpiexec")


def compare(
    path: Path,
    variants: Sequence[Variant],
    *,
    iterations: int | None = None,
    seconds: float | None = None,
    steps: int = 1,
    start_step: int = 0,
    repeat: int = 1,
    threads: int | None = None,
    overrides: Sequence[str] = (),
    status: StatusLine | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Comparison:
    """Let every variant solve the same steps within the same budget, and measure what it reaches.

    Parameters
    ----------
    path : Path
        Scene file.
    variants : sequence of Variant
        What to compare.
    iterations, seconds, steps, start_step, repeat, threads
        See `Plan`.
    overrides : sequence of str
        ``key=value`` for the scene, and so for all variants.
    status : StatusLine, optional
        Where to say what is going on.
    clock : callable
        Time by which seconds are counted [s].

    Returns
    -------
    Comparison
        Nothing is written.

    Raises
    ------
    InputError
        On bad input, or on more than one rank.
    NotConvergedError
        If the reference does not converge: then there is nothing to compare with.
    """
    require_one_rank()
    plan = Plan(iterations, seconds, steps, start_step, repeat, threads)
    return compare_prepared(prepare(path, variants, overrides), plan, status, clock)


def compare_prepared(
    prepared: Prepared,
    plan: Plan,
    status: StatusLine | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Comparison:
    """As `compare`, of a scene and variants that have been read."""
    scene, meshes = prepared.base.deformable, prepared.meshes
    plan.check(scene)
    n_cells = sum(mesh.n_cells for mesh in meshes.values())
    threads = use_threads(plan.threads, n_cells)
    status = StatusLine(active=False) if status is None else status
    with CompilationAnnouncer(status.notice):
        reference = Reference(scene, meshes, plan.start_step, plan.steps, status)
        trials = [
            Trial(
                variant.label,
                prepared.scenes[variant.label].deformable,
                meshes,
                reference,
                lambda: Budget(plan.iterations, plan.seconds, clock),
                status,
            )
            for variant in prepared.variants
        ]
        said = [*prepared.base.notices, *reference.simulation.notices]
        for trial in trials:
            said += trial.warm_up()
    runs: dict[str, list[Outcome]] = {trial.label: [] for trial in trials}
    for number in range(1, plan.repeat + 1):
        # One after the other, and again: a machine that slows down does so for all of them.
        for trial in trials:
            runs[trial.label].append(trial.run(f" (run {number} of {plan.repeat})" if plan.repeat > 1 else ""))
    chosen = {label: _median(outcomes) for label, outcomes in runs.items()}
    said += [text for outcome in chosen.values() for text in outcome.notices]

    source = FrameSource(reference.simulation)
    last = reference.states[-1]
    finals = {REFERENCE: last} | {label: o.state for label, o in chosen.items() if o.state is not None}
    return Comparison(
        steps=[row for outcome in chosen.values() for row in outcome.steps],
        iterations=[row for outcome in chosen.values() for row in outcome.iterations],
        reference=reference.rows,
        stiffness_number=stiffness_number(scene, meshes),
        facts={
            "title": scene.title,
            "scene_file": prepared.base.path.name,
            "scene_hash": prepared.base.hash,
            "budget": {"iterations": plan.iterations, "seconds": plan.seconds},
            "steps": plan.steps,
            "start_step": plan.start_step,
            "start_time": reference.start.time,
            "scheme": scene.time.scheme,
            "dt": scene.time.dt,
            "repeat": plan.repeat,
            "mean_edge_length": {name: mean_edge_length(mesh) for name, mesh in meshes.items()},
            "n_dofs": reference.simulation.discretization.n_dofs,
            "n_cells": n_cells,
            "threads": threads,
            "reference": reference.facts(),
            "variants": {
                variant.label: {
                    "overrides": list(variant.overrides),
                    **solver_options(prepared.scenes[variant.label]),
                    "seconds_of_each_run": [outcome.seconds for outcome in runs[variant.label]],
                }
                for variant in prepared.variants
            },
            "obstacles": [obstacle.model_dump(mode="json") for obstacle in scene.obstacles],
            "gravity": None if scene.gravity is None else list(scene.gravity),
            "versions": versions(),
        },
        mesh=source.mesh,
        states={label: _point_data(source, state, last) for label, state in finals.items()},
        notices=list(dict.fromkeys(said)),
    )


def _median(outcomes: Sequence[Outcome]) -> Outcome:
    """The run of median length: fewer iterations first, where seconds decide how many there are, then time."""
    ordered = sorted(outcomes, key=lambda o: (sum(row["iterations"] for row in o.steps), o.seconds))
    return ordered[(len(ordered) - 1) // 2]


def _point_data(source: FrameSource, state: State, reference: State) -> dict[str, FloatArray]:
    data = source.point_data(state)
    assert data is not None  # this is the only rank
    return {**data, "deviation": state.x - reference.x}
