"""What is wrong with a study is said before anything is computed: every fault at once, each with its line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from femdeform.errors import InputError
from verification.analytic import ANALYTIC
from verification.case import CASES, choose_cases, load_case, shipped_cases

Case = Callable[..., Path]


def faults_of(folder: Path) -> list[str]:
    with pytest.raises(InputError) as caught:
        load_case(folder)
    return [str(fault).replace(str(folder), "CASE") for fault in caught.value.faults]


def one_fault(folder: Path) -> str:
    (fault,) = faults_of(folder)
    return fault


def in_study(body: str) -> str:
    """A study with one line of its own, the fifth."""
    return f"""\
title: A trial
studies:
  trial:
    kind: value
    {body}
"""


@pytest.fixture(autouse=True)
def formula(monkeypatch: pytest.MonkeyPatch) -> None:
    """Formulas to refer to."""

    def half(scene: Any, stretch: float, mode: str = "plain") -> float:
        if stretch < 0.0:
            raise ValueError("a negative stretch")
        if scene.gravity is None and mode == "heavy":
            raise InputError("gravity: this formula needs it")
        return 0.5 * stretch

    monkeypatch.setitem(ANALYTIC, "half", half)


def test_faults_of_the_schema_come_all_at_once_with_their_lines(case: Case) -> None:
    study = """\
title: A trial
studies:
  first:
    kind: mesh_refinment
  second:
    kind: value
    quantities:
      middle: {atol: -1.0}
      energy: {}
      l2: {rate: [2.1, 1.9]}
      h1: {reference: {value: 1.0}, atol: 1.0}
  third: {kind: iteration_sweep, iterations: 0, variants: {}, quantities: {residul: {at_most: 1}}}
"""
    found = faults_of(case(study))
    for start, text in [
        ("CASE/study.yaml:4: studies.first.kind: ", "did you mean `mesh_refinement`?"),
        ("CASE/study.yaml:8: studies.second.quantities.middle.atol: ", "must be at least 0"),
        ("CASE/study.yaml:9: studies.second.quantities.energy: ", "needs a band"),
        ("CASE/study.yaml:10: studies.second.quantities.l2.rate: ", "lower bound comes first"),
        ("CASE/study.yaml:11: studies.second.quantities.h1.reference.source: ", "missing"),
        ("CASE/study.yaml:12: studies.third.iterations: ", "at least 1"),
        ("CASE/study.yaml:12: studies.third.variants: ", "must not be empty"),
        ("CASE/study.yaml:12: studies.third.quantities.residul: ", "did you mean `residual`?"),
    ]:
        assert any(fault.startswith(start) and text in fault for fault in found), (start, found)


def test_an_override_that_does_not_fit_the_scene_is_a_fault_of_its_line(case: Case) -> None:
    study = """\
title: A trial
studies:
  trial:
    kind: parameter_sweep
    set: {time.dtt: 1.0}
    each:
      plain: {set: {bodies.body.material.law: neo_hokean}}
    levels:
      - set: {bodies.body.element_order: 3}
      - set: {"conditions[4].on": body}
      - set: {bodies.body.mesh.cells: [4, 1.5]}
    quantities: {energy: {at_least: 0.0}}
