"""The command line. Imports nothing heavy: what a command needs is imported when it runs."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from femdeform.errors import FemdeformError, InputError

_BAD_INPUT = 2
_ENVIRONMENT = 4
_INTERRUPTED = 130
# Seconds by which other ranks let the first one report an error.
_HEAD_START = 1.0

_DESCRIPTION = "Large-deformation simulation: many implicit solvers behind one scene file."
_EPILOG = """\
examples:
  femdeform check scenes/rubber-mount.yaml
  femdeform run scenes/rubber-mount.yaml --out results/mount
  mpiexec -n 2 femdeform run scenes/rubber-mount.yaml
  femdeform batch study.yaml --jobs 4
  femdeform view results/mount --png mount.png
  femdeform report results/mount

exit codes:
  0 done    1 verification or expectation failed    2 bad input    3 not converged    4 environment
  70 a bug in femdeform    130 interrupted
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; default: those of the process.

    Returns
    -------
    int
        Exit code: 0 done, 1 verification or expectation failed, 2 bad input, 3 not converged, 4 environment,
        70 a bug in femdeform, 130 interrupted.
    """
    for stream in (sys.stdout, sys.stderr):
        # Text of a scene may hold what a terminal's encoding lacks; that must not end a run.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    code = _execute(argv)
    if code != 0 and not _is_first_rank() and "mpi4py.MPI" not in sys.modules:
        # A launcher ends all ranks when one fails; without MPI nothing else lets the first one finish its message.
        time.sleep(_HEAD_START)
    return code


def _execute(argv: Sequence[str] | None) -> int:
    parser = build_parser()
    try:
        arguments = parser.parse_args(argv)
    except SystemExit as stop:  # argparse leaves this way, for --help and for errors
        return stop.code if isinstance(stop.code, int) else _BAD_INPUT
    if arguments.command is None:
        parser.print_help()
        return 0
    command: Callable[[argparse.Namespace], int] = arguments.execute
    try:
        code = command(arguments)
        sys.stdout.flush()
        return code
    except FemdeformError as error:
        _complain(error)
        return error.exit_code
    except KeyboardInterrupt:
        if _is_first_rank():
            print("femdeform: interrupted", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has gone (`femdeform schema | head`); Python would complain again at exit.
        _drop_output()
        return _ENVIRONMENT
    except Exception as error:
        return _explain(error)


def _explain(error: Exception) -> int:
    """Say what an error other than our own means, with the traceback if it is a bug; return the exit code."""
    import traceback

    from femdeform.run.atomic import output_error
    from femdeform.run.failure import BUG_NOTE, exit_code, expected_error

    known = expected_error(error)
    if isinstance(error, OSError) and error.filename is None and not _can_print():
        _drop_output()
        known = output_error("to the standard output", error)
    if known is not None:
        _complain(known)
    elif _is_first_rank():
        traceback.print_exception(error)
        print(BUG_NOTE, file=sys.stderr, flush=True)
    return exit_code(error)


def _can_print() -> bool:
    try:
        print(flush=True)  # what failed before is no longer in the buffer: it takes something to fail again
    except OSError:
        return False
    return True


def _drop_output() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(error: FemdeformError) -> None:
    """Say what is wrong, once however many ranks find it."""
    if not _is_first_rank():
        return
    if isinstance(error, InputError):
        # A fault with a place stands for itself: editors look for file:line at its start.
        lines = [str(fault) if fault.file else f"femdeform: {fault}" for fault in error.faults]
    else:
        lines = [f"femdeform: {error}"]
    print("\n".join(lines), file=sys.stderr, flush=True)


def _is_first_rank() -> bool:
    from femdeform.parallel import launched_rank

    return launched_rank() == 0


class _Parser(argparse.ArgumentParser):
    """A parser that complains on the first rank only, with a hint where to read on."""

    def error(self, message: str) -> NoReturn:
        if _is_first_rank():
            self.print_usage(sys.stderr)
            print(f"{self.prog}: {message} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(_BAD_INPUT)

    def _print_message(self, message: str, file: Any = None) -> None:
        if _is_first_rank():
            super()._print_message(message, file)


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from femdeform.info import own_version

        print(f"femdeform {own_version()}")
        parser.exit()


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser: argparse.ArgumentParser = _parser(_Parser, prog="femdeform", description=_DESCRIPTION, epilog=_EPILOG)
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands", parser_class=_Parser)

    def add(name: str, execute: Callable[[argparse.Namespace], int], help: str, epilog: str) -> Any:
        description = help[0].upper() + help[1:] + "."
        command = _parser(commands.add_parser, name, help=help, description=description, epilog=epilog)
        command.set_defaults(execute=execute)
        return command

    check = add("check", _check, "report every fault of scenes, comparisons and studies", _CHECK_EPILOG)
    check.add_argument(
        "scene", nargs="+", type=Path, metavar="FILE", help="scene, comparison file or study file (YAML)"
    )
    _add_set(check)

    run = add("run", _run, "run a scene and write a result folder", _RUN_EPILOG)
    run.add_argument("scene", type=Path, metavar="SCENE", help="scene file (YAML)")
    run.add_argument("--out", type=Path, metavar="DIR", help="result folder (default: results/<name of the scene>)")
    _add_set(run)
    start = run.add_mutually_exclusive_group()
    start.add_argument("--resume", action="store_true", help="go on from the result folder's checkpoint")
    start.add_argument("--overwrite", action="store_true", help="replace a result that lies in the folder")
    run.add_argument("--trace", action="store_true", help="write iterations.csv, one row an iteration")
    run.add_argument(
        "--threads",
        type=_positive,
        metavar="N",
        help="threads of the kernels (default: cores divided by ranks)",
    )
    run.add_argument("--quiet", action="store_true", help="no progress and no notices")

    batch = add("batch", _batch, "make all runs of a study, some at a time", _BATCH_EPILOG)
    batch.add_argument("study", type=Path, metavar="STUDY", help="study file (YAML)")
    batch.add_argument(
        "--jobs", type=_positive, metavar="N", help="runs at a time (default: one for each core, not under mpiexec)"
    )
    batch.add_argument("--out", type=Path, metavar="DIR", help="folder of the batch (default: results/<study>)")
    batch.add_argument("--retry", action="store_true", help="make failed runs again, from their start")
    batch.add_argument("--quiet", action="store_true", help="no progress and no notices")

    view = add("view", _view, "draw a result, without a display if need be", _VIEW_EPILOG)
    view.add_argument("result", type=Path, metavar="RESULT", help="result folder")
    view.add_argument("--png", type=Path, metavar="FILE", help="write a picture")
    view.add_argument("--movie", type=Path, metavar="FILE", help="write a movie of all frames (.mp4 or .gif)")
    view.add_argument(
        "--frame",
        type=int,
        metavar="N",
        help="frame, from 0; negative counts from the end (default: the last)",
    )
    view.add_argument("--field", metavar="NAME", help="field to show, such as von_mises, vorticity or temperature")

    report = add("report", _report, "write one self-contained HTML page about a result", _REPORT_EPILOG)
    report.add_argument("result", type=Path, metavar="RESULT", help="result folder")
    report.add_argument("--out", type=Path, metavar="FILE", help="page to write (default: in the result folder)")
    report.add_argument("--plots", action="store_true", help="also write plots/*.png into the result folder")

    compare = add("compare", _compare, "compare methods or options on one scene at equal budget", _COMPARE_EPILOG)
    compare.add_argument("scene", type=Path, metavar="FILE", help="scene file or comparison file (YAML)")
    compare.add_argument("--methods", metavar="A,B,C", help="methods to compare, with the scene's options or defaults")
    compare.add_argument(
        "--variant",
        dest="variants",
        action="append",
        default=[],
        metavar="'LABEL: KEY=VALUE ...'",
        help="options of solver or linear_solver to compare; may be given several times",
    )
    budget = compare.add_mutually_exclusive_group()
    budget.add_argument("--iterations", type=_positive, metavar="N", help="budget of a step in iterations")
    budget.add_argument("--seconds", type=float, metavar="S", help="budget of a step in seconds")
    compare.add_argument("--steps", type=_positive, metavar="M", help="steps to compare (default: 1)")
    compare.add_argument(
        "--start-step",
        type=int,
        metavar="K",
        help="start from step K of the converged reference (default: 0, the initial state)",
    )
    compare.add_argument(
        "--repeat",
        type=_positive,
        metavar="R",
        help="run each R times and report the run of median length (default: 1)",
    )
    compare.add_argument("--out", type=Path, metavar="DIR", help="folder (default: results/compare-<file's name>)")
    _add_set(compare)
    compare.add_argument("--threads", type=_positive, metavar="N", help="threads of the kernels (default: cores)")
    compare.add_argument("--quiet", action="store_true", help="no progress and no notices")

    mesh = add("mesh", _mesh, "make a mesh by a recipe, or describe a mesh file", _MESH_EPILOG)
    mesh.add_argument("recipe", nargs="?", metavar="RECIPE", help="name of a recipe, such as block or rubber_mount")
    mesh.add_argument("--info", type=Path, metavar="FILE", help="describe a mesh file instead")
    mesh.add_argument("--out", type=Path, metavar="FILE", help="mesh file to write; the ending says which format")
    _add_set(mesh)

    verify = add("verify", _verify, "judge errors, observed rates and published values of cases", _VERIFY_EPILOG)
    verify.add_argument("case", nargs="*", metavar="CASE", help="name of a case, or a folder of yours (default: all)")
    verify.add_argument("--full", action="store_true", help="all levels of all studies, not the coarse end only")
    verify.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default: results/verify)")
    verify.add_argument("--list", action="store_true", help="print the cases and leave")
    verify.add_argument("--quiet", action="store_true", help="no progress and no tables, the last line only")

    bench = add("bench", _bench, "run the benchmarks", _BENCH_EPILOG)
    bench.add_argument("name", nargs="*", metavar="NAME", help="benchmark (default: all)")
    bench.add_argument("--out", type=Path, metavar="DIR", help="folder for the tables")

    train = add("train", _train, "train weights of a learned pressure solver", _TRAIN_EPILOG)
    train.add_argument("kind", choices=["dcdm", "spd_lmg"], metavar="METHOD", help="dcdm or spd_lmg")
    train.add_argument("--out", type=Path, metavar="DIR", help="folder (default: results/train-<method>-<dim>d)")
    train.add_argument("--name", metavar="NAME", help="of the files (default: <method>-<dim>d)")
    train.add_argument("--dim", type=int, choices=[2, 3], default=2, help="dimension (default: 2)")
    train.add_argument("--cells", type=_positive, default=64, metavar="N", help="cells along an axis (default: 64)")
    train.add_argument("--steps", type=_positive, default=2000, metavar="N", help="steps (default: 2000)")
    train.add_argument("--batch", type=_positive, default=8, metavar="N", help="samples a step (default: 8)")
    train.add_argument("--rate", type=float, default=2e-3, metavar="R", help="learning rate (default: 0.002)")
    train.add_argument("--seed", type=int, default=0, metavar="S", help="of everything random (default: 0)")
    train.add_argument("--minutes", type=float, metavar="M", help="end after this time with what there is")
    train.add_argument("--device", choices=["cpu", "cuda"], default="cpu", help="where (default: cpu)")
    train.add_argument("--threads", type=_positive, default=1, metavar="N", help="of PyTorch (default: 1)")
    train.add_argument(
        "--route",
        choices=["on_policy", "ritz"],
        help="dcdm: errors that the solver leaves, or Ritz vectors as in the source (default: on_policy)",
    )
    train.add_argument("--model", metavar="NAME", help="dcdm: network (default: masks)")
    train.add_argument("--lanczos", type=_positive, metavar="N", help="ritz: steps (default: 1000)")
    train.add_argument("--samples", type=_positive, metavar="N", help="ritz: right-hand sides (default: 20000)")
    train.add_argument("--start", type=Path, metavar="FILE", help="weights to start from (default: random ones)")
    train.add_argument(
        "--precision",
        choices=["float32", "bfloat16"],
        help="dcdm: of the network in training (default: float32)",
    )
    train.add_argument(
        "--hard",
        type=float,
        metavar="P",
        help="part of the domains with solids that are porous or have plates (default: 0.1 for dcdm, 0.3 for spd_lmg)",
    )
    train.add_argument(
        "--validations",
        type=_positive,
        default=8,
        metavar="N",
        help="how often the run is validated and can be gone on from (default: 8)",
    )
    train.add_argument("--resume", action="store_true", help="go on from the folder's checkpoint")
    train.add_argument("--quiet", action="store_true", help="no progress")

    schema = add("schema", _schema, "print the JSON schema of scene files, for editors", _SCHEMA_EPILOG)
    schema.add_argument("--markdown", action="store_true", help="print the reference of all keys as Markdown instead")
    add("info", _info, "print versions, PETSc packages, threads and optional parts", "")
    return parser


def _parser(make: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    # Abbreviated options would change their meaning when a longer one is added.
    return make(*arguments, allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **options)


def _add_set(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        dest="overrides",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a value; may be given several times",
    )


def _positive(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a positive whole number, not {text}")
    return int(text)


# ------------------------------------------------------------------------------------------------- commands

_CHECK_EPILOG = """\
Every fault is printed as file:line: key: message, sorted by line. The exit code is 2 if there is any.
Of a file for `femdeform compare` or `femdeform batch` all scenes that it leads to are checked.

