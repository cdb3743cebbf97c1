"""How benchmarks run their cases: those that are wanted, one after the other, each kept as soon as it is done."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, TypeVar

from femdeform import jit
from verification.benchmarks import child_process
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.environment import is_wanted, peers_python
from verification.benchmarks.tables import Findings

_Key = TypeVar("_Key")
_PEERS = Path(__file__).parent / "peers"


class Benchmark(Protocol):
    """A function that runs the cases of a benchmark."""

    def __call__(self, cases: Cases) -> Findings:
        """Run all that are wanted.

        Parameters
        ----------
        cases : Cases
            Runs them. The first thing it is told is how tables are made of them.

        Returns
        -------
        Findings
            Of all cases.
        """


class Cases:
    """Runs cases, and hands on after each of them what all of them have found so far.

    Parameters
    ----------
    say : callable
        Gets a line of text before each case, and one for each that breaks.
    keep : callable
        Gets the findings after each case.
    """

    def __init__(self, say: Callable[[str], None], keep: Callable[[Findings], None] = lambda findings: None) -> None:
        self._say = say
        self._keep = keep
        self._findings: Callable[[], Findings] | None = None

    def begin(self, findings: Callable[[], Findings]) -> None:
        """Say how tables are made of the results so far; all cases may be missing."""
        self._findings = findings

    def keep(self) -> None:
        """Hand on what has been found so far; `run` and `peer` do it by themselves."""
        if self._findings is not None:
            self._keep(self._findings())

    def outcome(
        self,
        name: str,
        module: str,
        case: Mapping[str, Any],
        threads: int | None = None,
        launcher: Sequence[str] = (),
    ) -> Outcome:
        """Run a case in a process of its own, wanted or not; see `run`."""
        most = jit.default_threads() if threads is None else threads
        return self._say_and_do(name, lambda: child_process.run_module(module, case, most, launcher))

    def run(
        self,
        into: dict[_Key, Outcome],
        key: _Key,
        name: str,
        module: str,
        case: Mapping[str, Any],
        threads: int | None = None,
        launcher: Sequence[str] = (),
        reason: str = "",
    ) -> None:
        """Run a case in a process of its own, if it is wanted.

        Parameters
        ----------
        into : dict
            Gets the outcome.
        key : hashable
            Its place there.
        name : str
            For people, and for FEMDEFORM_BENCH_ONLY.
        module, case, launcher
            See `child_process.run_module`.
        threads : int, optional
            Of the kernels; default: all.
        reason : str
            Why it cannot be run; empty if it can.
        """
        if is_wanted(name):
            into[key] = skipped(reason) if reason else self.outcome(name, module, case, threads, launcher)
            self.keep()

    @contextmanager
    def state(self, module: str, case: Mapping[str, Any]) -> Iterator[tuple[str, Outcome]]:
        """Have a state written that peers start from: its file while it lasts, and what became of the case.

        Nothing is written where there is no environment with peers.
        """
        with tempfile.TemporaryDirectory(prefix="femdeform-bench-") as folder:
            path = str(Path(folder, "state.npz"))
            python, reason = peers_python()
            written = skipped(reason) if python is None else child_process.run_module(module, {**case, "dump": path}, 1)
            yield path, written

    def peer_outcome(self, name: str, script: str, case: Mapping[str, Any], state: Outcome) -> Outcome:
        """Run another code, wanted or not, where there is an environment with it.

        Parameters
        ----------
        name : str
            For people.
        script : str
            File in ``peers``.
        case : mapping
            What it is to measure.
        state : Outcome
            Of the case that wrote what it starts from.
        """
        python, reason = peers_python()
        if python is None:
            return skipped(reason)
        if not state.done:
            return skipped("there is no state to compare at")
        return self._say_and_do(name, lambda: child_process.run_script(python, _PEERS / script, case))

    def peer(
        self, into: dict[_Key, Outcome], key: _Key, name: str, script: str, case: Mapping[str, Any], state: Outcome
    ) -> None:
        """Run another code, if it is wanted; see `run` and `peer_outcome`."""
        if is_wanted(name):
            into[key] = self.peer_outcome(name, script, case, state)
            self.keep()

    def _say_and_do(self, name: str, work: Callable[[], Outcome]) -> Outcome:
        self._say(name)
        outcome = work()
        if outcome.status == "failed":
            self._say(f"failed: {name}: {outcome.reason}")
        return outcome
