"""Studies run through the function that the command and the tests of all cases use; and it can fail."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from femdeform.errors import InputError
from verification.judgement import Row, Verdict
from verification.study import CaseResult, run_case

Case = Callable[..., Path]


@pytest.fixture(autouse=True, scope="module")
def threads_as_before() -> Iterator[None]:
    """Runs of few cells use one thread; what comes after these tests may not notice."""
    import numba

    from femdeform.jit import set_threads

    before = numba.get_num_threads()
    yield
    set_threads(before)


def rows_of(result: CaseResult, quantity: str, study: str = "") -> list[Row]:
    return [r for s in result.studies for r in s.rows if r.quantity == quantity and study in s.name]


def only(result: CaseResult) -> Verdict:
    (verdict,) = result.verdicts
    return verdict


# --------------------------------------------------------------------------------------------- mesh refinement


def test_rates_of_a_manufactured_solution(case: Case, refinement: Callable[..., str]) -> None:
    result = run_case(case(refinement("{l2: {rate: [1.8, 2.2]}, h1: {rate: [0.9, 1.1], decreasing: true}}")))
    assert result.passed
    assert [(v.quantity, v.judgement) for v in result.verdicts] == [
        ("l2", "rate"),
        ("h1", "rate"),
        ("h1", "decreasing"),
    ]
    rows = rows_of(result, "l2")
    assert [row.n_dofs for row in rows] == [2 * 25, 2 * 81, 2 * 289]
    assert math.isnan(rows[0].rate)
    assert rows[2].rate == pytest.approx(math.log2(rows[1].error / rows[2].error))
    assert rows[2].rate == result.verdicts[0].computed
    assert all(row.iterations > 0 and row.seconds > 0.0 for row in rows)


def test_free_sides_get_the_traction_of_the_solution(case: Case, refinement: Callable[..., str]) -> None:
    """Without it the solution would be another one, and the error would not fall."""
    study = refinement("{l2: {rate: [1.7, 2.3]}}", more='    set: {"conditions[0].on": body.left}\n')
    result = run_case(case(study))
    assert result.passed, result.verdicts


def test_quadratic_elements_with_free_sides(case: Case, refinement: Callable[..., str]) -> None:
    more = '    set: {"conditions[0].on": body.left, bodies.body.element_order: 2}\n'
    result = run_case(case(refinement("{l2: {rate: [2.7, 3.3]}, h1: {rate: [1.8, 2.2]}}", more=more)))
    assert result.passed, result.verdicts


def test_a_moved_mesh_keeps_the_rates_and_changes_the_errors(case: Case, refinement: Callable[..., str]) -> None:
    study = refinement("{l2: {rate: [1.8, 2.2]}}")
    moved = study.replace(
        "body_force: manufactured}",
        'body_force: manufactured, move_mesh: ["0.08*sin(pi*x)*sin(pi*y)", "-0.06*sin(pi*x)*sin(pi*y)"]}',
    )
    straight, bent = run_case(case(study)), run_case(case(moved, name="moved"))
    assert bent.passed
    assert rows_of(bent, "l2")[2].error != pytest.approx(rows_of(straight, "l2")[2].error, rel=0.01)


def test_a_mesh_moved_inside_out_is_bad_input_at_its_line(case: Case, refinement: Callable[..., str]) -> None:
    study = refinement("{l2: {rate: [1, 3]}}").replace("manufactured}", 'manufactured, move_mesh: ["-2*x", "0"]}')
    with pytest.raises(InputError, match=r"study\.yaml:6: studies\.p1\.fields\.move_mesh: "):
        run_case(case(study))


def test_a_field_that_is_not_finite_is_bad_input_at_its_line(case: Case, refinement: Callable[..., str]) -> None:
    with pytest.raises(InputError, match=r"study\.yaml:6: studies\.p1\.fields\.displacement: is not finite"):
        run_case(case(refinement("{l2: {rate: [1, 3]}}", exact="0.01/x")))


def test_order_without_an_exact_solution(case: Case, refinement: Callable[..., str]) -> None:
    """Differences of neighbours fall with the order of the method."""
    study = refinement("{energy: {reference: {level: previous}, rate: [1.6, 2.4]}, l2: {report_only: true}}")
    finer = study.replace("[16, 16]", "[32, 32]").replace("[8, 8]", "[16, 16]").replace("[4, 4]", "[8, 8]")
    result = run_case(case(finer))
    assert only(result).passed
    energy = rows_of(result, "energy")
    assert energy[0].is_reference and math.isnan(energy[0].error)  # noqa: PT018
    assert energy[2].error == abs(energy[2].computed - energy[1].computed)


def test_a_finer_run_as_reference(case: Case, refinement: Callable[..., str]) -> None:
    finer = "{reference: {run: {set: {bodies.body.mesh.cells: [32, 32]}}}, rate: [1.7, 2.5], decreasing: true}"
    result = run_case(case(refinement(f"{{energy: {finer}}}")))
    assert result.passed
    assert len({row.reference for row in rows_of(result, "energy")}) == 1


def test_fields_on_different_meshes_cannot_be_compared(case: Case, refinement: Callable[..., str]) -> None:
    result = run_case(case(refinement("{l2: {reference: {level: last}, atol: 1.0}}")))
    assert not result.passed
    assert "different meshes" in only(result).reason


def test_bands_of_the_quick_run(case: Case, refinement: Callable[..., str]) -> None:
    quantities = "{l2: {at_most: 1.0e-9, coarse: {rate: [1.7, 2.3], at_most: 1.0}}}"
    folder = case(refinement(quantities, more="    coarse: 2\n"))
    quick, full = run_case(folder), run_case(folder, full=True)
    assert quick.passed and len(rows_of(quick, "l2")) == 2  # noqa: PT018
    assert not full.passed and len(rows_of(full, "l2")) == 3  # noqa: PT018


# ----------------------------------------------------------------------------------- the machinery can fail


def test_a_band_that_the_rate_does_not_reach(case: Case, refinement: Callable[..., str]) -> None:
    verdict = only(run_case(case(refinement("{l2: {rate: [2.5, 3.5]}}"))))
    assert not verdict.passed
    assert "not 2.5 to 3.5" in verdict.reason


def test_a_wrong_exact_field_lets_no_error_fall(case: Case, refinement: Callable[..., str]) -> None:
    """The right solution at the boundary, another one in the inside, and no force that belongs to either."""
    study = refinement("{l2: {rate: [1.8, 2.2]}, h1: {decreasing: true}}").replace(", body_force: manufactured", "")
    result = run_case(case(study))
    assert [verdict.passed for verdict in result.verdicts] == [False, False]
    assert result.verdicts[0].computed < 1.0


@pytest.mark.parametrize(("value", "passes"), [("energy", True), ("1.1*energy", False)])
def test_a_wrong_reference(value: str, passes: bool, case: Case, refinement: Callable[..., str]) -> None:
    right = rows_of(run_case(case(refinement("{energy: {at_least: 0.0}}"))), "energy")[-1].computed
    study = refinement(f'{{energy: {{reference: {{value: "{value}", source: a test}}, rtol: 0.05}}}}')
    result = run_case(case(study.replace("{a: 0.05}", f"{{a: 0.05, energy: {right}}}")))
    assert result.passed is passes
    assert only(result).judgement == "tolerance"
    assert only(result).high == pytest.approx(0.05 * right * (1.0 if passes else 1.1))


def test_scale_is_what_the_relative_tolerance_is_a_part_of(case: Case, refinement: Callable[..., str]) -> None:
    spec = "{reference: {value: 0.0, source: a test}, rtol: 0.5, atol: 0.25, scale: 3.0}"
    assert only(run_case(case(refinement(f"{{energy: {spec}}}")))).high == 0.25 + 0.5 * 3.0


def test_a_run_that_does_not_converge_fails_its_study_and_no_other(case: Case, refinement: Callable[..., str]) -> None:
    more = """\
    each:
      stuck: {set: {solver.max_iterations: 1, on_failure.action: stop}}
      sound: {}
