"""Where compiled code is kept, how many threads it gets, and that a first compilation is heard of."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from femdeform import jit
from femdeform.errors import InputError

THREAD_VARIABLES = ("FEMDEFORM_THREADS", "NUMBA_NUM_THREADS", "FEMDEFORM_EXPORTED_THREADS")

KERNEL = """
from femdeform.jit import njit, prange
@njit(parallel=True)
def total(n):
    result = 0.0
    for i in prange(n):
        result += i
    return result
"""


def run_python(code: str, tmp_path: Path, **variables: str) -> list[str]:
    """Run code in a fresh process with nothing of ours in its environment; return the lines it printed."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "FEMDEFORM", "OMPI", "PMI"))}
    root = str(Path(jit.__file__).resolve().parent.parent)
    environment |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": f"{root}{os.pathsep}{tmp_path}"}
    environment |= variables
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


# ---------------------------------------------------------------------------------------- cache


def test_second_process_compiles_nothing_and_stays_silent(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    code = (
        "from femdeform import jit\n"
        "with jit.CompilationAnnouncer(print) as announcer:\n"
        "    import kernel\n"
        "    assert kernel.total(10) == 45.0 and kernel.total(11) == 55.0\n"
        "print(announcer.count, announcer.seconds > 0.0, jit.compile_seconds() == announcer.seconds)\n"
    )
    assert run_python(code, tmp_path) == [jit.CompilationAnnouncer.MESSAGE, "1 True True"]
    assert run_python(code, tmp_path) == ["0 False True"]
    kept = list((tmp_path / "cache" / "femdeform").glob("kernels-*/**/*.nbc"))
    assert kept
    mode = next((tmp_path / "cache" / "femdeform").glob("kernels-*")).stat().st_mode
    assert not mode & (stat.S_IRWXG | stat.S_IRWXO)


def test_cache_folder_of_the_user_is_respected(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    run_python("import kernel; kernel.total(3)", tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "mine"))
    assert list((tmp_path / "mine").rglob("*.nbc"))
    assert not (tmp_path / "cache").exists()


def test_numba_imported_first_is_configured_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    code = "import numba, kernel; kernel.total(3); print(numba.get_num_threads())"
    assert run_python(code, tmp_path, FEMDEFORM_THREADS="1") == ["1"]
    assert list((tmp_path / "cache" / "femdeform").rglob("*.nbc"))


def test_unusable_home_falls_back_to_a_private_temporary_folder(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    (tmp_path / "cache").write_text("a file where the folder should be")
    (tmp_path / "temporary").mkdir()
    code = "import kernel, os; kernel.total(3); print(os.environ['NUMBA_CACHE_DIR'])"
    (folder,) = run_python(code, tmp_path, TMPDIR=str(tmp_path / "temporary"))
    assert Path(folder).parent == tmp_path / "temporary"
    assert not Path(folder).stat().st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    # A folder others can write to is not trusted: what lies in it would be executed.
    Path(folder).chmod(0o777)
    (other,) = run_python(code, tmp_path, TMPDIR=str(tmp_path / "temporary"))
    assert other != folder


def test_key_follows_kernel_modules_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in jit.PACKAGES:
        (tmp_path / package).mkdir()
    kernels, other = tmp_path / "solvers" / "kernels.py", tmp_path / "femdeform" / "cli.py"
    kernels.write_text("from femdeform.jit import njit\nSTEP = 1.0\n")
    other.write_text("from femdeform.jit import set_threads\nSTEP = 1.0\n")
    monkeypatch.setattr(jit, "__file__", str(tmp_path / "femdeform" / "jit.py"))
    key = jit.kernel_key()
    other.write_text("from femdeform.jit import set_threads\nSTEP = 2.0\n")
    assert jit.kernel_key() == key
    kernels.write_text("from femdeform.jit import njit\nSTEP = 2.0\n")
    assert jit.kernel_key() != key


def test_unused_folders_are_removed_after_a_month(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parent = tmp_path / "femdeform"
    for name, age in (("kernels-old", 40.0), ("kernels-recent", 10.0), ("other", 40.0)):
        (parent / name).mkdir(parents=True)
        stamp = (parent / name).stat().st_mtime - age * 86400.0
        os.utime(parent / name, (stamp, stamp))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    used = jit._cache_folder()
    assert used.parent == parent
    assert {folder.name for folder in parent.iterdir()} == {"kernels-recent", "other", used.name}
    shutil.rmtree(parent)


# ---------------------------------------------------------------------------------------- threads


@pytest.fixture
def no_thread_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in (*THREAD_VARIABLES, *jit._RANK_COUNT_VARIABLES):
        monkeypatch.delenv(variable, raising=False)


@pytest.mark.usefixtures("no_thread_variables")
@pytest.mark.parametrize(("cores", "ranks", "expected"), [(8, 1, 8), (8, 2, 4), (8, 3, 2), (2, 4, 1)])
def test_threads_are_cores_divided_by_ranks(
    cores: int, ranks: int, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jit, "n_available_cores", lambda: cores)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(cores)), raising=False)
    monkeypatch.setenv("OMPI_COMM_WORLD_LOCAL_SIZE", str(ranks))
    assert jit.default_threads() == expected


@pytest.mark.usefixtures("no_thread_variables")
def test_rank_bound_to_one_core_gets_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    parent = os.getppid()
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)) if pid == parent else {3}, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setenv("PMI_SIZE", "2")
    assert jit.default_threads() == 1


