"""Where compiled code is kept, what makes it stale, and that processes do not compile the same kernel twice."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from kernel_process import KERNEL, fresh_environment, run_python

from femdeform import jit, kernel_cache

COUNT = (
    "from femdeform import jit\n"
    "with jit.CompilationAnnouncer(lambda line: None) as announcer:\n"
    "    {body}\n"
    "print(announcer.count)\n"
)


def compiled_in(body: str, tmp_path: Path) -> int:
    """Run code in a fresh process and return how many kernels it has compiled."""
    return int(run_python(COUNT.format(body=body), tmp_path)[-1])


# ---------------------------------------------------------------------------------------- folder


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
    folder = tmp_path / "cache" / "femdeform" / "kernels"
    assert list(folder.glob("kernel-*/*.nbc"))
    assert not folder.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)


def test_cache_folder_of_the_user_is_respected(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    run_python("import kernel; kernel.total(3)", tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "mine"))
    assert list((tmp_path / "mine").rglob("*.nbc"))
    assert not (tmp_path / "cache").exists()


def test_numba_imported_first_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    code = "import numba, kernel; kernel.total(3); print(numba.get_num_threads())"
    assert run_python(code, tmp_path, FEMDEFORM_THREADS="1") == ["1"]
    assert list((tmp_path / "cache" / "femdeform").rglob("*.nbc"))


def test_unusable_home_falls_back_to_a_private_temporary_folder(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    (tmp_path / "cache").write_text("a file where the folder should be")
    (tmp_path / "temporary").mkdir()
    code = (
        "import kernel; kernel.total(3)\n"
        "from femdeform.kernel_cache import cache_folder; print(cache_folder(), cache_folder())"
    )
    (line,) = run_python(code, tmp_path, TMPDIR=str(tmp_path / "temporary"))
    folder, again = line.split()
    assert folder == again
    assert Path(folder).parent == tmp_path / "temporary"
    assert not Path(folder).stat().st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    # A folder others can write to is not trusted: what lies in it would be executed.
    Path(folder).chmod(0o777)
    (line,) = run_python(code, tmp_path, TMPDIR=str(tmp_path / "temporary"))
    other, again = line.split()
    assert other == again != folder


def test_unused_folders_are_removed_after_a_month(tmp_path: Path) -> None:
    for name, age in (("old-1", 40.0), ("recent-2", 10.0)):
        (tmp_path / name).mkdir()
        stamp = (tmp_path / name).stat().st_mtime - age * 86400.0
        os.utime(tmp_path / name, (stamp, stamp))
    (tmp_path / "a file").write_text("")
    kernel_cache.note_use(tmp_path / "new-3")
    assert {entry.name for entry in tmp_path.iterdir()} == {"recent-2", "new-3", "a file"}
    kernel_cache.note_use(tmp_path / "recent-2")
    assert (tmp_path / "recent-2").stat().st_mtime > (tmp_path / "a file").stat().st_mtime - 3600.0


# ---------------------------------------------------------------------------------------- what is stale

CHAIN = {
    "solvers/leaf.py": "from femdeform.jit import njit\nSTEP = 1.0\n@njit\ndef leaf(x):\n    return x + STEP\n",
    "solvers/package/__init__.py": "from solvers.leaf import leaf\n",
    "solvers/driver.py": "from femdeform.jit import njit\nfrom solvers.package import (\n    leaf,  # told on\n)\n"
    "@njit\ndef driver(x):\n    return leaf(x)\n",
    "solvers/other.py": "from femdeform.jit import njit\nif TYPE_CHECKING:\n    from solvers.leaf import leaf\n",
    "solvers/outside.py": "from femdeform.jit import set_threads\nfrom solvers import leaf, outside\n",
    "solvers/user.py": "from femdeform.jit import njit\nimport solvers.outside\n",
    "femdeform/jit.py": "",
}


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with a chain of kernels, in place of ours."""
    for name, text in CHAIN.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(kernel_cache, "_ROOT", tmp_path)
    return tmp_path


def hashes(project: Path) -> dict[str, str]:
    kernel_cache.dependency_hash.cache_clear()
    kernel_cache._facts.cache_clear()
    return {name: kernel_cache.dependency_hash(project / name) for name in CHAIN}


@pytest.mark.parametrize(
    ("edited", "stale"),
    [
        ("solvers/leaf.py", {"leaf", "driver", "outside", "user", "__init__"}),
        ("solvers/driver.py", {"driver"}),
        ("solvers/other.py", {"other"}),
        # Not compiled: what it holds concerns no kernel but those it leads to.
        ("solvers/outside.py", {"outside"}),
        ("femdeform/jit.py", {"leaf", "__init__", "driver", "other", "outside", "user", "jit"}),
    ],
)
def test_edit_makes_stale_what_imports_it(project: Path, edited: str, stale: set[str]) -> None:
    before = hashes(project)
    (project / edited).write_text(CHAIN[edited] + "# a change\n")
    after = hashes(project)
    assert {Path(name).stem for name in CHAIN if before[name] != after[name]} == stale
    kernel_cache.dependency_hash.cache_clear()
    kernel_cache._facts.cache_clear()