"""
    result = run_case(case(refinement("{l2: {rate: [1.8, 2.2]}, energy: {at_most: 1.0}}", more=more)))
    stuck, sound = result.studies
    assert sound.passed
    assert [(v.judgement, v.passed) for v in stuck.verdicts] == [("run", False), ("run", False)]
    assert all("step 1" in verdict.reason for verdict in stuck.verdicts)
    assert len(rows_of(result, "l2", "stuck")) == 1, "the finer levels could be judged by nothing"


def test_a_sweep_goes_on_after_a_level_that_does_not_converge(case: Case) -> None:
    study = """\
title: A sweep
studies:
  sweep:
    kind: parameter_sweep
    fields: {displacement: ["0.2*x*y", "0"]}
    levels:
      - {label: stuck, set: {solver.max_iterations: 1, on_failure.action: stop}}
      - {label: sound}
    quantities: {energy: {between: [0.0, 1.0]}}
"""
    result = run_case(case(study))
    assert [(v.level, v.passed) for v in result.verdicts] == [("stuck", False), ("sound", True)]
    assert "step 1" in result.verdicts[0].reason


def test_a_halved_step_is_noted(case: Case) -> None:
    study = """\
title: A value
studies:
  value:
    kind: value
    fields: {displacement: ["0.2*x*y", "0"]}
    set: {solver.max_iterations: 3}
    quantities: {energy: {at_least: 0.0}}
