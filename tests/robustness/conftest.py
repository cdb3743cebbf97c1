"""What the tests of this folder share: the command line in this process, an unbroken run, a disk of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from running import STEPS, Said, rolling
from scenario import write
from small_disk import Disk

from femdeform.cli import main


@pytest.fixture
def say(capfd: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """Run ``femdeform ARGUMENTS`` in this process; whatever it says is caught."""

    def run(*arguments: object) -> Said:
        capfd.readouterr()
        code = main([str(argument) for argument in arguments])
        return Said(code, *capfd.readouterr())

    return run


@pytest.fixture(scope="session")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A scene of twelve steps with frames and checkpoints, and the result of an unbroken run of it."""
    folder = tmp_path_factory.mktemp("unbroken")
    path = write(rolling(steps=STEPS), folder / "s.yaml")
    assert main(["run", str(path), "--out", str(folder / "whole"), "--trace", "--quiet"]) == 0
    return path, folder / "whole"


@pytest.fixture(scope="session")
def unbroken_process(tmp_path_factory: pytest.TempPathFactory, child_environment: dict[str, str]) -> tuple[Path, Path]:
    """The same by a process, of forty steps; its BLAS is loaded with another number of threads than ours."""
    folder = tmp_path_factory.mktemp("process")
    path = write(rolling(), folder / "s.yaml")
    command = [sys.executable, "-m", "femdeform", "run", str(path), "--out", "whole", "--trace", "--quiet"]
    subprocess.run(command, cwd=folder, env=child_environment, check=True, timeout=240)
    return path, folder / "whole"


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    """Mount a small file system; without the right to do that the test is skipped."""
    try:
        disk = Disk(tmp_path / "disk")
    except (subprocess.CalledProcessError, OSError) as error:
        pytest.skip(f"mounting a small file system is refused here: {getattr(error, 'stderr', '') or error}")
    yield disk
    disk.remove()
