"""Every error a user can meet, with the exit code it leads to.

The command line maps these, and only these, to a message without a traceback; any other exception is a bug in
femdeform and is shown whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar


class FemdeformError(Exception):
    """Base of all expected errors."""

    exit_code: ClassVar[int] = 1


class ExpectationError(FemdeformError):
    """A verification case, or the `expect:` block of a scene, is outside its band."""

    exit_code = 1


@dataclass(frozen=True, order=True)
class Fault:
    """One thing that is wrong in an input file.

    Attributes
    ----------
    file : str
        Path as the user gave it; `--set` for a fault in a command line override.
    line : int
        1-based line, 0 where no line can be named.
    key : str
        Dotted path inside the file, for example ``bodies.beam.material.density``; may be empty.
    message : str
        What is wrong and what would be right, one line.
    """

    file: str
    line: int
    key: str
    message: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line > 0 else self.file
        text = ": ".join(part for part in (place, self.key, self.message) if part)
        # Names in a scene, and of files, may hold what would break the line or move the cursor of a terminal.
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


class InputError(FemdeformError):
    """The input is wrong; carries every fault found, not only the first."""

    exit_code = 2

    def __init__(self, faults: Sequence[Fault] | str) -> None:
        self.faults: tuple[Fault, ...]
        if isinstance(faults, str):
            self.faults = (Fault("", 0, "", faults),)
        else:
            self.faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))


class MeshError(InputError):
    """A mesh is unusable: zero-volume, duplicate or non-finite elements, empty groups."""


class NotConvergedError(FemdeformError):
    """A solver did not reach its tolerance, or left the finite numbers, and no smaller step is allowed."""

    exit_code = 3


class MissingDependencyError(FemdeformError):
    """Something the run needs is not installed, or not usable here."""

    exit_code = 4


class OutputError(FemdeformError):
    """A result could not be written: the disk is full, the folder is read-only, a quota is reached."""

    exit_code = 4