"""
    (row,) = rows_of(run_case(case(study)), "energy")
    assert "had to be halved" in row.note


# ------------------------------------------------------------------------------------- sweeps, values and time


def test_every_level_of_a_sweep_is_judged_with_its_own_reference(case: Case) -> None:
    """Homogeneous stretch: the displacement in the middle is linear in the stretch."""
    study = """\
title: A sweep
studies:
  sweep:
    kind: parameter_sweep
    parameter: stretch
    constants: {a: 0.1}
    fields: {displacement: ["a*x", "0"]}
    levels:
      - {value: 1.0, set: {bodies.body.material.law: linear}, references: {middle: {value: "0.4*a", source: exact}}}
      - {value: 2.0, references: {middle: {value: "0.4*a + 1", source: wrong}}}
      - {value: 3.0}
    quantities:
      middle: {reference: {value: "a*0.4", source: exact}, atol: 1.0e-12}
      l2: {atol: 1.0e-12}
"""
    result = run_case(case(study))
    middle = [v for v in result.verdicts if v.quantity == "middle"]
    assert [(v.level, v.passed) for v in middle] == [("1", True), ("2", False), ("3", True)]
    assert middle[1].computed == pytest.approx(1.0)
    assert all(v.passed for v in result.verdicts if v.quantity == "l2")
    assert [row.size for row in rows_of(result, "l2")] == [1.0, 2.0, 3.0]


def test_levels_of_a_sweep_against_the_first(case: Case) -> None:
    study = """\
title: A sweep
studies:
  sweep:
    kind: parameter_sweep
    fields: {displacement: ["0.1*x*y", "0"]}
    levels:
      - {set: {time.dt: 1.0}}
      - {set: {time.dt: 0.5}}
      - {set: {bodies.body.material.youngs_modulus: 3.0}}
    quantities: {energy: {reference: {level: first}, rtol: 1.0e-8}}
