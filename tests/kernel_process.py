"""Runs code with a small kernel in a fresh process with a kernel cache of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

KERNEL = """
from femdeform.jit import njit, prange
@njit(parallel=True)
def total(n):
    result = 0.0
    for i in prange(n):
        result += i
    return result
"""


def fresh_environment(tmp_path: Path) -> dict[str, str]:
    """Environment with nothing of ours in it, a kernel cache under ``tmp_path`` and modules from there."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "FEMDEFORM", "OMPI", "PMI"))}
    root = str(Path(__file__).resolve().parent.parent)
    return environment | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": f"{root}{os.pathsep}{tmp_path}"}


def run_python(code: str, tmp_path: Path, **variables: str) -> list[str]:
    """Run code in a fresh process with `fresh_environment`; return the lines it printed."""
    environment = fresh_environment(tmp_path) | variables
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()
