"""`femdeform batch`: what is run, kept, gone on with and reported; endings of all kinds, interruption, ranks."""

from __future__ import annotations

import csv
import fcntl
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, quasistatic, scene, write

from femdeform.errors import InputError, OutputError
from femdeform.post.batch_page import BatchPage
from femdeform.run import batch, batch_process
from femdeform.run.batch import run_batch
from femdeform.run.batch_expectations import over_runs, over_runs_verdicts
from femdeform.run.batch_index import Row, StudyTable
from femdeform.run.batch_process import Task, serial_environment
from femdeform.run.batch_record import Ending, RunFiles, judge
from femdeform.run.failure import BUG_NOTE
from femdeform.scene.batch_schema import ExpectedOverRuns

Process = subprocess.CompletedProcess[str]

# Stands for `femdeform run`: the last word of the scene's title says how it ends, and the log how it was called.
FAKE = """
import json, os, signal, sys, time
from pathlib import Path
folder, how, resume = Path(sys.argv[1]), sys.argv[2], "--resume" in sys.argv
print("resumed" if resume else "begun", flush=True)
folder.mkdir(parents=True, exist_ok=resume)
def result(status, reason="", **more):
    facts = {"status": status, "reason": reason, "steps": 3, "quantities": {"volume_ratio": 1.25}, **more}
    (folder / "result.json").write_text(json.dumps(facts))
result("running")
(folder / "checkpoint.h5").write_text("")
if how == "expectation": result("expectation_failed", "far off"); sys.exit(1)
if how == "diverges": result("not_converged", "step 4"); sys.exit(3)
if how == "fails": result("failed", "no memory"); sys.exit(1)
if how == "segfault": os.kill(os.getpid(), signal.SIGSEGV)
if how == "killed" and not resume: os.kill(os.getpid(), signal.SIGKILL)
if how == "late": result("done"); os.kill(os.getpid(), signal.SIGABRT)
if how == "raises": raise ZeroDivisionError("in the fake")
if how == "environment": print("femdeform: no PETSc here", file=sys.stderr); sys.exit(4)
if how == "waits" and not resume:
    def stop(number, frame): result("interrupted", "interrupted by the user"); sys.exit(130)
    signal.signal(signal.SIGTERM, stop)
    while True: time.sleep(0.01)
result("done")
"""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the runs by quick ones that end as their titles say."""

    def command(task: Task, resume: bool) -> list[str]:
        title = next(text for text in task.overrides if text.startswith("title="))
        how = json.loads(title.partition("=")[2])
        return [sys.executable, "-S", "-c", FAKE, str(task.files.folder), how, *(["--resume"] if resume else [])]

    monkeypatch.setattr(Task, "command", command)


def small(**more: Any) -> dict[str, Any]:
    bodies = {"b": body(block([1.0, 0.2], [4, 1]))}
    pull = {"kind": "point_load", "on": "b.right", "force": [0.0, -10.0]}
    return scene(bodies, {"kind": "fixed", "on": "b.left"}, pull, time=quasistatic(dt=0.5), **more)


def study(folder: Path, *titles: str, **more: Any) -> Path:
    write(small(), folder / "scene.yaml")
    sweep = {"grid": {"title": list(titles)}}
    return write({"title": "T", "scene": "scene.yaml", "sweep": sweep, **more}, folder / "study.yaml")


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "index.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def statuses(out: Path) -> dict[str, str]:
    return {row["title"]: row["status"] for row in rows(out)}


def expected(out: Path) -> list[dict[str, Any]]:
    """Verdicts of a study's own `expect`."""
    verdicts: list[dict[str, Any]] = json.loads((out / "study.json").read_text(encoding="utf-8"))["expect"]
    return verdicts


def logs(out: Path) -> dict[str, str]:
    return {row["title"]: (out / "runs" / f"{row['run']}.log").read_text().split("\n")[0] for row in rows(out)}