def test_hash_does_not_depend_on_the_place(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = hashes(project)
    elsewhere = project.parent / f"{project.name}-elsewhere"
    shutil.copytree(project, elsewhere)
    monkeypatch.setattr(kernel_cache, "_ROOT", elsewhere)
    assert hashes(elsewhere) == before


def test_change_of_a_law_compiles_drivers_anew(tmp_path: Path) -> None:
    driver = (
        "from femdeform.jit import njit\nfrom femdeform.materials.dispatch import energy_density\n"
        "@njit\ndef drive(F, law):\n    return energy_density(F, law)\n"
    )
    law = (
        "from typing import NamedTuple\nfrom femdeform.jit import njit\n"
        "from femdeform.materials.dispatch import Kernels, register\n"
        "class Toy(NamedTuple):\n    mu: float\n    lmbda: float\n"
        "@njit\ndef energy(F, law):\n    return {factor} * law.mu\n"
        "register(Toy, 2, Kernels(energy, energy, energy))\n"
    )
    (tmp_path / "driver.py").write_text(driver)
    body = (
        "from driver import drive; from toy import Toy\n"
        "print(drive((1.0, 0.0, 0.0, 1.0), Toy(3.0, 1.0)), drive.stats.cache_hits)"
    )
    (tmp_path / "toy.py").write_text(law.format(factor="1.0"))
    assert run_python(body, tmp_path)[0].split()[0] == "3.0"
    value, hits = run_python(body, tmp_path)[0].split(" ", 1)
    assert value == "3.0"
    assert hits != "Counter()"
    (tmp_path / "toy.py").write_text(law.format(factor="2.0"))
    value, hits = run_python(body, tmp_path)[0].split(" ", 1)
    assert value == "6.0"
    assert hits == "Counter()"


# ---------------------------------------------------------------------------------------- one compilation for all


def test_processes_at_the_same_time_compile_once(tmp_path: Path) -> None:
    slow = "    result = 0.0\n" + "".join(f"    result += (n + {k}.0) ** 0.5 / (n + {k}.5)\n" for k in range(300))
    (tmp_path / "kernel.py").write_text(
        f"from femdeform.jit import njit\n@njit\ndef total(n):\n{slow}    return result\n"
    )
    code = COUNT.format(body="import kernel; kernel.total(3.0)")
    both = [
        subprocess.Popen(
            [sys.executable, "-c", code], env=fresh_environment(tmp_path), stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    counts = [int(process.communicate(timeout=120)[0]) for process in both]
    assert sorted(counts) == [0, 1]


def test_failed_compilation_keeps_nobody_waiting(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(
        "from femdeform.jit import njit\n@njit\ndef broken(x):\n    return x.no_such_thing\n"
    )
    code = (
        "import kernel, subprocess, sys\n"
        "def fails():\n"
        "    try:\n"
        "        kernel.broken(1.0)\n"
        "    except Exception as error:\n"
        "        return 'no_such_thing' in str(error)\n"
        "print(fails())\n"
        "if len(sys.argv) == 1:\n"
        "    child = [sys.executable, __file__, 'child']\n"
        "    print(subprocess.run(child, capture_output=True, text=True, timeout=60).stdout)\n"
    )
    (tmp_path / "both.py").write_text(code)
    lines = run_python(f"import runpy; runpy.run_path({str(tmp_path / 'both.py')!r}, run_name='__main__')", tmp_path)
    assert [line for line in lines if line] == ["True", "True"]


def test_lock_is_held_until_the_last_release(tmp_path: Path) -> None:
    first, second = (kernel_cache.CompilationLock(tmp_path / "a.lock") for _ in range(2))
    first.acquire()
    first.acquire()
    first.release()
    monotonic = iter(range(0, 10_000, 200))
    patience = pytest.MonkeyPatch()
    patience.setattr(kernel_cache.time, "monotonic", lambda: next(monotonic))
    second.acquire()  # gives up waiting in the end
    assert next(monotonic) > 600
    patience.undo()
    second.release()
    first.release()
    second.acquire()
    second.release()


def test_function_without_a_file_is_compiled_without_a_cache() -> None:
    space: dict[str, object] = {}
    exec("def double(x):\n    return 2.0 * x\n", space)
    assert jit.njit(space["double"])(2.0) == 4.0  # type: ignore[type-var, operator]
