"""The command line: exit codes, messages without tracebacks, and what it does not import."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from femdeform import cli, errors, registry

HEAVY = (
    "numba",
    "skfem",
    "scipy",
    "pyvista",
    "vtk",
    "gmsh",
    "meshio",
    "torch",
    "h5py",
    "matplotlib",
    "petsc4py",
    "mpi4py",
)
SCENE = """\
simulation: deformable
bodies:
  beam:
    mesh: {recipe: block, size: [1.0, 0.2, 0.2], cells: [5, 1, 1]}
    material: {law: neo_hookean, density: 1000.0, youngs_modulus: 1.0e6, poisson_ratio: 0.45}
conditions:
  - {kind: fixed, on: beam.left}
time: {scheme: backward_euler, dt: 0.01, end: 1.0}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE, encoding="utf-8")
    return path


@pytest.fixture
def bad_scene(tmp_path: Path) -> Path:
    path = tmp_path / "bad.yaml"
    path.write_text(SCENE.replace("beam.left", "beam.lift").replace("density", "densty"), encoding="utf-8")
    return path


def modules_after(arguments: list[str]) -> list[str]:
    """Names of all modules in a new process after a command that ended well."""
    lines = [
        "import sys",
        "from femdeform.cli import main",
        f"assert main({arguments!r}) == 0",
        "print()",
        "print(*sys.modules)",
    ]
    finished = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, timeout=60)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout.splitlines()[-1].split()


# ------------------------------------------------------------------------------------------------ start-up


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["--version"], ["schema"]])
def test_what_is_said_at_once_imports_nothing_heavy(arguments: list[str]) -> None:
    modules = modules_after(arguments)
    assert "femdeform.cli" in modules
    assert [name for name in HEAVY if name in modules] == []


def test_a_check_imports_nothing_heavy(scene: Path) -> None:
    modules = modules_after(["check", str(scene)])
    assert "femdeform.scene.checks" in modules
    assert [name for name in HEAVY if name in modules] == []


def test_as_a_module_and_without_arguments(tmp_path: Path) -> None:
    finished = subprocess.run(
        [sys.executable, "-m", "femdeform"], capture_output=True, text=True, cwd=tmp_path, timeout=60
    )
    assert finished.returncode == 0
    assert finished.stdout.startswith("usage: femdeform")
    for command in ("check", "run", "view", "report", "mesh", "bench", "schema", "info"):
        assert f"\n    {command} " in finished.stdout


