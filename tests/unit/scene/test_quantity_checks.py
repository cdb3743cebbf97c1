"""Faults of `measure:` and `expect:`, at their line and in plain words."""

from __future__ import annotations

from pathlib import Path

import pytest

from femdeform.scene.checks import check_file

TEXT = """\
simulation: deformable
bodies:
  beam:
    mesh: {recipe: block, size: [1.0, 0.2, 0.2], cells: [5, 1, 1]}
    material: {law: neo_hookean, density: 1.0, youngs_modulus: 1.0, poisson_ratio: 0.3}
time: {scheme: quasistatic, dt: 1.0}
"""


def faults(tmp_path: Path, block: str) -> list[str]:
    path = tmp_path / "scene.yaml"
    path.write_text(TEXT + block + "\n")
    return [f"{fault.line}: {fault.key}: {fault.message}" for fault in check_file(path)]


@pytest.mark.parametrize(
    ("block", "fault"),
    [
        ("measure: {a: {kind: displacement, component: x}}", "measure.a: needs one of `on` (nodes) and `at` (a point)"),
        (
            "measure: {a: {kind: displacement, on: beam, at: [0, 0, 0], component: x}}",
            "measure.a: needs one of `on` (nodes) and `at` (a point)",
        ),
        ("measure: {a: {kind: displacement, at: [0, 0], component: x}}", "measure.a.at: needs 3 entries in a 3D"),
        ("measure: {a: {kind: displacement, at: [0, 0, 2], component: x}}", "measure.a.at: the point lies in no cell"),
        ("measure: {a: {kind: reaction, on: beam.lft, component: x}}", "measure.a.on: body `beam` has no group `lft`"),
        ("measure: {a: {kind: moment, on: beam.left}}", "measure.a.axis: missing; a moment in 3D needs its axis"),
        ("measure: {a: {kind: min_jacobian, body: bem}}", "measure.a.body: there is no body `bem`"),
        ("measure: {a: {kind: max_stress}}", 'measure.a.kind: "max_stress" is not a known kind'),
        ("measure: {1a: {kind: total_energy}}", 'measure."1a": the name "1a" must start with a letter'),
        ("expect: {measured: {tip: {value: 1, rtol: 1}}}", "expect.measured.tip: the scene measures no `tip`"),
        (
            "measure: {tip: {kind: total_energy}}\nexpect: {time_to_reach: [{quantity: tp, level: 1, at_most: 1}]}",
            "expect.time_to_reach[0].quantity: the scene measures no `tp`; did you mean `tip`?",
        ),
        ("expect: {residual: {rtol: 0.1}}", "expect.residual: needs `value`, `at_least` or `at_most`"),
        ("expect: {residual: {at_most: 1, rtol: 0.1}}", "expect.residual: rtol and atol belong to `value`"),
        ("expect: {residual: {at_least: 2, at_most: 1}}", "expect.residual.at_most: must not be below at_least"),
        ("expect: {residual: {value: 1, rtol: 1, at_most: 1}}", "expect.residual.value: cannot be combined"),
        ("expect: {reaction: [{on: beam.left, component: w, at_least: 0}]}", "expect.reaction[0].component: must be"),
    ],
)
def test_fault(block: str, fault: str, tmp_path: Path) -> None:
    found = faults(tmp_path, block)
    line = 7 + block.count("\n")
    assert len(found) == 1, found
    assert found[0].startswith(f"{line}: {fault}"), found


def test_in_two_dimensions(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    flat = TEXT.replace("[1.0, 0.2, 0.2]", "[1.0, 0.2]").replace("[5, 1, 1]", "[5, 1]")
    path.write_text(
        flat
        + "measure:\n"
        + "  a: {kind: displacement, on: beam, component: z}\n"
        + "  b: {kind: angular_momentum, component: x}\n"
        + "  c: {kind: angular_momentum, component: z}\n"
        + "  d: {kind: moment, on: beam, axis: [0, 0, 1]}\n"
    )
    assert [(fault.line, fault.key) for fault in check_file(path)] == [
        (8, "measure.a.component"),
        (9, "measure.b.component"),
        (11, "measure.d.axis"),
    ]