examples:
  femdeform check scenes/*.yaml scenes/studies/*.yaml
  femdeform check scene.yaml --set time.dt=0.02 --set conditions[0].on=beam.left
"""


def _check(arguments: argparse.Namespace) -> int:
    from femdeform.run.check_command import faults_of

    is_first = _is_first_rank()
    code = 0
    for path in arguments.scene:
        notices: list[str] = []
        faults = faults_of(path, arguments.overrides, notices)
        if faults:
            code = InputError.exit_code
        if not is_first:
            continue
        for fault in faults:
            print(fault, file=sys.stderr)
        for text in notices:
            print(f"{path}: note: {text}")
        if not faults:
            print(f"{path}: no faults")
    return code


_RUN_EPILOG = """\
examples:
  femdeform run scene.yaml
  femdeform run scene.yaml --out results/soft --set bodies.beam.material.youngs_modulus=1e5
  femdeform run scene.yaml --set conditions[1].rate=2 --set linear_solver.preset=newton-gamg
  femdeform run scene.yaml --resume
  femdeform run scene.yaml --overwrite
  mpiexec -n 4 femdeform run scene.yaml
"""


def _run(arguments: argparse.Namespace) -> int:
    from femdeform.run.interrupts import answered_in_time

    with answered_in_time():
        from femdeform.run.runner import run_scene

        return run_scene(
            arguments.scene,
            out=arguments.out,
            overrides=arguments.overrides,
            resume=arguments.resume,
            overwrite=arguments.overwrite,
            trace=arguments.trace,
            threads=arguments.threads,
            quiet=arguments.quiet,
        )


_BATCH_EPILOG = """\
Finished runs are kept, interrupted ones go on; the same command may be given again at any time. The folder gets
index.csv, index.html, study.json and a result folder for each run.

examples:
  femdeform batch study.yaml
  femdeform batch study.yaml --jobs 4 --out results/study
  femdeform batch study.yaml --retry
  mpiexec -n 9 femdeform batch study.yaml
"""


def _batch(arguments: argparse.Namespace) -> int:
    from femdeform.post.batch_page import BatchPage
    from femdeform.run.batch import run_batch

    return run_batch(
        arguments.study,
        jobs=arguments.jobs,
        out=arguments.out,
        retry=arguments.retry,
        quiet=arguments.quiet,
        page=BatchPage(),
    )


_VIEW_EPILOG = """\
examples:
  femdeform view results/beam
  femdeform view results/beam --png beam.png --field von_mises
  femdeform view results/beam --movie beam.mp4
  femdeform view results/plume --field vorticity --png plume.png
"""


def _view(arguments: argparse.Namespace) -> int:
    from femdeform.post.render import view

    for path in view(
        arguments.result,
        png=arguments.png,
        movie=arguments.movie,
        frame=arguments.frame,
        field=arguments.field,
    ):
        print(path)
    return 0


_REPORT_EPILOG = """\
examples:
  femdeform report results/beam
  femdeform report results/beam --out beam.html
"""


def _report(arguments: argparse.Namespace) -> int:
    from femdeform.post.report import write_report

    print(write_report(arguments.result, arguments.out))
    if arguments.plots:
        from femdeform.post.run_plots import write_plots

        for path in write_plots(arguments.result):
            print(path)
    return 0


_COMPARE_EPILOG = """\
Every variant gets the same start and the same budget for each step. One residual judges them all, and the
distance to a converged reference. Needs one process, no mpiexec. A comparison file says all of it at once; what is
given beside it goes before.

examples:
  femdeform compare scene.yaml --methods projected_newton --variant "exact: solver.hessian=exact" --iterations 10
  femdeform compare scene.yaml --variant "lu: linear_solver.preset=newton-mumps" \\
      --variant "amg: linear_solver.preset=newton-gamg" --seconds 0.5 --steps 5 --repeat 3
  femdeform compare comparison.yaml
"""


def _compare(arguments: argparse.Namespace) -> int:
    from femdeform.post.compare_command import compare_command

    return compare_command(
        arguments.scene,
        {
            name: getattr(arguments, name)
            for name in ("iterations", "seconds", "steps", "start_step", "repeat", "threads")
        },
        methods=arguments.methods,
        option_sets=arguments.variants,
        overrides=arguments.overrides,
        out=arguments.out,
        quiet=arguments.quiet,
    )


_MESH_EPILOG = """\
examples:
  femdeform mesh block --out block.vtu --set size=[1,0.2,0.2] --set cells=[40,8,8]
  femdeform mesh rubber_mount --out mount.msh --set element_size=0.004
  femdeform mesh --info mount.msh
"""


def _mesh(arguments: argparse.Namespace) -> int:
    from femdeform import registry
    from femdeform.run.interrupts import Interrupts, answered_in_time
    from femdeform.scene.overrides import parse_override

    settings: dict[str, object] = {}
    faults = []
    for text in arguments.overrides:
        override, problems = parse_override(text)
        faults += problems
        if override is not None:
            settings[".".join(map(str, override.path))] = override.value
    if faults:
        raise InputError(faults)
    command = registry.resolve(registry.MESH["command"])
    with answered_in_time(), Interrupts():
        print(command(arguments.recipe, settings, arguments.out, arguments.info))
    return 0


_VERIFY_EPILOG = """\
A case is a folder with a study.yaml, scenes and a README. The exit code is 1 if a judgement lies outside its band.
The folder gets index.html, verify.json and, for every case, errors.csv, rates.json and plots.

examples:
  femdeform verify --list
  femdeform verify
  femdeform verify manufactured turek_hron --full --out results/evidence
  femdeform verify my-cases/bracket
"""


def _verify(arguments: argparse.Namespace) -> int:
    from femdeform import registry

    code: int
    if arguments.list:
        code = registry.resolve(registry.VERIFY["list"])()
    else:
        command = registry.resolve(registry.VERIFY["run"])
        code = command(arguments.case, arguments.full, arguments.out, arguments.quiet)
    return code


_BENCH_EPILOG = """\
examples:
  femdeform bench
  femdeform bench newton --out results/bench
  femdeform bench mixed

newton: assembly, one Newton iteration by preset, on one rank and two, beside other codes.
mixed: a substep of the alternating scheme, one iteration of the converged one, growth with the mesh, iteration counts;
  with the meshes published with the paper's code where FEMDEFORM_DATA/meshes has them, else recipes of the same size.
pbng: sweeps over the nodes, growth with the mesh, the way to a tolerance beside Newton's method, equal budgets.
xpbd: sweeps over the cells, what they reach at given stiffness numbers, beside other codes.
poisson: solvers of the pressure of flows, on boxes of 32^3 to 256^3 voxels, with a plot of residuals for each scene.
dcdm: deep conjugate directions at growing resolution, by kept directions and by network, and on steps of the heat
  equation, beside classical solvers.
mpm: material points a second in explicit steps, growth with their number, beside a kernel in Taichi.
FEMDEFORM_BENCH_ONLY="growth; twist, newton" runs only cases with such a text in the name that they are shown with, of
  poisson's "64^3, plume" or ": mg"; "64^3, ; not dcdm; not : cg" runs all on that grid without these two solvers.
  FEMDEFORM_BENCH_CELLS=N makes all bodies blocks of N cells an edge, all grids N^3 voxels.
bench.md holds the tables as Markdown, bench.json all numbers. Both are written after every case: a benchmark that is
  ended keeps what it has measured, and says that it is not finished. A case that breaks is named, the others go on.
"""


def _bench(arguments: argparse.Namespace) -> int:
    from femdeform import registry

    code: int = registry.resolve(registry.BENCHMARKS["run"])(arguments.name, arguments.out)
    return code


_SCHEMA_EPILOG = """\
examples:
  femdeform schema > femdeform.schema.json
  femdeform schema --markdown > scene-reference.md

With the line below as the first of a scene, editors that know the YAML language server check and complete it:
  # yaml-language-server: $schema=femdeform.schema.json
"""


_TRAIN_EPILOG = """\
The folder gets weights (.npz) with their SHA-256, a card, a loss curve and a checkpoint. A scene names the weights:

  linear_solver: {method: spd_lmg, weights: results/train-spd_lmg-2d/spd_lmg-2d.npz}

Networks of dcdm: source-64, source-128, no-bias, masks, no-residual, no-pooling, no-skip, narrow. Needs PyTorch:
pip install 'femdeform[learned]'.

examples:
  femdeform train spd_lmg --dim 2 --cells 64 --steps 4000
  femdeform train dcdm --dim 3 --cells 64 --model source-64 --route ritz --device cuda
  femdeform train dcdm --steps 4000 --resume
"""


def _train(arguments: argparse.Namespace) -> int:
    import shlex

    from femdeform import registry

    settings, train = (registry.resolve(registry.TRAIN[key]) for key in ("settings", "run"))
    kind, dim = arguments.kind, arguments.dim
    told = vars(arguments)
    names = (
        "dim",
        "cells",
        "steps",
        "batch",
        "rate",
        "seed",
        "minutes",
        "device",
        "route",
        "model",
        "lanczos",
        "samples",
        "start",
        "precision",
        "hard",
        "validations",
    )
    out = arguments.out or Path("results") / f"train-{kind}-{dim}d"
    registry.resolve(registry.TRAIN["threads"])(arguments.threads)
    command = shlex.join(["femdeform", *(word for word in sys.argv[1:] if word != "--resume")])
    given = {name: told[name] for name in names if told[name] is not None}
    for path in train(
        settings(kind, out, **given),
        arguments.name or f"{kind}-{dim}d",
        command,
        arguments.resume,
        arguments.quiet,
        given,
    ):
        print(path)
    return 0


def _schema(arguments: argparse.Namespace) -> int:
    import json

    from femdeform.scene.export import json_schema
    from femdeform.scene.reference import scene_markdown

    if _is_first_rank():
        print(scene_markdown() if arguments.markdown else json.dumps(json_schema(), indent=2))
    return 0


def _info(_: argparse.Namespace) -> int:
    from femdeform.info import describe

    if _is_first_rank():
        print(describe())
    return 0
