"""A batch under a launcher of MPI: the first rank hands the runs out, the others make them."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import suppress
from functools import partial
from typing import Any

from femdeform import parallel
from femdeform.errors import FemdeformError, MissingDependencyError
from femdeform.run.batch_process import Stop, Task, run_one
from femdeform.run.batch_record import Ending

MakeRuns = Callable[[Sequence[Task]], Iterator[tuple[Task, Ending]]]

_WAKE_UP = 0.2
# What this rank hears of signals; the functions that other ranks call by name need to find it.
_stop = Stop()


def run_on_ranks(schedule: Callable[[MakeRuns, Stop], int]) -> int:
    """Call a function on the first rank that has runs made by the others; collective.

    Parameters
    ----------
    schedule : callable
        Takes a function that makes runs and yields their endings, and what tells when to stop; returns the exit
        code.

    Returns
    -------
    int
        The exit code, the same on all ranks.

    Raises
    ------
    FemdeformError
        What `schedule` raised, on all ranks.
    MissingDependencyError
        If mpi4py is too old to have `mpi4py.futures`.
    """
    comm = parallel.world()
    assert comm is not None
    try:
        from mpi4py.futures import MPICommExecutor
    except ImportError as error:
        raise MissingDependencyError(f"a batch on several ranks needs mpi4py.futures ({error})") from None
    answer: int | FemdeformError | KeyboardInterrupt | None = None
    with _stop:
        with MPICommExecutor(comm, root=0) as executor:
            if executor is not None:  # the other ranks get here when there is nothing left to do
                try:
                    answer = schedule(partial(_make_runs, executor), _stop)
                except (FemdeformError, KeyboardInterrupt) as error:
                    answer = error
                except BaseException:
                    # The others would wait for ever for an answer.
                    traceback.print_exc()
                    sys.stderr.flush()
                    comm.Abort(1)
                    raise
        answer = comm.bcast(answer, root=0)
    if isinstance(answer, BaseException):
        raise answer
    assert answer is not None
    return answer


def _make_runs(executor: Any, tasks: Sequence[Task]) -> Iterator[tuple[Task, Ending]]:
    pending: dict[Future[Ending], Task] = {executor.submit(_work, task): task for task in tasks}
    try:
        while pending:
            ended, _ = wait(pending, timeout=_WAKE_UP, return_when=FIRST_COMPLETED)
            if _stop.count:
                for future in pending:
                    future.cancel()
            for future in ended:
                task = pending.pop(future)
                with suppress(CancelledError):
                    yield task, future.result()
    finally:
        for future in pending:
            future.cancel()


def _work(task: Task) -> Ending:
    return run_one(task, _stop)
