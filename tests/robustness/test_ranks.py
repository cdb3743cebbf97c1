"""Runs on two MPI ranks that end early: one end for all, a result that says why, nothing lost up to a checkpoint."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from running import facts, rolling
from scenario import write

from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.result import Result
from femdeform.run.runner import run_scene

pytestmark = pytest.mark.mpi

Ranks = Callable[..., subprocess.CompletedProcess[str]]
RUN = ("-m", "femdeform", "run", "s.yaml", "--trace", "--out")

# At one moment of step 7, one rank does something unexpected; the other goes on to where the ranks meet.
STRUCK = """\
import os, signal, sys, time
from pathlib import Path
from femdeform import cli
from femdeform.errors import MissingDependencyError
from femdeform.parallel import launched_rank
from femdeform.run import inputs, runner
from solvers.projected_newton import ProjectedNewton

step = ProjectedNewton.step
calls = 0

def struck(self, *arguments, **options):
    global calls
    calls += 1
    if calls == 7 and launched_rank() == RANK:
        Path("when").write_text(str(time.time()))
        DEED
    return step(self, *arguments, **options)

ProjectedNewton.step = struck
sys.exit(cli.main(["run", "s.yaml", "--trace", "--out", "out"]))
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Twelve steps with a checkpoint every fourth."""
    return write(rolling({"method": "ksp"}, steps=12), tmp_path / "s.yaml")


def strike(tmp_path: Path, two_ranks: Ranks, rank: int, deed: str) -> subprocess.CompletedProcess[str]:
    """Run with a deed on one rank; neither rank may wait for the other for ever."""
    (tmp_path / "struck.py").write_text(STRUCK.replace("RANK", str(rank)).replace("DEED", deed))
    done = two_ranks("struck.py", timeout=120.0)
    assert time.time() - float((tmp_path / "when").read_text()) < 30.0
    return done


def resume(tmp_path: Path, two_ranks: Ranks) -> None:
    """On two ranks the run goes on to the answer of one rank."""
    resumed = two_ranks(*RUN, "out", "--resume")
    assert resumed.returncode == 0, resumed.stderr
    result = Result.open(tmp_path / "out")
    assert (result.facts["status"], result.facts["ranks"]) == ("done", 2)
    assert list(result.history["step"]) == list(range(1, 13))
    assert run_scene(tmp_path / "s.yaml", out=tmp_path / "one", quiet=True) == 0
    ours, theirs = read_checkpoint(tmp_path / "one"), read_checkpoint(tmp_path / "out")
    assert (ours.step, ours.frames) == (theirs.step, theirs.frames)
    np.testing.assert_allclose(theirs.fields["x"], ours.fields["x"], rtol=0.0, atol=1e-7)
    assert not list((tmp_path / "out").rglob(".*"))


@pytest.mark.parametrize("rank", [0, 1])
def test_a_killed_rank(rank: int, scene: Path, tmp_path: Path, two_ranks: Ranks) -> None:
    """Nobody can say why; the launcher tells the other rank to end, and what was written stays."""
    done = strike(tmp_path, two_ranks, rank, "os.kill(os.getpid(), signal.SIGKILL)")
    assert done.returncode not in (0, 1, 2, 3, 4, 70)
    assert "Traceback" not in done.stderr
    result = Result.open(tmp_path / "out")
    ends = [("running", ""), ("interrupted", "interrupted by the user, or by the launcher")]
    assert (result.facts["status"], result.facts["reason"]) in (ends if rank == 1 else ends[:1])
    assert list(result.history["step"]) == list(range(1, 7))
    assert len(result.frames) == 3
    assert read_checkpoint(tmp_path / "out").step == 4
    if rank == 1:
        resume(tmp_path, two_ranks)
        # What two ranks began, one can go on with; here there is nothing left to do.
        assert run_scene(scene, out=tmp_path / "out", resume=True) == 0


SIGNALS = {
    "SIGTERM to one": (1, "os.kill(os.getpid(), signal.SIGTERM)", (130,)),
    "SIGINT to the first": (0, "os.kill(os.getpid(), signal.SIGINT)", (130,)),
    # The exit code is then the launcher's own.
    "SIGTERM to the launcher": (1, "os.kill(os.getppid(), signal.SIGTERM); time.sleep(3.0)", (1, 130, 143)),
}


@pytest.mark.parametrize("case", SIGNALS)
def test_signals(case: str, scene: Path, tmp_path: Path, two_ranks: Ranks) -> None:
    """Whichever rank hears it, all stop at the same step and save it together."""
    rank, deed, codes = SIGNALS[case]
    done = strike(tmp_path, two_ranks, rank, deed)
    assert done.returncode in codes
    assert "Traceback" not in done.stderr
    result = Result.open(tmp_path / "out")
    assert result.facts["status"] == "interrupted"
    assert result.facts["reason"].startswith("interrupted by the user")
    if "launcher" not in case:
        # A launcher that was told to end may leave no time for the rest.
        assert result.facts["steps"] == 7
        assert done.stderr.count("go on with --resume from step 7") == 1
        assert read_checkpoint(tmp_path / "out").step == 7
        assert (tmp_path / "out" / "final.vtu").exists()
    if "first" not in case:
        resume(tmp_path, two_ranks)


ERRORS = {
    "a bug": (1, "raise RuntimeError('the memory of this rank is wrong')", 70),
    "an error": (0, "raise MissingDependencyError('the memory of this rank is wrong')", 4),
    "no memory": (1, "raise MemoryError('the memory of this rank is wrong')", 4),
}


@pytest.mark.parametrize("case", ERRORS)
def test_an_error_on_one_rank_ends_all(case: str, scene: Path, tmp_path: Path, two_ranks: Ranks) -> None:
    rank, deed, code = ERRORS[case]
    done = strike(tmp_path, two_ranks, rank, deed)
    assert done.returncode == code
    result = facts(tmp_path / "out")
    assert (result["status"], result["steps"]) == ("failed", 6)
    assert result["reason"].startswith(f"rank {rank}: ")
    assert "the memory of this rank is wrong" in result["reason"]
    if code == 70:
        assert done.stderr.count("Traceback") == 1
        assert done.stderr.count("RuntimeError: the memory of this rank is wrong") == 1
        assert done.stderr.count("femdeform: this is a bug in femdeform") == 1
    else:
        assert "Traceback" not in done.stderr
        assert done.stderr.count(f"femdeform: {result['reason']}\n") == 1
    if case == "a bug":
        resume(tmp_path, two_ranks)


def test_a_bug_while_reading_ends_all(scene: Path, tmp_path: Path, two_ranks: Ranks) -> None:
    """Rank 0 alone reads: the others must not wait for what will never come."""
    (tmp_path / "broken.py").write_text(
        "import sys\nfrom femdeform import cli\nfrom femdeform.run import inputs\n"
        "def load(*_):\n    raise RuntimeError('a bug in reading')\n"
        "inputs.load_scene = load\nsys.exit(cli.main(['run', 's.yaml', '--out', 'out']))\n"
    )
    done = two_ranks("broken.py", timeout=60.0)
    assert done.returncode == 70
    assert done.stderr.count("RuntimeError: a bug in reading") == 1
    assert not (tmp_path / "out").exists()


def test_a_folder_nobody_can_write_to(scene: Path, tmp_path: Path, two_ranks: Ranks) -> None:
    (tmp_path / "out").write_text("mine")
    done = two_ranks(*RUN, "out", timeout=60.0)
    assert done.returncode == 4
    assert done.stderr.count("femdeform: cannot write out: there is a file of that name, not a folder\n") == 1
    assert (tmp_path / "out").read_text() == "mine"