# ------------------------------------------------------------------------------------------------- endings


@pytest.mark.usefixtures("fake")
def test_every_kind_of_ending(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    titles = ("fine", "expectation", "diverges", "fails", "segfault", "late", "raises", "environment")
    path = study(tmp_path, *titles, scalars=["volume_ratio", "steps"])
    assert run_batch(path, out=out, jobs=2) == 3
    table = {row["title"]: row for row in rows(out)}
    found = {title: (row["status"], row["reason"], row["exit_code"]) for title, row in table.items()}
    assert found == {
        "fine": ("done", "", "0"),
        "expectation": ("expectation_failed", "far off", "1"),
        "diverges": ("not_converged", "step 4", "3"),
        "fails": ("failed", "no memory", "1"),
        "segfault": ("crashed", "ended by SIGSEGV", "-11"),
        "late": ("done", "", "-6"),
        "raises": ("crashed", "ZeroDivisionError: in the fake", "1"),
        "environment": ("failed", "no PETSc here", "4"),
    }
    assert list(rows(out)[0]) == [
        *("number", "run", "title", "status", "reason", "exit_code", "seconds", "volume_ratio", "steps")
    ]
    assert [row["number"] for row in rows(out)] == [str(number) for number in range(1, 9)]
    assert table["fine"]["volume_ratio"] == "1.25"
    assert float(table["fine"]["seconds"]) > 0.0
    error = capfd.readouterr().err
    summary = error[error.rindex("run 2 (") :]
    for title, (status, reason, _) in found.items():
        log = out / "runs" / f"{table[title]['run']}.log"
        line = f"(title={title}): {status.replace('_', ' ')}, "
        assert (line in summary and f": {reason}; {log}" in summary) == (status != "done")
    assert "8 runs: 2 done, 2 failed, 2 crashed, 1 expectation failed, 1 not converged" in summary
    assert "--retry" in summary


@pytest.mark.usefixtures("fake")
def test_what_a_study_expects_of_all_its_runs(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Of runs that say 1, 2 and 6: quantities, and numbers of verdicts, by any statistic."""
    titles = ("fine", "also fine", "late")
    mean = {"scalar": "mean of p", "value": 3.0, "rtol": 1e-12}
    error = {"scalar": "mean of p", "statistic": "standard_error", "value": (7.0 / 3.0) ** 0.5, "rtol": 1e-12}
    smallest = {"scalar": "volume_ratio", "statistic": "smallest", "at_least": 1.25}
    path = study(tmp_path, *titles, scalars=["volume_ratio", "steps"], expect=[smallest])
    assert over_runs(np.array([1.0, 2.0, 6.0]), "largest") == 6.0
    rows_of = [
        Row(number, "", {}, Ending("done"), {"mean of p": value, "volume_ratio": 1.25}, RunFiles.of(tmp_path, ""))
        for number, value in enumerate([1.0, 2.0, 6.0])
    ]
    wanted = [ExpectedOverRuns.model_validate(given) for given in (mean, error)]
    columns = ["mean of p", "mean of p"]
    table = StudyTable("T", tmp_path, (), ("mean of p", "volume_ratio"), tuple(rows_of))
    assert all(found["passed"] for found in over_runs_verdicts(wanted, columns, table))
    lacking = StudyTable("T", tmp_path, (), table.scalars, (*rows_of, replace(rows_of[0], scalars={})))
    assert not any(found["passed"] for found in over_runs_verdicts(wanted, columns, lacking))
    assert run_batch(path, out=tmp_path / "out", jobs=2) == 0
    assert "smallest over 3 runs of volume_ratio: 1.25 (at least 1.25): passed" in capfd.readouterr().out
    name = "smallest over 3 runs of volume_ratio"
    assert expected(tmp_path / "out") == [{"quantity": name, "computed": 1.25, "at_least": 1.25, "passed": True}]
    # Finished runs are kept, the verdict is new.
    path = study(tmp_path, *titles, scalars=["volume_ratio"], expect=[{**smallest, "at_least": 1.5}])
    assert run_batch(path, out=tmp_path / "out", jobs=2, quiet=True) == 1
    assert "1.25 (at least 1.5): FAILED" in capfd.readouterr().err
    assert expected(tmp_path / "out") == [{"quantity": name, "computed": 1.25, "at_least": 1.5, "passed": False}]
    # With a run that has failed there is nothing to judge, and what was judged before is void.
    path = study(tmp_path, *titles, "diverges", scalars=["volume_ratio"], expect=[smallest])
    assert run_batch(path, out=tmp_path / "out", jobs=2) == 3
    assert "passed" not in capfd.readouterr().out
    name = "smallest over 4 runs of volume_ratio"
    assert expected(tmp_path / "out") == [{"quantity": name, "computed": None, "at_least": 1.25, "passed": None}]


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize(("bound", "code", "words"), [(1.0, 0, "2 runs, all done"), (2.0, 1, "1 of 1 expectations")])
def test_a_batch_that_goes_on_judges_again(tmp_path: Path, bound: float, code: int, words: str) -> None:
    """A run was killed: nothing is judged. In the next call it ends well, and all are."""
    titles, out = ("fine", "killed"), tmp_path / "out"
    expect = [{"scalar": "volume_ratio", "at_least": bound}]
    path = study(tmp_path, *titles, scalars=["volume_ratio"], expect=expect)
    page = BatchPage()
    assert run_batch(path, out=out, jobs=2, page=page) == 3
    assert [found["passed"] for found in expected(out)] == [None]
    assert "not yet" in (out / "index.html").read_text(encoding="utf-8")
    for _ in range(2):
        assert run_batch(path, out=out, jobs=2, page=page) == code
        assert [(found["computed"], found["passed"]) for found in expected(out)] == [(1.25, code == 0)]
        text = (out / "index.html").read_text(encoding="utf-8")
        assert words in text
        assert ("FAILED" in text) == (code == 1)


@pytest.mark.usefixtures("fake")
def test_a_number_that_is_missing_fails(tmp_path: Path) -> None:
    out = tmp_path / "out"
    expect = [{"scalar": "max_displacement", "at_most": 1.0}]
    path = study(tmp_path, "a", "b", scalars=["max_displacement"], expect=expect)
    assert run_batch(path, out=out, jobs=2) == 1
    assert [(found["computed"], found["passed"]) for found in expected(out)] == [(None, False)]


@pytest.mark.usefixtures("fake")
def test_finished_runs_are_kept_wherever_they_stand_in_the_study(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run_batch(study(tmp_path, "a", "expectation"), out=out, jobs=2) == 1
    first = {row["title"]: row for row in rows(out)}
    before = {name: (out / "runs" / first[name]["run"] / "result.json").stat().st_mtime_ns for name in first}
    assert run_batch(study(tmp_path, "new", "expectation", "a"), out=out, jobs=2, retry=True) == 1
    second = {row["title"]: row for row in rows(out)}
    assert list(second) == ["new", "expectation", "a"]
    for name in first:
        assert second[name]["run"] == first[name]["run"]
        assert second[name]["seconds"] == first[name]["seconds"]
        assert (out / "runs" / first[name]["run"] / "result.json").stat().st_mtime_ns == before[name]
    manifest = json.loads((out / "study.json").read_text())
    assert [run["run"] for run in manifest["runs"]] == [row["run"] for row in second.values()]
    assert manifest["runs"][0]["set"] == ['title="new"']


@pytest.mark.usefixtures("fake")
def test_failed_runs_are_made_again_on_request_and_from_their_start(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    path = study(tmp_path, "diverges", "segfault", "a")
    run_batch(path, out=out)
    traces = [out / "runs" / row["run"] / "trace" for row in rows(out)]
    for trace in traces:
        trace.touch()
    assert run_batch(path, out=out) == 3
    assert all(trace.exists() for trace in traces)
    assert "(title=segfault): crashed" in capfd.readouterr().err
    assert run_batch(path, out=out, retry=True) == 3
    assert [trace.exists() for trace in traces] == [False, False, True]
    assert set(logs(out).values()) == {"begun"}


@pytest.mark.usefixtures("fake")
def test_a_killed_run_goes_on_without_being_asked(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    path = study(tmp_path, "killed", "a")
    assert run_batch(path, out=out) == 3
    assert statuses(out) == {"killed": "killed", "a": "done"}
    assert "SIGKILL" in capfd.readouterr().err
    assert run_batch(path, out=out, quiet=True) == 0
    assert statuses(out) == {"killed": "done", "a": "done"}
    log = (out / "runs" / f"{rows(out)[0]['run']}.log").read_text()
    assert log.split() == ["begun", "resumed"]
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("fake")
def test_what_a_killed_batch_leaves_goes_on(tmp_path: Path) -> None:
    """Nobody wrote down how these ended: with a checkpoint they go on, else they begin again."""
    out = tmp_path / "out"
    path = study(tmp_path, "a", "b", "c")
    run_batch(path, out=out)
    for row, status in zip(rows(out), ("running", "interrupted", "running"), strict=True):
        files = RunFiles.of(out, row["run"])
        files.record.unlink()
        (files.folder / "result.json").write_text(json.dumps({"status": status}))
        if row["title"] == "c":
            (files.folder / "checkpoint.h5").unlink()
    assert run_batch(path, out=out) == 0
    lines = [(out / "runs" / f"{row['run']}.log").read_text().split() for row in rows(out)]
    assert lines == [["begun", "resumed"], ["begun", "resumed"], ["begun"]]


@pytest.mark.usefixtures("fake")
def test_equal_scenes_are_run_once_and_shown_twice(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run_batch(study(tmp_path, "a", "b", "a"), out=out) == 0
    assert [row["title"] for row in rows(out)] == ["a", "b", "a"]
    assert rows(out)[0]["run"] == rows(out)[2]["run"]
    assert len(list((out / "runs").glob("*.log"))) == 2
    captured = capfd.readouterr()
    assert "run 3 is the same scene as run 1" in captured.err
    assert "2 runs: 2 done" in captured.out


def test_a_process_that_cannot_be_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Task, "command", lambda task, resume: [str(tmp_path / "no such program")])
    out = tmp_path / "out"
    assert run_batch(study(tmp_path, "a"), out=out) == 3
    assert rows(out)[0]["reason"] == "the process cannot be started: No such file or directory"


# ------------------------------------------------------------------------------------------------- folders


@pytest.mark.usefixtures("fake")
def test_where_results_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deep").mkdir()
    assert run_batch(study(tmp_path / "deep", "a")) == 0
    assert rows(tmp_path / "results" / "study")
    assert run_batch(study(tmp_path / "deep", "a", out="beside")) == 0
    assert rows(tmp_path / "deep" / "beside")


@pytest.mark.usefixtures("fake")
def test_another_result_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "index.csv").write_text("mine")
    with pytest.raises(InputError, match="holds something other than a batch"):
        run_batch(study(tmp_path, "a"), out=tmp_path)
    assert (tmp_path / "index.csv").read_text() == "mine"
    assert not (tmp_path / "runs").exists()


def test_bad_input_leaves_nothing_behind(tmp_path: Path) -> None:
    path = study(tmp_path, "a", set={"conditions[0].on": "b.lft"})
    with pytest.raises(InputError, match="no group `lft`"):
        run_batch(path, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("fake")
def test_two_batches_do_not_share_a_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    path = study(tmp_path, "a")
    run_batch(path, out=out)
    with (out / ".lock").open("ab") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another batch"):
            run_batch(path, out=out)
    assert run_batch(path, out=out) == 0


@pytest.mark.usefixtures("fake")
def test_a_run_that_outlived_its_batch_is_left_alone(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    path = study(tmp_path, "a", "b")
    run_batch(path, out=out)
    files = RunFiles.of(out, rows(out)[0]["run"])
    files.record.unlink()
    (files.folder / "result.json").write_text(json.dumps({"status": "running"}))
    with files.log.open("ab") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert run_batch(path, out=out) == 3
    assert statuses(out) == {"a": "running", "b": "done"}
    assert "still at it" in capfd.readouterr().err
    assert files.log.read_text() == "begun\n"
    assert run_batch(path, out=out) == 0


@pytest.mark.usefixtures("fake")
def test_a_full_disk_ends_the_batch_and_its_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    path = study(tmp_path, "a", "waits", "b")
    write_csv = batch.Index.write_csv

    def full(index: batch.Index) -> None:
        if any(row.ending.status == "done" for row in index.table().rows):
            raise OutputError("cannot write index.csv: the disk is full")
        write_csv(index)

    with monkeypatch.context() as patch:
        patch.setattr(batch.Index, "write_csv", full)
        with pytest.raises(OutputError, match="disk is full"):
            run_batch(path, out=out, jobs=2)
    assert run_batch(path, out=out) == 0
    assert logs(out) == {"a": "begun", "waits": "begun", "b": "begun"}


# ------------------------------------------------------------------------------------------------- page


class Drawing:
    """A page that notes what it is asked for."""

    def __init__(self, error: Exception | None = None) -> None:
        self.drawn: list[str] = []
        self.tables: list[StudyTable] = []
        self.error = error

    def draw(self, result: Path, picture: Path) -> None:
        if self.error is not None:
            raise self.error
        self.drawn.append(result.name)
        picture.touch()

    def write(self, table: StudyTable) -> Path:
        self.tables.append(table)
        return table.out / "index.html"


@pytest.mark.usefixtures("fake")
def test_pictures_are_drawn_once(tmp_path: Path) -> None:
    page = Drawing()
    path = study(tmp_path, "a", "diverges")
    run_batch(path, out=tmp_path / "out", page=page)
    assert sorted(page.drawn) == sorted(row["run"] for row in rows(tmp_path / "out"))
    assert [row.ending.status for row in page.tables[-1].rows] == ["done", "not_converged"]
    page.drawn.clear()
    run_batch(path, out=tmp_path / "out", page=page)
    assert page.drawn == []
    run_batch(path, out=tmp_path / "out", page=page, retry=True)
    assert page.drawn == [rows(tmp_path / "out")[1]["run"]]


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize("error", [InputError("no frames"), RuntimeError("VTK"), MemoryError()])
def test_a_picture_that_cannot_be_drawn_is_no_failure(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], error: Exception
) -> None:
    assert run_batch(study(tmp_path, "a"), out=tmp_path / "out", page=Drawing(error)) == 0
    assert "note: no picture of" in capfd.readouterr().err


# ------------------------------------------------------------------------------------------------- stopping


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_stop_the_batch_and_let_it_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], number: signal.Signals
) -> None:
    out = tmp_path / "out"
    path = study(tmp_path, "a", "waits", "b")
    sent: list[signal.Signals] = []
    wait = time.sleep

    def sleep(seconds: float) -> None:
        # Once: another one may come when the batch no longer hears.
        if not sent and len(list((out / "runs").glob("*/checkpoint.h5"))) == 2:
            sent.append(number)
            os.kill(os.getpid(), number)
        wait(seconds)

    monkeypatch.setattr(time, "sleep", sleep)
    before = signal.getsignal(number)
    assert run_batch(path, out=out, jobs=1) == 130
    assert signal.getsignal(number) is before
    assert statuses(out) == {"a": "done", "waits": "interrupted", "b": "waiting"}
    assert "goes on from here" in capfd.readouterr().err


@pytest.mark.usefixtures("fake")
def test_a_run_that_does_not_end_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_process, "GRACE", 0.2)
    deaf = FAKE.replace("def stop(number, frame): result", "def stop(number, frame): return; result")
    out = tmp_path / "out"
    command = Task.command
    monkeypatch.setattr(Task, "command", lambda task, resume: [deaf if a == FAKE else a for a in command(task, resume)])
    stop = batch_process.Stop()
    task = Task("x", tmp_path / "s.yaml", ('title="waits"',), RunFiles.of(out, "x"), 1)
    (out / "runs").mkdir(parents=True)
    endings = batch_process.run_here([task], 1, stop)
    wait = time.sleep

    def sleep(seconds: float) -> None:
        stop.count = int((out / "runs" / "x" / "checkpoint.h5").exists())
        wait(seconds)

    monkeypatch.setattr(time, "sleep", sleep)
    ((_, ending),) = endings
    assert ending.status == "interrupted"
    assert ending.exit_code == -signal.SIGKILL


def n_lines(path: Path) -> int:
    return path.read_bytes().count(b"\n")


def test_ctrl_c_for_real(
    tmp_path: Path, start: Callable[..., subprocess.Popen[str]], cli: Callable[..., Process]
) -> None:
    """Two real runs of many steps: both save what they have, and the same command finishes them."""
    n_steps = 3000
    write(small(output={"every": n_steps}), tmp_path / "scene.yaml")
    # Kernels compiled beforehand: else one run may end while the other one still waits for its kernels.
    assert cli("run", tmp_path / "scene.yaml", "--quiet").returncode == 0
    sweep = {"grid": {"bodies.b.material.youngs_modulus": [1e5, 2e5]}}
    path = write({"scene": "scene.yaml", "set": {"time.dt": 1 / n_steps}, "sweep": sweep}, tmp_path / "study.yaml")
    process = start("batch", path, "--jobs", 2)
    deadline = time.monotonic() + 120
    while sum(n_lines(path) > 20 for path in tmp_path.glob("results/study/runs/*/history.csv")) < 2:
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    out = tmp_path / "results" / "study"
    assert process.returncode == 130
    assert [row["status"] for row in rows(out)] == ["interrupted", "interrupted"]
    assert "2 runs: 2 interrupted" in error
    assert "Traceback" not in error
    assert (out / "index.html").exists()
    steps = [json.loads((out / "runs" / row["run"] / "result.json").read_text())["steps"] for row in rows(out)]
    assert all(0 < n < n_steps for n in steps)
    done = cli("batch", path, "--jobs", 2, "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert [row["steps"] for row in rows(out)] == [str(n_steps)] * 2
    assert float(rows(out)[0]["max_displacement"]) == pytest.approx(
        2 * float(rows(out)[1]["max_displacement"]), rel=0.05
    )


# ------------------------------------------------------------------------------------------------- command, ranks


def test_the_command(tmp_path: Path, cli: Callable[..., Process]) -> None:
    write(small(expect={"max_displacement": {"at_most": 1e-6}}), tmp_path / "scene.yaml")
    listed = [{"bodies.b.mesh.cells": [4, 1]}, {"solver.max_iterations": 1}]
    path = write({"scene": "scene.yaml", "sweep": {"list": listed}}, tmp_path / "study.yaml")
    done = cli("batch", path, "--out", "out")
    assert done.returncode == 3, done.stderr
    assert [row["status"] for row in rows(tmp_path / "out")] == ["expectation_failed", "not_converged"]
    assert rows(tmp_path / "out")[0]["bodies.b.mesh.cells"] == "[4, 1]"
    assert rows(tmp_path / "out")[0]["solver.max_iterations"] == ""
    assert re.search(r"run 2 \(max_iterations=1\): not converged, [0-9.]+ s: step 1 .*\.log\n", done.stderr)
    assert (tmp_path / "out" / "index.html").read_text().count('<img alt="last frame') == 2
    bad = cli("batch", path, "--jobs", "0")
    assert bad.returncode == 2
    assert "must be a positive whole number" in bad.stderr


@pytest.mark.mpi
def test_ranks_make_the_runs(tmp_path: Path, two_ranks: Callable[..., Process]) -> None:
    """Two of three ranks start serial runs, PETSc and all, which take no notice of the launcher."""
    write({**small(), "linear_solver": {"method": "ksp"}}, tmp_path / "scene.yaml")
    sweep = {"grid": {"bodies.b.material.youngs_modulus": [1e5, 2e5, 3e5]}}
    path = write({"scene": "scene.yaml", "sweep": sweep}, tmp_path / "study.yaml")
    done = two_ranks("-m", "femdeform", "batch", path, ranks=3)
    assert done.returncode == 0, done.stderr
    table = rows(tmp_path / "results" / "study")
    assert [row["status"] for row in table] == ["done"] * 3
    for row in table:
        facts = json.loads((tmp_path / "results" / "study" / "runs" / row["run"] / "result.json").read_text())
        assert facts["ranks"] == 1
    refused = two_ranks("-m", "femdeform", "batch", "nothing.yaml", ranks=3)
    assert refused.returncode == 2
    assert refused.stderr.count("there is no such file") == 1


def test_the_environment_of_a_serial_run() -> None:
    launcher = {"OMPI_COMM_WORLD_SIZE": "3", "PMIX_RANK": "1", "PMI_SIZE": "3", "PRTE_X": "", "HYDI_CONTROL_FD": "7"}
    own = {"PATH": "/bin", "OMP_NUM_THREADS": "1", "PYTHONPATH": "x", "FEMDEFORM_THREADS": "2"}
    assert serial_environment({**launcher, **own}) == own


@pytest.mark.parametrize(
    ("code", "facts", "expected"),
    [
        (0, {"status": "done"}, "done"),
        (0, {"status": "running"}, "crashed"),
        (0, {}, "crashed"),
        (2, {}, "failed"),
        (130, {}, "interrupted"),
        (130, {"status": "running"}, "interrupted"),
        (-signal.SIGTERM, {"status": "interrupted"}, "interrupted"),
        (2, {"status": "interrupted"}, "failed"),
        (70, {"status": "interrupted"}, "crashed"),
        (-signal.SIGSEGV, {"status": "interrupted"}, "crashed"),
        (-signal.SIGTERM, {"status": "running"}, "killed"),
        (-signal.SIGBUS, {"status": "running"}, "crashed"),
        (-signal.SIGKILL, {"status": "expectation_failed"}, "expectation_failed"),
    ],
)
def test_judgement(tmp_path: Path, code: int, facts: dict[str, str], expected: str) -> None:
    ending = judge(code, facts, tmp_path / "no.log", 1.5)
    assert (ending.status, ending.exit_code, ending.seconds) == (expected, code, 1.5)
    assert ending.status in ("done", "expectation_failed", "interrupted") or ending.reason


def test_the_reason_of_a_bug_is_the_error_not_the_note_below_it(tmp_path: Path) -> None:
    log = tmp_path / "x.log"
    log.write_text(f"Traceback (most recent call last):\n  ...\nKeyError: 'x'\n{BUG_NOTE}\n")
    assert judge(70, {}, log, 1.0).reason == "KeyError: 'x'"


def test_a_record_survives_what_is_not_one(tmp_path: Path) -> None:
    files = RunFiles.of(tmp_path, "x")
    files.record.parent.mkdir()
    assert files.ending() == Ending("waiting")
    ending = Ending("crashed", "why", -11, 2.0)
    files.write_record(ending)
    assert files.ending() == ending
    for text in ("", "[]", '{"status": 3, "other": 1}', "{}"):
        files.record.write_text(text)
        assert files.ending() == Ending("waiting")
