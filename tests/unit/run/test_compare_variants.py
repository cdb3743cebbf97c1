"""From the command line to variants, and every way in which they can be wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from compared import write_bar

from femdeform.errors import InputError
from femdeform.run.compare_variants import Variant, file_names, parse_variants, prepare


def faults_of(error: pytest.ExceptionInfo[InputError]) -> list[str]:
    return [str(fault) for fault in error.value.faults]


def test_methods_and_option_sets() -> None:
    option_sets = ["exact: solver.hessian=exact", "a b:  solver.tolerance=1e-3 linear_solver.preset='newton-gamg'"]
    variants = parse_variants("projected_newton", option_sets)
    assert variants == [
        Variant("projected_newton", (), "projected_newton"),
        Variant("exact", ("solver.hessian=exact",)),
        Variant("a b", ("solver.tolerance=1e-3", "linear_solver.preset=newton-gamg")),
    ]


def test_quotes_hold_a_value_together() -> None:
    (variant,) = parse_variants(None, ["x: 'linear_solver={method: ksp, preset: newton-icc}' solver.hessian=exact"])
    assert variant.overrides == ("linear_solver={method: ksp, preset: newton-icc}", "solver.hessian=exact")


def test_faults_of_the_arguments_come_together() -> None:
    with pytest.raises(InputError) as error:
        parse_variants("projected_newtn,,xyz", ["no colon", "a.b=1: x", ": solver.hessian=exact", "e:", "q: 'open"])
    faults = faults_of(error)
    assert faults[0] == "--methods: there is no method `projected_newtn`; did you mean `projected_newton`?"
    assert faults[1] == "--methods: must be names of methods with commas between them"
    assert faults[2].startswith("--methods: there is no method `xyz`; ")
    example = '--variant "exact: solver.hessian=exact"'
    assert faults[3:] == [
        f"--variant no colon: must be LABEL: key=value key=value, for example {example}",
        f"--variant a.b=1: x: must be LABEL: key=value key=value, for example {example}",
        f"--variant : solver.hessian=exact: must be LABEL: key=value key=value, for example {example}",
        f"--variant e:: has no options, for example {example}",
        "--variant q: 'open: the options cannot be split (No closing quotation); quotes come in pairs",
    ]


def test_a_method_keeps_the_options_of_the_scene_that_uses_it(tmp_path: Path) -> None:
    path = write_bar(tmp_path, solver={"method": "projected_newton", "tolerance": 1e-5})
    prepared = prepare(path, parse_variants("projected_newton", ["exact: solver.hessian=exact"]))
    assert prepared.scenes["projected_newton"].scene.solver.tolerance == 1e-5
    assert prepared.scenes["exact"].scene.solver.tolerance == 1e-5
    assert prepared.scenes["exact"].scene.solver.hessian == "exact"
    assert prepared.base.scene.solver.hessian == "adaptive"


def test_overrides_of_the_scene_hold_for_all(tmp_path: Path) -> None:
    variants = [Variant("a"), Variant("b", ("solver.tolerance=1e-3",))]
    prepared = prepare(write_bar(tmp_path), variants, ["time.dt=0.5", "solver.tolerance=1e-4"])
    assert [prepared.scenes[label].scene.time.dt for label in "ab"] == [0.5, 0.5]
    assert [prepared.scenes[label].scene.solver.tolerance for label in "ab"] == [1e-4, 1e-3]


@pytest.mark.parametrize(
    ("overrides", "fault"),
    [
        (("solver.hessien=exact",), "--variant v: solver.hessien: unknown key; did you mean `hessian`?"),
        (("solver.tolerance",), "--variant v: solver.tolerance: must be key=value, for example time.dt=0.01"),
        (("solver.tolerance=2",), "--variant v: solver.tolerance: must be less than 1, not 2"),
        (("linear_solver={method: ksp, preset: nwton-gamg}",), "did you mean `newton-gamg`?"),
        (("time.dt=0.1",), "--variant v: time: a variant changes solver or linear_solver only"),
        (("bodies.b.material.density=1",), "--variant v: bodies: a variant changes solver or linear_solver only"),
        (("solver.method=magic",), "--variant v: solver.method: "),
    ],
)
def test_faults_of_a_variant_name_it(tmp_path: Path, overrides: tuple[str, ...], fault: str) -> None:
    with pytest.raises(InputError) as error:
        prepare(write_bar(tmp_path), [Variant("fine"), Variant("v", overrides)])
    assert any(fault in text for text in faults_of(error)), faults_of(error)
    assert all(text.startswith("--variant v: ") for text in faults_of(error))
    assert all("\n" not in text for text in faults_of(error))


def test_faults_of_all_variants_come_together(tmp_path: Path) -> None:
    wrong = [Variant("a", ("solver.x=1",)), Variant("b", ("time.dt=1",)), Variant("c", ("solver.tolerance=-1",))]
    with pytest.raises(InputError) as error:
        prepare(write_bar(tmp_path), wrong)
    assert [text.split(":")[0] for text in faults_of(error)] == ["--variant a", "--variant b", "--variant c"]


def test_faults_of_the_scene_keep_their_place(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(write_bar(tmp_path).read_text().replace('"b.left"', '"b.lefft"'))
    with pytest.raises(InputError, match=r"s\.yaml:\d+: conditions\[0\]\.on: .*did you mean `left`") as error:
        prepare(path, [Variant("a"), Variant("b")])
    assert len(error.value.faults) == 1
    with pytest.raises(InputError, match=r"--set time\.dt=-1: time\.dt"):
        prepare(write_bar(tmp_path), [Variant("a")], ["time.dt=-1"])


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ([], "there is nothing to compare: give --methods or --variant"),
        (["a", "b", "a"], "--variant a: there are two variants of this name; give them different labels"),
        (["reference"], "this name is kept for the converged reference"),
        (["x" * 41], "a label has at most 40 characters, on one line"),
        (["a\nb"], "a label has at most 40 characters, on one line"),
    ],
)
def test_labels(tmp_path: Path, labels: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        prepare(write_bar(tmp_path), [Variant(label) for label in labels])


def test_every_label_has_a_file_of_its_own() -> None:
    labels = ["exact", "Exact", "a/b", "a b", "../../etc", "ä", "Reference", ".."]
    names = file_names(labels)
    assert list(names) == labels
    assert len({name.lower() for name in names.values()} | {"reference"}) == len(labels) + 1
    assert names["exact"] == "exact"
    assert all(Path(name).name == name and not name.startswith(".") for name in names.values())
