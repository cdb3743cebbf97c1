"""The `expect:` block: values at the end of a run, and whether they are inside their tolerance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.fem.incremental_potential import State
from femdeform.run.quantities import Meter, Snapshot, motion, reaction, scalar_quantity
from femdeform.run.setup import Simulation
from femdeform.scene.quantity_schema import ExpectedTime, ExpectedValue
from femdeform.scene.selection_schema import Selection

Columns = Mapping[str, NDArray[Any]]

_SCALARS = ("volume_ratio", "elastic_energy", "kinetic_energy", "total_energy", "max_displacement", "min_jacobian")


def check_expectations(simulation: Simulation, state: State, history: Columns | None = None) -> list[dict[str, Any]]:
    """Compare every expected value of a scene with the computed one; collective over the ranks.

    Parameters
    ----------
    simulation : Simulation
        Its problem holds the loads and the inertia of the step that led to the state.
    state : State
        Last accepted state.
    history : mapping of str to (n_steps,) arrays
        Columns of ``history.csv``, the same on every rank; needed for `residual` and `time_to_reach`.

    Returns
    -------
    list of dict
        ``quantity, computed, expected, rtol, atol, at_least, at_most, passed`` of each, as far as they are given, in
        the order of the schema.

    Raises
    ------
    ValueError
        If the history is needed and not given.
    """
    expect = simulation.scene.expect
    snapshot = Snapshot(simulation, state)
    verdicts = []
    for name in _SCALARS:
        expected = getattr(expect, name)
        if expected is not None:
            verdicts.append(verdict(name, scalar_quantity(name, None)(snapshot), expected))
    if expect.residual is not None:
        verdicts.append(verdict("residual", largest_of(history, "relative_residual"), expect.residual))
    for wanted in expect.displacement:
        place = _words(wanted.on) if wanted.on is not None else f"point {list(wanted.at or ())}"
        computed = motion(simulation, wanted, wanted.component)(snapshot)
        verdicts.append(verdict(f"displacement.{wanted.component} on {place}", computed, wanted))
    for force in expect.reaction:
        computed = reaction(simulation, force.on, force.component)(snapshot)
        verdicts.append(verdict(f"reaction.{force.component} on {_words(force.on)}", computed, force))
    if expect.measured or expect.time_to_reach:
        meter = Meter(simulation)
        values = meter.evaluate(state) if expect.measured else {}
        verdicts += measured_verdicts(expect.measured, values)
        start = meter.evaluate(simulation.state, is_start=True) if expect.time_to_reach else {}
        verdicts += crossing_verdicts(expect.time_to_reach, history, start)
    return verdicts


def largest_of(history: Columns | None, column: str) -> float:
    """Largest value of a column of ``history.csv``; 0 for a run without steps.

    Raises
    ------
    ValueError
        If there is no history.
    """
    return float(np.asarray(_needed(history)[column], dtype=float).max(initial=0.0))


def measured_verdicts(expected: Mapping[str, ExpectedValue], values: Mapping[str, float]) -> list[dict[str, Any]]:
    """Verdicts of quantities of `measure` at the end."""
    return [verdict(f"measure.{name}", values[name], value) for name, value in expected.items()]


def crossing_verdicts(
    expected: Sequence[ExpectedTime], history: Columns | None, start: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Verdicts of `time_to_reach`; `start` holds the quantities at time 0.

    Raises
    ------
    ValueError
        If there is no history.
    """
    verdicts = []
    for crossing in expected:
        time = time_to_reach(_needed(history), crossing, start[crossing.quantity])
        verdicts.append(verdict(f"time at which {crossing.quantity} reaches {crossing.level:g}", time, crossing))
    return verdicts


def time_to_reach(history: Columns, wanted: ExpectedTime, start: float) -> float:
    """Simulated time at which a quantity first reaches a level, linear between steps; infinite if it never does [s].

    Parameters
    ----------
    history : mapping of str to (n_steps,) arrays
        With `time` and the column of the quantity.
    wanted : ExpectedTime
        The quantity and its level.
    start : float
        Value at time 0.
    """
    values = np.concatenate([[start], history[f"measure.{wanted.quantity}"]])
    times = np.concatenate([[0.0], history["time"]])
    # A quantity may not be defined at first: the centroid of smoke before there is any.
    known = np.isfinite(values)
    if not known.any():
        return math.inf
    values, times = values[known], times[known]
    offset = values - wanted.level
    if offset[0] == 0.0:
        return 0.0
    reached = np.flatnonzero(np.sign(offset) != np.sign(offset[0]))
    if not reached.size:
        return math.inf
    after = int(reached[0])
    part = offset[after - 1] / (offset[after - 1] - offset[after])
    return float(times[after - 1] + part * (times[after] - times[after - 1]))


def describe_verdict(verdict: Mapping[str, Any]) -> str:
    """One verdict in words: what was computed, what was expected."""
    if verdict.get("expected") is not None:
        wanted = f"expected {verdict['expected']:.6g}"
    else:
        bounds = {"at least": verdict.get("at_least"), "at most": verdict.get("at_most")}
        wanted = " and ".join(f"{word} {bound:.6g}" for word, bound in bounds.items() if bound is not None)
        wanted = f"expected {wanted}"
    return f"{verdict['quantity']} is {verdict['computed']:.6g}, {wanted}"


def _needed(history: Columns | None) -> Columns:
    if history is None:
        raise ValueError("these expectations need the history of the run")
    return history


def _words(on: Selection | None) -> str:
    return on if isinstance(on, str) else "selection"


def verdict(quantity: str, computed: float, expected: ExpectedValue) -> dict[str, Any]:
    """Compare a computed value with an expected one; see `check_expectations`."""
    found: dict[str, Any] = {"quantity": quantity, "computed": computed}
    if expected.value is not None:
        allowed = expected.atol + expected.rtol * abs(expected.value)
        passed = abs(computed - expected.value) <= allowed
        found |= {"expected": expected.value, "rtol": expected.rtol, "atol": expected.atol}
    else:
        low = -math.inf if expected.at_least is None else expected.at_least
        high = math.inf if expected.at_most is None else expected.at_most
        passed = math.isfinite(computed) and low <= computed <= high
        given = {"at_least": expected.at_least, "at_most": expected.at_most}
        found |= {name: bound for name, bound in given.items() if bound is not None}
    return {**found, "passed": bool(passed)}