"""
    found = faults_of(case(study))
    assert any(f.startswith('CASE/study.yaml:5: studies.trial.set."time.dtt": unknown key') for f in found)
    assert any(f.startswith("CASE/study.yaml:7: ") and "did you mean `neo_hookean`?" in f for f in found)
    assert any(f.startswith("CASE/study.yaml:9: ") and "element_order" in f for f in found)
    assert any(f.startswith("CASE/study.yaml:10: ") and "`conditions` has 1 entry" in f for f in found)
    # The scene has a line of its own for what was replaced.
    assert any(f.startswith("CASE/study.yaml:11: ") and "cells[1]: must be a whole number" in f for f in found)


def test_a_fault_of_the_scene_keeps_its_own_line(case: Case) -> None:
    folder = case(in_study("quantities: {middle: {at_most: 1.0}}"))
    scene = folder / "scene.yaml"
    scene.write_text(scene.read_text().replace("density", "densty").replace("boundary", "boundry"))
    found = faults_of(folder)
    assert any(f.startswith("CASE/scene.yaml:5: ") and "did you mean `density`?" in f for f in found), found


@pytest.mark.parametrize(
    ("body", "place", "text"),
    [
        ("scene: sceen.yaml", "5: studies.trial.scene", "did you mean `scene.yaml`?"),
        ("quantities: {midle: {at_most: 1.0}}", "5: studies.trial.quantities.midle", "did you mean `middle`?"),
        ("quantities: {l2: {at_most: 1.0}}", "5: studies.trial.quantities.l2", "needs fields.displacement"),
        ("quantities: {middle: {rtol: 1.0}}", "5: studies.trial.quantities.middle", "needs a `reference`"),
        ("quantities: {maxi(middle): {at_most: 1.0}}", '5: studies.trial.quantities."maxi(middle)"', "mean `max`?"),
        ("quantities: {middle: {report_only: true}}", "5: studies.trial.quantities", "nothing is judged"),
        (
            "quantities: {middle: {at_most: 1.0, window: [2.0, 3.0]}}",
            "5: studies.trial.quantities.middle.window",
            "after the end",
        ),
        (
            "quantities: {middle: {reference: {level: first}, atol: 1.0}}",
            "5: studies.trial.quantities.middle.reference.level",
            "no other level",
        ),
        (
            'quantities: {middle: {reference: {value: "2*b", source: here}, atol: 1.0}}',
            "5: studies.trial.quantities.middle.reference.value",
            "`b` is not known here",
        ),
        (
            "quantities: {middle: {reference: {analytic: haf, arguments: {stretch: 1}}, atol: 1.0}}",
            "5: studies.trial.quantities.middle.reference.analytic",
            "did you mean `half`?",
        ),
        (
            "quantities: {middle: {reference: {analytic: half, arguments: {strech: 1}}, atol: 1.0}}",
            "5: studies.trial.quantities.middle.reference.arguments.strech",
            "did you mean `stretch`?",
        ),
        (
            "quantities: {middle: {reference: {analytic: half}, atol: 1.0}}",
            "5: studies.trial.quantities.middle.reference",
            "needs the argument `stretch`",
        ),
        (
            "quantities: {middle: {reference: {analytic: half, arguments: {stretch: -1}}, atol: 1.0}}",
            "5: studies.trial.quantities.middle.reference.analytic",
            "no value here: a negative stretch",
        ),
        (
            "quantities: {middle: {reference: {analytic: half, arguments: {stretch: 1, mode: heavy}}, atol: 1.0}}",
            "5: studies.trial.quantities.middle.reference.analytic",
            "`half`: gravity: this formula needs it",
        ),
        (
            "quantities: {middle: {reference: {analytic: half, arguments: {stretch: {a: 1}}}, atol: 1.0}}",
            "5: studies.trial.quantities.middle.reference.arguments.stretch",
            "not a mapping",
        ),
    ],
)
def test_faults_that_need_the_scene(body: str, place: str, text: str, case: Case) -> None:
    with_quantities = body if "quantities" in body else f"{body}\n    quantities: {{middle: {{at_most: 1.0}}}}"
    found = one_fault(case(in_study(with_quantities)))
    assert found.startswith(f"CASE/study.yaml:{place}")
    assert text in found


@pytest.mark.parametrize(
    ("fields", "key", "text"),
    [
        ('{displacement: ["x", "0", "0"]}', "displacement", "has 3 components, the meshes have 2"),
        ('{displacement: ["x", "q*y"]}', "displacement[1]", "`q` is not known here"),
        ('{initial_velocity: ["x", "0"]}', "initial_velocity", "no velocities"),
        ("{body_force: manufactured}", "body_force", "needs `displacement`"),
        ('{move_mesh: ["x", "import"]}', "move_mesh[1]", "is not an expression"),
    ],
)
def test_fields_that_do_not_fit(fields: str, key: str, text: str, case: Case) -> None:
    found = one_fault(case(in_study(f"fields: {fields}\n    quantities: {{middle: {{at_most: 1.0}}}}")))
    assert found.startswith(f"CASE/study.yaml:5: studies.trial.fields.{key}: ")
    assert text in found


def test_a_constant_may_not_take_the_name_of_a_coordinate(case: Case) -> None:
    body = "constants: {x: 1.0, a: 2.0}\n    quantities: {middle: {at_most: 1.0}}"
    assert "studies.trial.constants.x: this name has a meaning" in one_fault(case(in_study(body)))


def test_the_trapezoidal_rule_needs_inertia(case: Case) -> None:
    body = "integrator: trapezoidal\n    quantities: {middle: {at_most: 1.0}}"
    assert "CASE/study.yaml:5: studies.trial.integrator: the trapezoidal rule needs" in one_fault(case(in_study(body)))


@pytest.mark.parametrize(
    ("quantities", "more", "text"),
    [
        ("{l2: {rate: [1, 3]}}", "    coarse: 1\n", "needs errors on two levels; of 1 computed, 1 have one"),
        ("{l2: {reference: {level: last}, rate: [1, 3]}}", "    coarse: 2\n", "of 2 computed, 1 have one"),
        ("{middle: {rate: [1, 3]}}", "", "needs a `reference`"),
        ("{l2: {reference: {value: 1.0, source: me}, atol: 1.0}}", "", "a norm is compared with"),
        ("{l2: {at_most: 1.0, window: [0.0, 1.0]}}", "", "taken at the end"),
        ("{l2: {at_most: 1.0, coarse: {}}}", "", "needs a band, in place"),
    ],
)
def test_bands_that_cannot_be_judged(
    quantities: str, more: str, text: str, case: Case, refinement: Callable[..., str]
) -> None:
    found = faults_of(case(refinement(quantities, more=more)))
    assert any(text in fault for fault in found), found


def test_sizes_have_to_decrease(case: Case, refinement: Callable[..., str]) -> None:
    study = refinement("{l2: {rate: [1, 3]}}").replace('"1/8"', '"1/2"')
    assert "levels[1]: sizes must decrease" in one_fault(case(study))


def test_iteration_sweeps_name_the_line_of_a_variant(case: Case) -> None:
    study = """\
