"""Cases of benchmarks: each is kept as soon as it is done, one that breaks is named, and the others go on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from femdeform.errors import InputError
from femdeform.run.interrupts import Interrupts
from verification.benchmarks import cases, child_process, environment, newton, run
from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome
from verification.benchmarks.tables import Findings, Table

Case = Mapping[str, Any]


@pytest.fixture(autouse=True)
def small_and_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEMDEFORM_THREADS", "1")
    monkeypatch.setenv(environment.CELLS_VARIABLE, "2")
    monkeypatch.delenv(environment.ONLY_VARIABLE, raising=False)


@pytest.fixture
def no_process(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[Case], Outcome]], None]:
    """Have a function answer for the process of each case."""

    def replace(answer: Callable[[Case], Outcome]) -> None:
        monkeypatch.setattr(child_process, "run_module", lambda module, case, *_: answer(case))
        monkeypatch.setattr(child_process, "run_script", lambda python, script, case: answer(case))
        monkeypatch.setattr(cases, "peers_python", lambda: (Path(sys.executable), ""))

    return replace


def read(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "bench.json").read_text(encoding="utf-8"))
    return document


def commands_with(text: str) -> list[str]:
    """Command lines of processes that have a text in them; none where there is no /proc."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            found.append(path.read_bytes().decode(errors="replace"))
    return [command for command in found if text in command]


def sweep(case: Case) -> Outcome:
    """What a case of sweeps answers, and the one that writes a state for others."""
    times = {"median": 1.0, "min": 1.0, "max": 1.0, "n": 5}
    more = {"n_cells": 40, "colors": 6, "set_up": times, "memory": 10**8, "reached": [[1.0] * 3] * 3}
    return Outcome("done", {"time": times, **more})


