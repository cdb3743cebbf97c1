"""What an exception means to a user: an error with a line that helps, or a bug of ours."""

from __future__ import annotations

import errno
import sys
import traceback
from typing import Any

from femdeform.errors import FemdeformError, OutputError
from femdeform.run.atomic import output_error
from femdeform.run.interrupts import INTERRUPTED

# EX_SOFTWARE of sysexits.h: told apart from every verdict about a scene.
BUG = 70
BUG_NOTE = "femdeform: this is a bug in femdeform, not in your scene; please report it with the lines above"

# What a library, or Python itself, may meet while it writes somewhere else than the result folder.
_ENVIRONMENT = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EIO, errno.ENOMEM}


class MemoryExhaustedError(FemdeformError):
    """The memory does not suffice for what was asked for."""

    exit_code = 4


def expected_error(error: BaseException) -> FemdeformError | None:
    """Return the error to report for an exception; None if it is a bug.

    Parameters
    ----------
    error : BaseException
        Whatever was caught.
    """
    if isinstance(error, FemdeformError):
        return error
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        text = first_line(error)
        detail = f" ({text})" if text else ""
        return MemoryExhaustedError(f"out of memory{detail}: take a coarser mesh, or more computers")
    if isinstance(error, OSError) and error.errno in _ENVIRONMENT:
        return OutputError(str(output_error(error.filename or "a temporary file or the cache of compiled code", error)))
    return None


def exit_code(error: BaseException) -> int:
    """Exit code of a command that an exception ends."""
    known = expected_error(error)
    return BUG if known is None else known.exit_code


def first_line(error: BaseException) -> str:
    """Say in one line what happened."""
    text = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    if isinstance(error, FemdeformError | MemoryError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def reason_of(error: BaseException) -> str:
    """Return what ``result.json`` says about a run that an exception ended."""
    return first_line(expected_error(error) or error)


def end_all_ranks(comm: Any, error: BaseException) -> None:
    """Say on this rank what went wrong, and end the others with it.

    Parameters
    ----------
    comm : mpi4py communicator
        The communicator.
    error : BaseException
        What was caught.
    """
    known = expected_error(error)
    if isinstance(error, KeyboardInterrupt):
        print(f"femdeform: rank {comm.Get_rank()}: interrupted", file=sys.stderr, flush=True)
    elif known is not None:
        print(f"femdeform: rank {comm.Get_rank()}: {known}", file=sys.stderr, flush=True)
    else:
        traceback.print_exception(error)
        print(BUG_NOTE, file=sys.stderr, flush=True)
    comm.Abort(INTERRUPTED if isinstance(error, KeyboardInterrupt) else exit_code(error))