# ---------------------------------------------------------------------------------------------------- usage


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rum"], "invalid choice: 'rum'"),
        (["check"], "the following arguments are required: FILE"),
        (["run"], "the following arguments are required: SCENE"),
        (["run", "a.yaml", "b.yaml"], "unrecognized arguments: b.yaml"),
        (["run", "a.yaml", "--res"], "unrecognized arguments: --res"),
        (["run", "a.yaml", "--threads", "0"], "must be a positive whole number, not 0"),
        (["run", "a.yaml", "--threads", "two"], "must be a positive whole number, not two"),
        (["view", "results", "--frame", "last"], "invalid int value: 'last'"),
    ],
)
def test_wrong_usage_is_bad_input(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("usage: femdeform")
    assert message in captured.err.splitlines()[-1]


@pytest.mark.parametrize("command", ["check", "run", "view", "report", "mesh", "bench", "schema"])
def test_every_command_shows_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([command, "--help"]) == 0
    assert f"\n  femdeform {command}" in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    name, version = capsys.readouterr().out.split()
    assert name == "femdeform"
    assert version[0].isdigit()


# ---------------------------------------------------------------------------------------------------- check


def test_check_of_a_sound_scene(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", str(scene)]) == 0
    assert capsys.readouterr() == (f"{scene}: no faults\n", "")


def test_check_of_several_scenes_reports_all(scene: Path, bad_scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = scene.parent / "none.yaml"
    assert cli.main(["check", str(bad_scene), str(scene), str(missing)]) == 2
    captured = capsys.readouterr()
    assert captured.out == f"{scene}: no faults\n"
    assert captured.err.splitlines() == [
        f"{bad_scene}:5: bodies.beam.material.densty: unknown key; did you mean `density`?",
        f"{missing}: there is no such file",
    ]


def test_check_with_overrides(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", str(scene), "--set", "time.dt=0.5", "--set", "conditions[0].on=beam.right"]) == 0
    capsys.readouterr()
    assert cli.main(["check", str(scene), "--set", "time.dt=-1", "--set", "conditions[0].on=beam.lift"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("--set conditions[0].on=beam.lift: conditions[0].on: body `beam` has no group `lift`")
    assert lines[1] == "--set time.dt=-1: time.dt: must be greater than 0 [s], not -1"


def test_the_file_is_named_as_it_was_given(bad_scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(bad_scene.parent)
    assert cli.main(["check", "bad.yaml"]) == 2
    assert capsys.readouterr().err.startswith("bad.yaml:5: ")


# -------------------------------------------------------------------------------------- the commands' arguments


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Put recorders in the place of what the commands call."""
    import types

    recorded: list[Any] = []

    def module(name: str, **functions: Any) -> None:
        stand_in = types.ModuleType(name)
        for key, function in functions.items():
            setattr(stand_in, key, function)
        monkeypatch.setitem(sys.modules, name, stand_in)

    def recorder(answer: Any) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            recorded.append((args, kwargs))
            return answer

        return call

    module("femdeform.run.runner", run_scene=recorder(3))
    module("femdeform.post.render", view=recorder([Path("a.png"), Path("b.mp4")]))
    module("femdeform.post.report", write_report=recorder(Path("r.html")))
    module("stand_in", mesh=recorder("a mesh"), bench=recorder(1))
    monkeypatch.setitem(registry.MESH, "command", "stand_in:mesh")
    monkeypatch.setitem(registry.BENCHMARKS, "run", "stand_in:bench")
    return recorded


def test_run(calls: list[Any]) -> None:
    assert cli.main(["run", "a.yaml"]) == 3
    line = "run a.yaml --out r --set x=1 --set y=2 --resume --trace --threads 2 --quiet"
    assert cli.main(line.split()) == 3
    assert calls == [
        (
            (Path("a.yaml"),),
            {
                "out": None,
                "overrides": [],
                "resume": False,
                "overwrite": False,
                "trace": False,
                "threads": None,
                "quiet": False,
            },
        ),
        (
            (Path("a.yaml"),),
            {
                "out": Path("r"),
                "overrides": ["x=1", "y=2"],
                "resume": True,
                "overwrite": False,
                "trace": True,
                "threads": 2,
                "quiet": True,
            },
        ),
    ]


def test_view_and_report(calls: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["view", "r", "--png", "a.png", "--movie", "b.mp4", "--frame", "-1", "--field", "von_mises"]) == 0
    assert cli.main(["report", "r", "--out", "r.html"]) == 0
    assert cli.main(["report", "r"]) == 0
    options = {"png": Path("a.png"), "movie": Path("b.mp4"), "frame": -1, "field": "von_mises"}
    assert calls == [((Path("r"),), options), ((Path("r"), Path("r.html")), {}), ((Path("r"), None), {})]
    assert capsys.readouterr().out.split() == ["a.png", "b.mp4", "r.html", "r.html"]


def test_mesh_and_bench(calls: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["mesh", "block", "--out", "b.vtu", "--set", "size=[1, 2, 3]", "--set", "rotate.angle=0.5"]) == 0
    assert cli.main(["mesh", "--info", "b.vtu"]) == 0
    assert cli.main(["bench", "newton", "other", "--out", "t"]) == 1
    assert calls == [
        (("block", {"size": [1, 2, 3], "rotate.angle": 0.5}, Path("b.vtu"), None), {}),
        ((None, {}, None, Path("b.vtu")), {}),
        ((["newton", "other"], Path("t")), {}),
    ]
    assert capsys.readouterr().out == "a mesh\na mesh\n"


def test_mesh_with_a_setting_that_is_none(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["mesh", "block", "--set", "size"]) == 2
    assert capsys.readouterr().err.startswith("--set size: must be key=value")


def test_a_mesh_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "block.vtu"
    assert cli.main(["mesh", "block", "--out", str(path), "--set", "cells=[2, 1, 1]"]) == 0
    assert path.is_file()
    capsys.readouterr()
    assert cli.main(["mesh", "--info", str(path)]) == 0
    assert "10 tetrahedra" in capsys.readouterr().out


def test_schema_is_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    kinds = [schema["$defs"][each["$ref"].rsplit("/", 1)[1]]["required"] for each in schema["oneOf"]]
    assert [set(keys) for keys in kinds] == [
        {"simulation", "bodies", "time"},
        {"simulation", "grid", "time"},
        {"simulation", "grid", "bodies", "time"},
    ]


# ------------------------------------------------------------------------------------------------ exit codes


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (errors.ExpectationError("energy is off"), 1, "femdeform: energy is off\n"),
        (errors.InputError("no such thing"), 2, "femdeform: no such thing\n"),
        (
            errors.InputError([errors.Fault("a.yaml", 3, "k", "m"), errors.Fault("", 0, "", "n")]),
            2,
            "a.yaml:3: k: m\nfemdeform: n\n",
        ),
        (errors.MeshError([errors.Fault("a.msh", 0, "", "flat")]), 2, "a.msh: flat\n"),
        (errors.NotConvergedError("step 3: stopped"), 3, "femdeform: step 3: stopped\n"),
        (errors.MissingDependencyError("no PETSc"), 4, "femdeform: no PETSc\n"),
        (KeyboardInterrupt(), 130, "femdeform: interrupted\n"),
    ],
)
def test_errors_become_exit_codes(
    error: BaseException, code: int, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: Any) -> int:
        raise error

    monkeypatch.setattr(cli, "_info", fail)
    assert cli.main(["info"]) == code
    assert capsys.readouterr() == ("", message)


def test_a_reader_that_leaves_early_causes_no_traceback() -> None:
    command = [sys.executable, "-m", "femdeform", "schema"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait(timeout=60) == 4


def test_a_terminal_without_unicode_ends_nothing(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace("simulation: deformable", "simulation: été\nçà: 1"), encoding="utf-8")
    command = [sys.executable, "-m", "femdeform", "check", str(path)]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    finished = subprocess.run(command, capture_output=True, env=environment, timeout=60)
    assert finished.returncode == 2
    assert b'"\\xe9t\\xe9" is not a known simulation' in finished.stderr
    assert b"Traceback" not in finished.stderr


# ------------------------------------------------------------------------------------------------------ ranks


@pytest.mark.parametrize(("size", "rank"), [("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK"), ("PMI_SIZE", "PMI_RANK")])
@pytest.mark.parametrize(
    "arguments", [["check", "none.yaml"], ["run"], ["mesh", "blok"], ["--help"], ["schema"], ["nonsense"]], ids=" ".join
)
def test_only_the_first_rank_speaks(
    arguments: list[str], size: str, rank: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "_HEAD_START", 0.0)
    monkeypatch.setenv(size, "2")
    monkeypatch.setenv(rank, "0")
    code = cli.main(arguments)
    assert code == (0 if arguments[0] in ("--help", "schema") else 2)
    assert "".join(capsys.readouterr())
    monkeypatch.setenv(rank, "1")
    assert cli.main(arguments) == code
    assert capsys.readouterr() == ("", "")