@pytest.mark.usefixtures("no_thread_variables")
def test_environment_overrides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "5")
    assert jit.default_threads() == 5
    monkeypatch.setenv("FEMDEFORM_EXPORTED_THREADS", "5")  # exported by a parent process of ours, not the user
    monkeypatch.setattr(jit, "n_available_cores", lambda: 1)
    assert jit.default_threads() == 1
    monkeypatch.setenv("FEMDEFORM_THREADS", "7")
    assert jit.default_threads() == 7


@pytest.mark.usefixtures("no_thread_variables")
@pytest.mark.parametrize("value", ["0", "-2", "many", "1.5"])
def test_bad_thread_count_is_an_input_error(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEMDEFORM_THREADS", value)
    with pytest.raises(InputError, match="FEMDEFORM_THREADS: expected a positive integer"):
        jit.default_threads()


def test_set_threads_before_and_after_numba(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    code = (
        "import sys\n"
        "from femdeform import jit\n"
        "print(jit.set_threads(2), 'numba' in sys.modules)\n"
        "import kernel, numba\n"
        "print(numba.config.NUMBA_NUM_THREADS, numba.get_num_threads())\n"
        "print(jit.set_threads(1), numba.get_num_threads(), jit.set_threads(64))\n"
        "print(kernel.total(100))\n"
    )
    assert run_python(code, tmp_path) == ["2 False", "2 2", "1 1 2", "4950.0"]
    with pytest.raises(ValueError, match="must be positive, got 0"):
        jit.set_threads(0)


# ---------------------------------------------------------------------------------------- decorators


def test_division_by_zero_and_nan_are_numbers_not_exceptions() -> None:
    @jit.njit
    def quotient(a: float, b: float) -> float:
        return a / b

    @jit.njit(fastmath=jit.ORDERED)
    def is_nan(x: float) -> bool:
        return x != x

    assert quotient(1.0, 0.0) == float("inf")
    assert is_nan(quotient(0.0, 0.0))


def test_announcer_that_heard_nothing_leaves_no_callback() -> None:
    before = len(jit._CompileListener.instance().callbacks)
    with jit.CompilationAnnouncer(print) as announcer:
        pass
    assert announcer.count == 0
    assert len(jit._CompileListener.instance().callbacks) == before


def test_unknown_attribute() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'vectorise'"):
        jit.vectorise  # noqa: B018
