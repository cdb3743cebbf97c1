"""How many threads compiled code gets, and that a first compilation is heard of."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from kernel_process import KERNEL, run_python

from femdeform import jit
from femdeform.errors import InputError

THREAD_VARIABLES = ("FEMDEFORM_THREADS", "NUMBA_NUM_THREADS", "FEMDEFORM_EXPORTED_THREADS")

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
