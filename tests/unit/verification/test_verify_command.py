"""`femdeform verify` as a command: exit codes, what it prints, what a kill leaves."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from femdeform.cli import main
from verification import verify
from verification.case import shipped_cases

Case = Callable[..., Path]
Cli = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("band", "code", "last"), [("[1.8, 2.2]", 0, "1 of 1"), ("[2.5, 3.0]", 1, "0 of 1")], ids=["inside", "outside"]
)
def test_exit_code_and_table(
    band: str,
    code: int,
    last: str,
    case: Case,
    refinement: Callable[..., str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = case(refinement(f"{{l2: {{rate: {band}}}}}"))
    assert main(["verify", str(folder)]) == code
    out, err = capsys.readouterr()
    assert out.splitlines()[-1] == f"{last} judgements inside their band; results/verify/index.html"
    assert out.splitlines()[1].startswith("trial: A trial (")
    assert ("FAILED p1, l2, 3: the rate is" in out) == (code == 1)
    assert len(lines_from(err, "trial p1 ")) == 3
    assert json.loads(Path("results/verify/verify.json").read_text())["status"] == ("failed" if code else "passed")


def lines_from(text: str, start: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith(start)]


def test_quiet(case: Case, refinement: Callable[..., str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(case(refinement("{l2: {rate: [1.8, 2.2]}}"))), "--quiet", "--out", "there"]) == 0
    out, err = capsys.readouterr()
    assert (out, err) == ("1 of 1 judgements inside their band; there/index.html\n", "")


def test_a_run_that_does_not_converge_is_a_failed_judgement(
    case: Case, refinement: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    more = "    set: {solver.max_iterations: 1, on_failure.action: stop}\n"
    assert main(["verify", str(case(refinement("{l2: {rate: [1.8, 2.2]}}", more=more)))]) == 1
    out, err = capsys.readouterr()
    assert "FAILED p1, l2, 1: step 1 to t = 1 s failed" in out
    assert "Traceback" not in out + err


def test_bad_input_of_all_cases_comes_before_anything_runs(
    case: Case, refinement: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    sound = case(refinement("{l2: {rate: [1.8, 2.2]}}"), name="sound")
    first = case(refinement("{l2: {rat: [1.8, 2.2]}}"), name="first")
    second = case(refinement("{middel: {at_most: 1}}"), name="second")
    assert main(["verify", str(sound), str(first), str(second)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "first/study.yaml:11: studies.p1.quantities.l2.rat: unknown key; did you mean `rate`?" in err
    assert "second/study.yaml:11: studies.p1.quantities.middel: " in err
    assert not Path("results").exists()


def test_unknown_cases(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", "manufacture", "nowhere"]) == 2
    err = capsys.readouterr().err
    assert "no case and no folder `manufacture`; did you mean `manufactured`?" in err
    assert "`nowhere`" in err


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(shipped_cases())
    assert "manufactured" in shipped_cases()
    assert all(len(line.split(maxsplit=1)[1]) > 5 for line in lines)


def test_several_ranks_are_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(verify.parallel, "launched_ranks", lambda: 2)
    assert main(["verify", "patch"]) == 2
    assert "verify runs on one rank" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written(
    case: Case, refinement: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("taken").write_text("a file")
    assert main(["verify", str(case(refinement("{l2: {rate: [1.8, 2.2]}}"))), "--out", "taken"]) == 4
    assert "cannot write taken" in capsys.readouterr().err


def test_a_folder_with_files_of_others_is_left_alone(
    case: Case, refinement: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = case(refinement("{l2: {rate: [1.8, 2.2]}}"))
    before = sorted(path.name for path in folder.parent.rglob("*"))
    assert main(["verify", str(folder), "--out", str(folder.parent)]) == 2
    assert "holds files that are not of a verification" in capsys.readouterr().err
    assert sorted(path.name for path in folder.parent.rglob("*")) == before


@pytest.mark.slow
def test_a_killed_verification_leaves_the_cases_that_were_done(
    case: Case, refinement: Callable[..., str], start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    quick = case(refinement("{l2: {rate: [1.8, 2.2]}}"), name="quick")
    endless = case(
        refinement("{l2: {rate: [1.8, 2.2]}}", more="    set: {time.dt: 1.0e-7}\n"),
        name="endless",
    )
    process = start("verify", quick, endless, "--out", "out")
    facts, page = tmp_path / "out" / "verify.json", tmp_path / "out" / "index.html"
    give_up = time.monotonic() + 120.0
    while process.poll() is None and time.monotonic() < give_up:
        # The page is what is written last as a case ends.
        if page.exists() and "1 of 2 cases" in page.read_text(encoding="utf-8"):
            break
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGKILL)
    process.wait(timeout=30)
    found = json.loads(facts.read_text(encoding="utf-8"))
    assert (found["status"], [item["name"] for item in found["cases"]]) == ("running", ["quick"])
    assert {path.name for path in (tmp_path / "out" / "quick").iterdir()} == {"errors.csv", "rates.json", "p1.png"}
    assert "1 of 2 cases" in page.read_text(encoding="utf-8")