@pytest.mark.parametrize("name", run.BENCHMARKS)
def test_tables_can_be_made_after_every_case(
    name: str,
    no_process: Callable[[Callable[[Case], Outcome]], None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """All cases break: each is kept at once and named, and the next one begins."""
    kept: list[list[str]] = []
    keep = run.Results.keep

    def keep_and_look(results: run.Results, name: str, findings: Findings) -> None:
        keep(results, name, findings)
        assert list(read(tmp_path)["benchmarks"]) == [name]
        kept.append(read(tmp_path)["unfinished"])

    n_begun = 0

    def breaks(case: Case) -> Outcome:
        nonlocal n_begun
        n_begun += 1
        return Outcome("failed", {}, "it broke")

    no_process(breaks)
    monkeypatch.setattr(run.Results, "keep", keep_and_look)
    assert run.run_benchmarks([name], tmp_path) == 1
    printed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("failed: ")]
    printed = [line for line in printed if line == line.rstrip()]  # lines of notes below tables are padded
    while_running = [line for line in printed if not line.startswith(f"failed: {name}: ")]
    assert all(line.endswith(": it broke") for line in while_running)
    # What writes a state for other codes is no case of its own.
    assert n_begun - 1 <= len(while_running) <= n_begun
    assert len(kept) > len(while_running) > 3
    assert kept[-1] == []
    assert all(unfinished == [name] for unfinished in kept[:-1])
    assert "Failed: " in (tmp_path / "bench.md").read_text(encoding="utf-8")


def test_a_benchmark_that_is_ended_keeps_what_it_has(
    no_process: Callable[[Callable[[Case], Outcome]], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(environment.ONLY_VARIABLE, "sweeps: neo_hookean; steps")
    seen: list[Case] = []

    def answer(case: Case) -> Outcome:
        seen.append(case)
        if case["kind"] == "steps":
            raise KeyboardInterrupt
        return sweep(case)

    no_process(answer)
    with pytest.raises(KeyboardInterrupt):
        run.run_benchmarks(["xpbd", "mpm"], tmp_path)
    assert (read(tmp_path)["unfinished"], list(read(tmp_path)["benchmarks"])) == (["mpm"], ["xpbd"])
    assert len(read(tmp_path)["benchmarks"]["xpbd"]["sweeps"]) == len(seen) - 1 == 4
    no_process(lambda case: answer({**case, "kind": "steps"}) if case["method"] == "fp_pxpbd, 1 local" else sweep(case))
    with pytest.raises(KeyboardInterrupt):
        run.run_benchmarks(["xpbd", "mpm"], tmp_path)
    document = read(tmp_path)
    assert [row["method"] for row in document["benchmarks"]["xpbd"]["sweeps"]] == ["xpbd", "b_pxpbd"]
    assert document["unfinished"] == ["xpbd", "mpm"]
    page = (tmp_path / "bench.md").read_text(encoding="utf-8")
    assert "Not finished: xpbd, mpm." in page
    assert "| b_pxpbd, neo_hookean | 1 s [1 s, 1 s] |" in page


def test_a_signal_ends_the_case_that_runs(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a process: exit code 130, the first cases are kept, nothing goes on in the background."""
    scratch, out = tmp_path / "scratch", tmp_path / "out"
    scratch.mkdir()
    monkeypatch.setenv("TMPDIR", str(scratch))
    process = start("bench", "xpbd", "--out", out)
    deadline = time.monotonic() + 300.0
    while not (out / "bench.json").exists() and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.05)
    while not list(scratch.iterdir()) and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.005)
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate(timeout=60.0)
    assert process.returncode == 130, error
    document = read(out)
    assert document["unfinished"] == ["xpbd"]
    assert {row["status"] for row in document["benchmarks"]["xpbd"]["sweeps"]} == {"done"}
    assert list(scratch.iterdir()) == []
    assert not commands_with(str(scratch))


@pytest.mark.parametrize("moment", ["before", "after"])
def test_a_signal_while_a_case_is_started_leaves_nothing_behind(
    moment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes as the process begins, and whoever started it has not been handed it yet."""
    started = []
    popen = subprocess.Popen

    def start_and_signal(*arguments: Any, **options: Any) -> subprocess.Popen[str]:
        if moment == "before":
            os.kill(os.getpid(), signal.SIGTERM)
        started.append(popen(*arguments, **options))
        if moment == "after":
            os.kill(os.getpid(), signal.SIGTERM)
        return started[-1]

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(subprocess, "Popen", start_and_signal)
    with Interrupts(), pytest.raises(KeyboardInterrupt):
        child_process.run_module("verification.benchmarks.xpbd_case", {"kind": "sweep"}, 1)
    assert [process.poll() for process in started] == [-signal.SIGTERM]
    assert list(tmp_path.iterdir()) == []


def test_tables_are_written_before_pictures_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def draw() -> dict[str, bytes]:
        if not is_able:
            raise RuntimeError("no ink")
        return {"a.png": b"picture"}

    is_able = False
    findings = Findings("What was measured.", [Table("Times", ["", "s"], [["row", "1"]])], {"a": 1}, [], draw)
    monkeypatch.setattr(newton, "run_newton", lambda cases: findings)
    with pytest.raises(RuntimeError, match="no ink"):
        run.run_benchmarks(["newton"], tmp_path)
    assert read(tmp_path)["benchmarks"]["newton"] == {"a": 1}
    assert "a.png" not in (tmp_path / "bench.md").read_text(encoding="utf-8")
    is_able = True
    assert run.run_benchmarks(["newton"], tmp_path) == 0
    assert (tmp_path / "a.png").read_bytes() == b"picture"
    assert "![a.png](a.png)" in (tmp_path / "bench.md").read_text(encoding="utf-8")


def test_pictures_of_an_earlier_run_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that it says it drew; a rerun with other cases draws others."""
    drawn = {"a.png": b"a", "b.png": b"b"}
    findings = Findings("What was measured.", draw=lambda: drawn)
    monkeypatch.setattr(newton, "run_newton", lambda cases: findings)
    folder = tmp_path / "out"
    folder.mkdir()
    (tmp_path / "outside.png").write_bytes(b"not of this folder")
    (folder / "mine.png").write_bytes(b"not of a benchmark")
    assert run.run_benchmarks(["newton"], folder) == 0
    assert read(folder)["pictures"] == ["a.png", "b.png"]
    drawn = {"b.png": b"b again", "c.png": b"c"}
    assert run.run_benchmarks(["newton"], folder) == 0
    pictures = {path.name: path.read_bytes() for path in folder.glob("*.png")}
    assert pictures == {"b.png": b"b again", "c.png": b"c", "mine.png": b"not of a benchmark"}
    assert read(folder)["pictures"] == ["b.png", "c.png"]
    # A benchmark that does not exist starts nothing, and nothing outside of the folder is touched.
    with pytest.raises(InputError):
        run.run_benchmarks(["wrong"], folder)
    assert (folder / "b.png").exists()
    (folder / "bench.json").write_text('{"pictures": ["../outside.png", 7, "c.png"]}', encoding="utf-8")
    drawn = {}
    assert run.run_benchmarks(["newton"], folder) == 0
    assert (tmp_path / "outside.png").exists()
    assert {path.name for path in folder.glob("*.png")} == {"b.png", "mine.png"}
    (folder / "bench.json").write_text("no JSON", encoding="utf-8")
    assert run.run_benchmarks(["newton"], folder) == 0


def test_what_is_not_asked_for_is_not_run(
    no_process: Callable[[Callable[[Case], Outcome]], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also in the benchmarks whose cases depend on each other."""
    monkeypatch.setenv(environment.ONLY_VARIABLE, "two; newton-none; Beam NH")
    said: list[str] = []
    no_process(sweep)
    into: dict[int, Outcome] = {}
    runs = Cases(said.append)
    for number, name in enumerate(("one", "two", "twofold")):
        runs.run(into, number, name, "module", {"kind": "sweeps"}, reason="too large" if number == 2 else "")
    runs.peer(into, 3, "three", "script.py", {}, into[1])
    runs.peer(into, 4, "peer of two", "script.py", {}, Outcome("failed", {}, "it broke"))
    assert {number: outcome.status for number, outcome in into.items()} == {1: "done", 2: "skipped", 4: "skipped"}
    assert (into[2].reason, into[4].reason) == ("too large", "there is no state to compare at")
    assert said == ["two"]
    no_process(lambda case: Outcome("failed", {}, "it broke"))
    assert run.run_benchmarks(["newton"], tmp_path) == 0
    assert run.run_benchmarks(["mixed"], tmp_path) == 1
    assert list(read(tmp_path)["benchmarks"]["mixed"]["table"]) == ["Beam NH"]


def test_a_case_that_cannot_be_started_or_read_has_failed(tmp_path: Path) -> None:
    outcome = child_process.run_module("verification.none", {}, 1, [str(tmp_path / "no-launcher")])
    assert outcome.status == "failed"
    assert "cannot be started" in outcome.reason
    assert "no-launcher" in outcome.reason
    script = tmp_path / "script.py"
    script.write_text("import sys\nopen(sys.argv[2], 'w').write('{\"half')\n", encoding="utf-8")
    outcome = child_process.run_script(Path(sys.executable), script, {})
    assert outcome.status == "failed"
    assert "its result cannot be read" in outcome.reason