"""
    result = run_case(case(study))
    assert [(v.level, v.passed) for v in result.verdicts] == [("0.5", True), ("3", False)]


SWING = """\
title: Order in time
studies:
  swing:
    kind: time_step_refinement
    integrator: {integrator}
    steps: [0.02, 0.01, 0.005]
    quantities:
      tip: {{reference: {{run: {{set: {{time.dt: 0.00125}}, integrator: trapezoidal}}}}, rate: {rate}}}
      l2: {{reference: {{run: {{set: {{time.dt: 0.00125}}, integrator: trapezoidal}}}}, rate: {rate}}}
      min(tip): {{report_only: true}}
"""


@pytest.mark.parametrize(("integrator", "rate"), [("backward_euler", "[0.7, 1.3]"), ("trapezoidal", "[1.7, 2.4]")])
def test_order_in_time(integrator: str, rate: str, case: Case, bar: str) -> None:
    result = run_case(case(SWING.format(integrator=integrator, rate=rate), bar))
    assert result.passed, result.verdicts
    assert [row.size for row in rows_of(result, "tip")] == [0.02, 0.01, 0.005]
    assert len({row.reference for row in rows_of(result, "tip")}) == 1
    tip, lowest = rows_of(result, "tip")[-1].computed, rows_of(result, "min(tip)")[-1].computed
    assert lowest <= tip < 0.0


def test_a_run_from_an_initial_velocity_and_its_course(case: Case, bar: str) -> None:
    """Without loads and supports the bar flies straight on; held at one end, that end stays."""
    free = bar.replace("  - {kind: fixed, on: bar.left}\n", "").replace("conditions:\n", "").replace("-9.81", "0.0")
    study = """\
title: Flight
studies:
  flight:
    kind: value
    constants: {v: 2.0}
    fields: {initial_velocity: ["0", "v"]}
    quantities:
      tip: {reference: {value: "0.1*v", source: v t}, rtol: 1.0e-9}
      mean(tip): {reference: {value: "0.05*v", source: half of it}, rtol: 1.0e-9}
      max(tip): {reference: {value: "0.04*v", source: at the end of the window}, rtol: 1.0e-9, window: [0.02, 0.04]}
      time_of_max(tip): {reference: {value: 0.1, source: the end}, rtol: 1.0e-9}
      frequency(tip): {at_least: 0.0}
"""
    result = run_case(case(study, free))
    assert [v.passed for v in result.verdicts] == [True, True, True, True, False]
    assert "no whole period" in result.verdicts[-1].reason
    (course,) = result.studies[0].courses
    assert course.measure == "tip"
    assert course.times == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08, 0.1])
    assert course.values == pytest.approx(2.0 * course.times, abs=1e-9)
    held = run_case(case(study, bar, name="held"))
    assert not held.passed


def test_an_iteration_sweep(case: Case) -> None:
    study = """\
title: Newton
studies:
  newton:
    kind: iteration_sweep
    set: {conditions: [{kind: fixed, on: body.left}, {kind: translate, on: body.right, velocity: [0.3, 0.1]}]}
    iterations: 6
    variants:
      adaptive: {}
      projected: {set: {solver.hessian: projected}}
      strict: {quantities: {residual: {at_most: 1.0e-30}}}
    quantities:
      residual: {at_most: 1.0e-4}
      distance: {at_most: 1.0e-3}
      contraction: {between: [0.0, 0.5]}
"""
    result = run_case(case(study))
    failed = [(v.level, v.quantity) for v in result.verdicts if not v.passed]
    assert failed == [("strict", "residual")]
    assert len(result.verdicts) == 9
    table = [row for row in result.studies[0].iterations if row["variant"] == "adaptive"]
    residuals = [row["relative_residual"] for row in table]
    (residual,) = (row for row in rows_of(result, "residual") if row.level == "adaptive")
    (contraction,) = (row for row in rows_of(result, "contraction") if row.level == "adaptive")
    assert residual.computed == residuals[-1]
    first = len(residuals) // 2
    steps = len(residuals) - 1 - first
    assert contraction.computed == pytest.approx((residuals[-1] / residuals[first]) ** (1.0 / steps))
    assert residual.iterations == len(residuals) - 1 <= 6