title: A trial
studies:
  trial:
    kind: iteration_sweep
    iterations: 3
    steps: 7
    variants:
      good: {set: {solver.hessian: exact}}
      typo: {set: {solver.hesian: exact}}
      other: {set: {time.dt: 0.5}}
    quantities: {residual: {at_most: 1.0, rtol: 1.0}}
"""
    found = faults_of(case(study))
    assert any(f.startswith("CASE/study.yaml:9: ") and "did you mean `hessian`?" in f for f in found), found
    assert any(f.startswith("CASE/study.yaml:10: ") and "solver or linear_solver only" in f for f in found), found
    assert any(f.startswith("CASE/study.yaml:11: ") and "judged by between, at_most and at_least" in f for f in found)
    sound = "\n".join(line for line in study.splitlines() if "typo" not in line and "other" not in line)
    assert "go beyond the scene's end" in one_fault(case(sound.replace(", rtol: 1.0", "")))


def test_files_that_are_no_study(case: Case, tmp_path: Path) -> None:
    assert "is empty; a study" in one_fault(case(""))
    assert "study.yaml:2: is not valid YAML" in faults_of(case("title: [\n"))[0]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"has no study\.yaml"):
        choose_cases([str(tmp_path / "empty")])
    with pytest.raises(InputError, match="did you mean `manufactured`"):
        choose_cases(["manufacture"])


def test_a_case_is_named_or_a_folder_anywhere(case: Case, refinement: Callable[..., str], tmp_path: Path) -> None:
    folder = case(refinement("{l2: {rate: [1, 3]}}"))
    chosen = choose_cases(["patch", str(folder), str(folder / "study.yaml")])
    assert chosen == {"patch": CASES / "patch", "trial": folder}
    other = tmp_path / "elsewhere" / "trial"
    other.parent.mkdir()
    folder.rename(other)
    case(refinement("{l2: {rate: [1, 3]}}"))
    with pytest.raises(InputError, match="two cases are called `trial`"):
        choose_cases([str(folder), str(other)])


def test_levels_of_the_quick_run(case: Case, refinement: Callable[..., str]) -> None:
    more = """\
    coarse: 2
    each:
      plain: {}
      all: {coarse: 9}
      late: {full_only: true}
"""
    plan = load_case(case(refinement("{l2: {rate: [1, 3]}}", more=more)))
    assert {study.name: len(study.chosen(False)) for study in plan.studies} == {
        "p1/plain": 2,
        "p1/all": 3,
        "p1/late": 0,
    }
    assert [study.name for study in plan.chosen(False)] == ["p1/plain", "p1/all"]
    assert [len(study.chosen(True)) for study in plan.chosen(True)] == [3, 3, 3]
    assert (plan.n_runs(False), plan.n_runs(True)) == (5, 9)


@pytest.mark.parametrize("name", sorted(shipped_cases()))
def test_shipped_cases_have_no_faults_and_a_readme(name: str) -> None:
    plan = load_case(CASES / name)
    assert plan.chosen(full=False), "the coarse end is what every test run computes"
    assert plan.readme.startswith("# ")
