"""What the pages say is so: their YAML passes the schemas, their commands parse, their code runs."""

from __future__ import annotations

import argparse
import importlib.util
import re
import shlex
import sys
import textwrap
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from pydantic import TypeAdapter
from ruamel.yaml import YAML
from scenario import block, body, build, material, quasistatic, scene

from femdeform.cli import build_parser
from femdeform.materials import dispatch, lame_parameters
from femdeform.run.setup import Simulation
from femdeform.scene import batch_schema, mesh_schema, schema
from femdeform.scene.comparison_schema import ComparisonFile
from femdeform.scene.flow_schema import FlowScene
from femdeform.scene.kinds import Scene
from femdeform.scene.validation import find_faults
from femdeform.step_problem import Budget, StepResult
from verification.study_schema import StudyFile

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
PAGES = [REPOSITORY / "README.md", *sorted(DOCS.rglob("*.md"))]


class Fence(NamedTuple):
    """A fenced block of a page."""

    page: str
    line: int
    language: str
    title: str
    text: str


def fences() -> Iterator[Fence]:
    for path in PAGES:
        text = path.read_text(encoding="utf-8")
        for found in re.finditer(r'^```(\w*)(?: title="([^"]*)")?\n(.*?)^```$', text, re.DOTALL | re.MULTILINE):
            line = text.count("\n", 0, found.start()) + 1
            yield Fence(str(path.relative_to(REPOSITORY)), line, found[1], found[2] or "", found[3])


FENCES = list(fences())


def where(fence: Any) -> str:
    return f"{fence.page}:{fence.line}"


def of_page(page: str, language: str) -> dict[str, str]:
    """Fenced blocks of a page by their title, the file they stand for."""
    return {
        fence.title: fence.text
        for fence in FENCES
        if fence.page == f"docs/{page}" and fence.language == language and fence.title
    }


# ------------------------------------------------------------------------------------------------------ YAML

# Completes a part of a scene.
SOME_SCENE = {
    "simulation": "deformable",
    "bodies": {"beam": {"mesh": {"recipe": "block"}, "material": material()}},
    "time": {"scheme": "quasistatic", "dt": 0.1},
}

SOME_FLOW = {
    "simulation": "incompressible_flow",
    "grid": {"cells": [32, 32], "cell_size": 0.03},
    "time": {"dt": 0.02, "end": 1.0},
}


@pytest.mark.parametrize("fence", [fence for fence in FENCES if fence.language == "yaml"], ids=where)
def test_yaml_passes_its_schema(fence: Fence) -> None:
    data = YAML(typ="safe", pure=True).load(fence.text)
    if not isinstance(data, dict):
        return  # entries of a list: that they are YAML is all that can be said
    if "studies" in data:
        model, whole = StudyFile, data
    elif "variants" in data:
        model, whole = ComparisonFile, data
    elif "sweep" in data or "scalars" in data:
        model, whole = batch_schema.Study, {"scene": "scene.yaml", "sweep": {"grid": {"time.dt": [0.1]}}, **data}
    elif "simulation" in data:
        model, whole = Scene, data
    elif "boundaries" in data:
        model, whole = FlowScene, {**SOME_FLOW, **data}
    elif set(data) <= set(schema.DeformableScene.model_fields):
        model, whole = schema.DeformableScene, {**SOME_SCENE, **data}
    else:
        return  # a part of a block: that it is YAML is all that can be said
    assert [f"{found.path}: {found.message}" for found in find_faults(model, whole)] == []


def test_pages_show_whole_scenes() -> None:
    assert sum(fence.language == "yaml" and "\nsimulation:" in f"\n{fence.text}" for fence in FENCES) >= 3


# --------------------------------------------------------------------------------------------------- commands


class Command(NamedTuple):
    """A command line of a page."""

    page: str
    line: int
    text: str


def commands() -> Iterator[Command]:
    for fence in FENCES:
        if fence.language not in ("", "text", "sh", "console", "bash"):
            continue
        for number, line in enumerate(fence.text.replace("\\\n", " ").splitlines(), fence.line + 1):
            for part in line.partition("  #")[0].split("&&"):
                if re.match(r"\s*(\$ )?(mpiexec -n \S+ )?femdeform ", part):
                    yield Command(fence.page, number, part.strip().removeprefix("$ "))
    for path in PAGES:
        outside = re.sub(r"^```.*?^```$", lambda found: "\n" * found[0].count("\n"), path.read_text(encoding="utf-8"),
                         flags=re.DOTALL | re.MULTILINE)  # fmt: skip
        for found in re.finditer(r"`((?:mpiexec -n \S+ )?femdeform [^`]+)`", outside):
            line = outside.count("\n", 0, found.start()) + 1
            yield Command(str(path.relative_to(REPOSITORY)), line, " ".join(found[1].split()))


