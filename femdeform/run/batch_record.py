"""What is left of the runs of a study: where their files lie, how each ended, and whether it goes on."""

from __future__ import annotations

import contextlib
import json
import signal
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from femdeform.run import atomic
from femdeform.run.checkpoint import FILE_NAME as CHECKPOINT
from femdeform.run.failure import BUG_NOTE
from femdeform.run.interrupts import INTERRUPTED

# A run with one of these is over, and kept.
FINISHED = ("done", "expectation_failed")
# One with one of these is over as well, and only run again on request.
FAILED = ("not_converged", "failed", "crashed")
# Whoever sends one of these wants the process to end; the others come from the process itself.
_SENT = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
_LAST_BYTES = 8192
_MAX_REASON = 400


@dataclass(frozen=True)
class Ending:
    """How a run stands.

    Attributes
    ----------
    status : str
        Of ``result.json`` where the run could write it (``done``, ``expectation_failed``, ``not_converged``,
        ``failed``, ``interrupted``), else ``crashed`` (by itself) or ``killed`` (by somebody); ``waiting`` before
        its turn, ``running`` during it.
    reason : str
        Why, one line; may be empty.
    exit_code : int or None
        Of the process; negative is the signal that ended it.
    seconds : float or None
        Wall time of its processes, all that worked on it together [s].
    """

    status: str
    reason: str = ""
    exit_code: int | None = None
    seconds: float | None = None

    @property
    def is_finished(self) -> bool:
        return self.status in FINISHED

    @property
    def is_failure(self) -> bool:
        """Whether the run came to no result."""
        return self.status in (*FAILED, "killed")


WAITING = Ending("waiting")


@dataclass(frozen=True)
class RunFiles:
    """Places of one run's files: its result folder, and beside it what the batch knows.

    Attributes
    ----------
    folder : Path
        Result folder.
    log : Path
        What the process said; locked while it lives.
    record : Path
        How the last process ended; missing while one lives, or if nobody was there to see it end.
    picture : Path
        Picture for the index.
    """

    folder: Path
    log: Path
    record: Path
    picture: Path

    @classmethod
    def of(cls, out: Path, name: str) -> RunFiles:
        """Places in the folder of a batch for a run of that name."""
        runs = out / "runs"
        return cls(runs / name, runs / f"{name}.log", runs / f"{name}.json", runs / f"{name}.png")

    def facts(self) -> Mapping[str, Any]:
        """What ``result.json`` says; empty where there is none, or it cannot be read."""
        return _read_json(self.folder / "result.json")

    def ending(self) -> Ending:
        """How the run stands, as far as its files tell."""
        known = _read_json(self.record)
        with contextlib.suppress(TypeError):
            return Ending(**known)
        # Nobody saw the last process end: it was left alone by a batch that was killed.
        facts = self.facts()
        status = facts.get("status")
        if status == "running" or not isinstance(status, str):
            return Ending("interrupted", "ended with the batch that had started it") if facts else WAITING
        return Ending(status, str(facts.get("reason", "")), None, _number(facts.get("wall_seconds")))

    def can_go_on(self) -> bool:
        """Whether there is a checkpoint of an unfinished run."""
        return bool(self.facts()) and (self.folder / CHECKPOINT).is_file()

    def write_record(self, ending: Ending) -> None:
        """Remember how the last process ended."""
        atomic.write_text(self.record, json.dumps(asdict(ending), indent=2) + "\n")


def judge(code: int, facts: Mapping[str, Any], log: Path, seconds: float) -> Ending:
    """How a process that has ended leaves its run.

    Parameters
    ----------
    code : int
        Exit code, negative for a signal.
    facts : mapping
        What its ``result.json`` says now; empty if there is none.
    log : Path
        What it said.
    seconds : float
        Wall time [s].
    """
    status, reason = str(facts.get("status", "")), str(facts.get("reason", ""))
    # A process that breaks after its result is written leaves a whole result.
    if status in FINISHED or status == "not_converged" or (status == "failed" and code > 0):
        return Ending(status, _one_line(reason), code, seconds)
    # A run that is to go on and breaks before it does so leaves the result of the interruption before it.
    if code == INTERRUPTED or (status == "interrupted" and -code in _SENT):
        return Ending("interrupted", _one_line(reason), code, seconds)
    if code < 0:
        name = signal.Signals(-code).name if -code in signal.valid_signals() else f"signal {-code}"
        if -code in _SENT:
            hint = "; if nobody sent it, the system ran out of memory" if -code == signal.SIGKILL else ""
            return Ending("killed", f"ended by {name}{hint}", code, seconds)
        return Ending("crashed", f"ended by {name}", code, seconds)
    status = "failed" if code in (2, 4) else "crashed"
    return Ending(status, _one_line(last_line(log)) or f"ended with exit code {code}", code, seconds)


def last_line(log: Path) -> str:
    """Last line of a log that says something; empty if there is none."""
    try:
        with log.open("rb") as stream:
            stream.seek(max(0, log.stat().st_size - _LAST_BYTES))
            text = stream.read().decode("utf-8", errors="replace")
    except OSError:
        return ""
    # Under a traceback stands a note for the user; what broke stands above it.
    lines = [line.strip() for line in text.replace(BUG_NOTE, "").splitlines() if line.strip()]
    return lines[-1].removeprefix("femdeform: ") if lines else ""


def _one_line(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= _MAX_REASON else text[: _MAX_REASON - 3] + "..."


def _read_json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