@pytest.fixture(scope="module")
def parser() -> argparse.ArgumentParser:
    return build_parser()


def subcommands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    (action,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(action.choices)


@pytest.mark.parametrize("command", list(commands()), ids=where)
def test_commands_parse(command: Command, parser: argparse.ArgumentParser, capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(re.sub(r"^mpiexec -n \S+ ", "", command.text).partition(" > ")[0].partition(" | ")[0])[1:]
    if len(words) == 1 and words[0] in subcommands(parser):
        return  # the name of a command in the text
    words = ["1" if re.fullmatch(r"[A-Z]", word) else word for word in words if word != "..."]
    code: Any = 0
    try:
        parser.parse_args(words)
    except SystemExit as stop:  # --help and --version leave as well, with 0
        code = stop.code or 0
    assert code == 0, capsys.readouterr().err


def test_the_readme_has_every_command(parser: argparse.ArgumentParser) -> None:
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    for name in subcommands(parser):
        if name not in ("schema", "info"):
            assert f"femdeform {name}" in text


def test_targets_of_make_exist() -> None:
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    for path in PAGES:
        for target in re.findall(r"(?:^|`)make ([a-z-]+)", path.read_text(encoding="utf-8"), re.MULTILINE):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"{path}: make {target}"


# ------------------------------------------------------------------------------------------- generated pages


@pytest.fixture(scope="module")
def generated() -> dict[str, str]:
    pytest.importorskip("mkdocs")
    spec = importlib.util.spec_from_file_location("docs_hooks", DOCS / "hooks.py")
    assert spec is not None
    assert spec.loader is not None
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    pages: dict[str, str] = hooks.generated_pages()
    return pages


def test_every_option_is_in_the_reference(generated: dict[str, str], parser: argparse.ArgumentParser) -> None:
    text = generated["reference/commands.md"]
    for name, command in subcommands(parser).items():
        section = text.partition(f"## `femdeform {name}`\n")[2].partition("\n## ")[0]
        assert section, name
        actions = [action for action in command._actions if action.dest != "help"]
        assert actions or name == "info"
        for action in actions:
            assert all(option in section for option in action.option_strings)
            assert (action.help or "nothing is said about it").replace("<", "&lt;") in section
        for line in (command.epilog or "").splitlines():
            assert line.strip().lower() in section.lower()


def test_every_preset_is_in_the_reference(generated: dict[str, str]) -> None:
    for path in (REPOSITORY / "solvers" / "presets").glob("*.yaml"):
        section = generated["reference/presets.md"].partition(f"## {path.stem}\n")[2].partition("\n## ")[0]
        assert section
        as_written = re.sub(r"\[([\w/-]+)\]\(\.\./\1\.md\)", r"docs/\1.md", section)  # mentions of pages became links
        for line in path.read_text(encoding="utf-8").splitlines():
            assert line.removeprefix("#").strip() in as_written
        code = re.findall(r"```yaml\n(.*?)```", section, re.DOTALL)[0]
        assert YAML(typ="safe", pure=True).load(code) == YAML(typ="safe", pure=True).load(path)


def test_every_module_is_on_the_map(generated: dict[str, str]) -> None:
    text = generated["reference/code.md"]
    for package in ("femdeform", "solvers", "meshes", "verification"):
        for path in (REPOSITORY / package).rglob("*.py"):
            if path.name != "__init__.py":
                section = text.partition(f"## {path.parent.relative_to(REPOSITORY)}\n")[2].partition("\n## ")[0]
                assert f"| `{path.stem}` |" in section, path


def test_every_readme_of_a_case_is_a_page(generated: dict[str, str]) -> None:
    for path in (REPOSITORY / "verification" / "cases").glob("*/README.md"):
        title = path.read_text(encoding="utf-8").splitlines()[0]
        assert generated[f"cases/{path.parent.name}.md"].startswith(title)


def test_pictures_are_there() -> None:
    for path in PAGES:
        for link in re.findall(r"!\[[^\]]+\]\(([^)]+)\)", path.read_text(encoding="utf-8")):
            assert (path.parent / link).is_file(), f"{path}: {link}"


# ---------------------------------------------------------------------------------------- code of the pages


def executed(source: str, name: str, namespace: dict[str, Any] | None = None) -> dict[str, Any]:
    """Names that a module has whose source this is, after other names that it has already."""
    module = types.ModuleType(name)
    vars(module).update({key: value for key, value in (namespace or {}).items() if not key.startswith("__")})
    code = compile(source, f"<{name}>", "exec", flags=annotations.compiler_flag, dont_inherit=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, name, module)  # where models look up the names in their annotations
        exec(code, vars(module))
    return vars(module)


def central_difference(function: Callable[[np.ndarray], Any], x: np.ndarray, step: float = 1e-6) -> np.ndarray:
    columns = []
    for i in range(len(x)):
        e = np.zeros_like(x)
        e[i] = step
        columns.append((np.asarray(function(x + e)) - np.asarray(function(x - e))) / (2.0 * step))
    return np.stack(columns, axis=-1)


@pytest.fixture(scope="module")
def new_law() -> Any:
    """The law of the page, compiled without leaving anything in the kernel cache."""
    import numba

    from femdeform import jit

    def njit(function: Any = None, /, *, fastmath: frozenset[str] = jit.FASTMATH) -> Any:
        decorate = numba.njit(error_model="numpy", fastmath=set(fastmath))
        return decorate if function is None else decorate(function)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jit, "njit", njit)
        source = of_page("developer/add-a-material.md", "python")["femdeform/materials/ciarlet.py"]
        return executed(source, "ciarlet")["Ciarlet"]


@pytest.mark.slow
@pytest.mark.parametrize("dim", [2, 3])
def test_the_material_of_the_page_is_a_law(new_law: Any, dim: int) -> None:
    mu, lmbda = lame_parameters(1.0, 0.3)
    law = new_law.from_lame(mu, lmbda, dim)
    n = dim * dim

    def energy(F: np.ndarray) -> float:
        return dispatch.energy_density(tuple(F), law)

    def stress(F: np.ndarray) -> tuple[float, ...]:
        return dispatch.pk1(tuple(F), law)

    def tangent(F: np.ndarray, project: bool) -> np.ndarray:
        H = np.empty((n, n))
        dispatch.tangent(tuple(F), law, project, H)
        return H

    rest = np.eye(dim).ravel()
    assert energy(rest) == 0.0
    np.testing.assert_allclose(stress(rest), 0.0, atol=1e-15)
    d = np.eye(dim)
    linear = mu * (np.einsum("ac,bd->abcd", d, d) + np.einsum("ad,bc->abcd", d, d)) + lmbda * np.einsum(
        "ab,cd->abcd", d, d
    )
    np.testing.assert_allclose(tangent(rest, False), linear.reshape(n, n), atol=1e-14)
    rng = np.random.default_rng(5)
    clamped = 0
    for F in rest + 0.3 * rng.standard_normal((12, n)):
        if np.linalg.det(F.reshape(dim, dim)) < 0.1:
            continue
        np.testing.assert_allclose(stress(F), central_difference(energy, F), atol=1e-6)
        H = tangent(F, False)
        np.testing.assert_allclose(H, central_difference(stress, F), atol=1e-5 * np.abs(H).max())
        values, vectors = np.linalg.eigh(H)
        positive = (vectors * np.maximum(values, 0.0)) @ vectors.T
        np.testing.assert_allclose(tangent(F, True), positive, atol=1e-9 * np.abs(H).max())
        clamped += values[0] < 0.0
    assert clamped > 0, "no state whose tangent had to be projected"
    assert energy(-rest if dim == 3 else rest * np.array([1, 1, 1, -1])) == np.inf


def test_the_material_of_the_page_has_a_block() -> None:
    source = of_page("developer/add-a-material.md", "python")["femdeform/scene/schema.py"]
    model = executed(source, "new_schema", vars(schema))["CiarletMaterial"]
    assert find_faults(model, {**material("ciarlet")}) == []
    assert find_faults(model, {**material("ciarlet", nu=0.7)})


@pytest.fixture
def new_method(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Class and options of the method of the page."""
    blocks = of_page("developer/add-a-method.md", "python")
    names = executed(blocks["femdeform/scene/schema.py"], "new_schema", vars(schema))
    options = TypeAdapter(names["Solver"])
    assert options.validate_python({"tolerance": 1e-6}) == schema.ProjectedNewtonSolver(tolerance=1e-6)
    monkeypatch.setattr(schema, "PlainNewtonSolver", names["PlainNewtonSolver"], raising=False)
    solver = executed(blocks["solvers/plain_newton.py"], "plain_newton")["PlainNewton"]
    return solver, options.validate_python({"method": "plain_newton", "max_iterations": 12})


def bent_bar(load: float) -> Simulation:
    return build(
        scene(
            {"b": body(block([1.0, 0.2], [6, 2]), material(E=1e5, nu=0.3))},
            {"kind": "fixed", "on": "b.left"},
            {"kind": "traction", "on": "b.right", "value": [0.0, load]},
            time=quasistatic(),
        )
    )


def test_the_method_of_the_page_finds_what_the_reference_finds(new_method: Any) -> None:
    simulation = bent_bar(-100.0)
    make, options = new_method
    solver = make(options, simulation.linear_solver)

    def solve(method: Any, budget: Budget | None = None) -> tuple[StepResult, list[dict[str, Any]]]:
        rows: list[dict[str, Any]] = []
        simulation.problem.begin_step(simulation.state, 1.0)
        answer = method.step(simulation.problem, simulation.state, lambda row, x: rows.append(dict(row)), budget)
        return answer, rows

    result, rows = solve(solver)
    assert result.converged, result.reason
    reference, _ = solve(simulation.solver)
    np.testing.assert_allclose(result.x, reference.x, atol=1e-9)
    assert np.abs(result.x - simulation.discretization.points).max() > 0.02
    assert [row["iteration"] for row in rows] == list(range(1, result.iterations + 1))
    assert rows[-1]["relative_residual"] == result.relative_residual <= 1e-8
    short, rows = solve(solver, Budget(iterations=2))
    assert (short.converged, short.iterations, len(rows)) == (False, 2, 2)
    assert "budget" in short.reason


def test_the_method_of_the_page_says_when_it_fails(new_method: Any) -> None:
    simulation = bent_bar(-3000.0)
    make, options = new_method
    simulation.problem.begin_step(simulation.state, 1.0)
    result = make(options, simulation.linear_solver).step(simulation.problem, simulation.state)
    assert not result.converged
    assert result.reason


@pytest.mark.parametrize(
    ("parameters", "measure"),
    [({}, 0.1 * 0.016), ({"thickness": 0.01, "cells": [12, 4, 2]}, 0.1 * 0.016 * 0.01)],
    ids=["2D", "3D"],
)
def test_the_recipe_of_the_page_makes_a_mesh(parameters: dict[str, Any], measure: float) -> None:
    from meshes import structured
    from meshes.boundary import measures, signed_measures
    from meshes.quality import check_mesh

    blocks = of_page("developer/add-a-recipe.md", "python")
    model = executed(blocks["femdeform/scene/mesh_schema.py"], "new_schema", vars(mesh_schema))["SpecimenMesh"]
    names = executed(blocks["meshes/structured.py"], "structured", {**vars(structured), "SpecimenMesh": model})
    choice = textwrap.indent(textwrap.dedent(blocks["meshes/build.py"]), "    ")
    build_recipe = executed(
        f"def build_recipe(source):\n{choice}",
        "build",
        {"SpecimenMesh": model, "structured": types.SimpleNamespace(specimen=names["specimen"])},
    )["build_recipe"]
    mesh, notices = check_mesh(build_recipe(model.model_validate({"recipe": "specimen", **parameters})), "specimen")
    assert notices == []
    assert np.all(signed_measures(mesh.points, mesh.cells) > 0.0)
    # Over a whole period the trapezoidal rule is exact for a cosine.
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(measure, rel=1e-12)
    sides = {"left", "right", "bottom", "top", *(("back", "front") if mesh.dim == 3 else ())}
    assert {*sides, "boundary"} == set(mesh.facet_groups)
    assert sum(len(mesh.facet_groups[side]) for side in sides) == len(mesh.facet_groups["boundary"])
    assert find_faults(model, {"recipe": "specimen", "width": 0.01})[0].path == ("waist",)


@pytest.mark.slow
@pytest.mark.parametrize("full", [False, True])
def test_the_case_of_the_page_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: bool) -> None:
    from verification import analytic
    from verification.analytic import beams
    from verification.study import run_case

    folder = tmp_path / "hanging_bar"
    folder.mkdir()
    for title, text in of_page("developer/add-a-case.md", "yaml").items():
        (folder / Path(title).name).write_text(text, encoding="utf-8")
    (source,) = of_page("developer/add-a-case.md", "python").values()
    formula = executed(source, "new_beams", vars(beams))["hanging_bar_tip"]
    monkeypatch.setitem(analytic.ANALYTIC, "hanging_bar_tip", formula)
    result = run_case(folder, full=full)
    assert {verdict.quantity for verdict in result.verdicts} == {"l2", "h1", "tip"}
    assert all(verdict.passed for verdict in result.verdicts), result.verdicts
