"""Compiled kernels: the project's `njit`, how many threads it uses, and how long compilation took.

Importing this module does not import numba. A kernel module does ``from femdeform.jit import njit, prange``;
that first use imports numba, after the number of threads was put into the environment, where numba reads it once.
`femdeform.kernel_cache` keeps what was compiled.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar, overload

from femdeform.kernel_cache import abandon, keep_on_disk

if TYPE_CHECKING:
    from collections.abc import Iterator

Function = TypeVar("Function", bound=Callable[..., Any])

# Never `nnan` or `ninf`: kernels detect states that have left the finite numbers.
FASTMATH = frozenset({"contract", "arcp", "nsz", "reassoc"})
# For sums whose order matters, such as (F00 - 1) + (F11 - 1), which must not become F00 + F11 - 2.
ORDERED = frozenset({"contract", "arcp", "nsz"})

_RANK_COUNT_VARIABLES = (
    "OMPI_COMM_WORLD_LOCAL_SIZE",
    "MPI_LOCALNRANKS",
    "MV2_COMM_WORLD_LOCAL_SIZE",
    "OMPI_COMM_WORLD_SIZE",
    "PMI_SIZE",
)
_OUR_THREADS = "FEMDEFORM_EXPORTED_THREADS"

# ---------------------------------------------------------------------------------------- decorators


@overload
def njit(function: Function, /) -> Function: ...


@overload
def njit(
    *, parallel: bool = False, fastmath: frozenset[str] = FASTMATH, inline: str = "never"
) -> Callable[[Function], Function]: ...


def njit(
    function: Function | None = None,
    /,
    *,
    parallel: bool = False,
    fastmath: frozenset[str] = FASTMATH,
    inline: str = "never",
) -> Any:
    """Compile a function on its first call, with the defaults of the project, and keep the result on disk.

    Division by zero gives inf or nan as in numpy, never an exception. ``@njit`` and ``@njit(parallel=True)``
    both work; ``parallel=True`` turns the `prange` loops of the function into threaded ones.

    Parameters
    ----------
    function : callable
        The function, where the decorator is used without arguments.
    parallel : bool
        Run `prange` loops on the threads chosen by `set_threads`.
    fastmath : frozenset of str
        Liberties the compiler may take; `ORDERED` forbids it to reorder sums.
    inline : str
        ``"never"`` leaves inlining to LLVM; ``"always"`` does it on the level of numba's own representation.

    Returns
    -------
    callable
        The compiled function; annotated as the function itself.
    """
    decorate = _numba().njit(error_model="numpy", fastmath=set(fastmath), parallel=parallel, inline=inline, nogil=True)

    def compiled(function: Function) -> Any:
        return keep_on_disk(decorate(function))

    return compiled if function is None else compiled(function)


# numba's own objects, for kernel modules; found on first use, so that numba is imported with its environment
# in order.
_NUMBA_OBJECTS = {
    "prange": "numba",
    "types": "numba.core",
    "extending": "numba",
    "TypingError": "numba.core.errors",
}


def __getattr__(name: str) -> Any:
    if name not in _NUMBA_OBJECTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    _numba()
    module = import_module(_NUMBA_OBJECTS[name])
    return getattr(module, name) if hasattr(module, name) else import_module(f"{module.__name__}.{name}")


if TYPE_CHECKING:
    types: Any
    extending: Any

    class TypingError(Exception): ...

    def prange(stop: int) -> Iterator[int]: ...


_configured = False


def _numba() -> Any:
    """Return numba, imported after its environment is in order."""
    global _configured
    if not _configured:
        _configured = True
        first = "numba" not in sys.modules
        threads = default_threads()
        if first and os.environ.get("NUMBA_NUM_THREADS") != str(threads):
            _export_threads(threads)
        import numba
        from numba.core import event

        event.Listener.register(_CompileListener)
        event.register("numba:compile", _CompileListener.instance())
        if not first:
            # Somebody imported numba before us: it no longer reads the environment, but can still be told.
            numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    import numba

    return numba


# ---------------------------------------------------------------------------------------- threads


def n_local_ranks() -> int:
    """Return how many MPI ranks share this computer, as the launcher left it in the environment; else 1."""
    for variable in _RANK_COUNT_VARIABLES:
        value = os.environ.get(variable, "")
        if value.isdigit() and int(value) > 0:
            return int(value)
    return 1


def n_available_cores() -> int:
    """Return how many cores this process, or the launcher that started it, may use."""
    cores = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
        if n_local_ranks() > 1:
            # mpiexec binds each rank to its share; what there is to share is what mpiexec itself may use.
            with suppress(OSError):
                cores = max(cores, len(os.sched_getaffinity(os.getppid())))
    try:
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        if quota != "max":
            cores = min(cores, max(1, round(int(quota) / int(period))))
    except (OSError, ValueError):
        pass
    return cores


def default_threads() -> int:
    """Return the number of threads for kernels, at least 1.

    That is ``FEMDEFORM_THREADS`` if set, else ``NUMBA_NUM_THREADS`` if the user set it, else cores divided by
    ranks.

    Raises
    ------
    InputError
        If ``FEMDEFORM_THREADS`` is not a positive integer.
    """
    wanted = os.environ.get("FEMDEFORM_THREADS", "").strip()
    if not wanted and _user_chose_numba_threads():
        return max(1, int(os.environ["NUMBA_NUM_THREADS"]))
    if wanted:
        if not wanted.isdigit() or int(wanted) < 1:
            from femdeform.errors import InputError

            raise InputError(f"FEMDEFORM_THREADS: expected a positive integer, got {wanted!r}")
        return int(wanted)
    threads = max(1, n_available_cores() // n_local_ranks())
    if hasattr(os, "sched_getaffinity"):
        threads = min(threads, len(os.sched_getaffinity(0)))
    return threads


def _export_threads(count: int) -> None:
    # The second variable tells a child process that the first one is not the user's wish but ours, for this
    # process.
    os.environ["NUMBA_NUM_THREADS"] = os.environ[_OUR_THREADS] = str(count)


def _user_chose_numba_threads() -> bool:
    chosen = os.environ.get("NUMBA_NUM_THREADS")
    return chosen is not None and chosen.isdigit() and chosen != os.environ.get(_OUR_THREADS)


def set_threads(n: int | None = None) -> int:
    """Choose the number of threads of parallel kernels.

    Parameters
    ----------
    n : int, optional
        The number; `default_threads` if not given.

    Returns
    -------
    int
        The number in effect. Once numba is loaded it cannot exceed the number numba was loaded with.

    Raises
    ------
    ValueError
        If ``n`` is not positive.
    """
    count = default_threads() if n is None else n
    if count < 1:
        raise ValueError(f"the number of threads must be positive, got {count}")
    if "numba" not in sys.modules:
        _export_threads(count)
        return count
    numba = _numba()
    count = min(count, int(numba.config.NUMBA_NUM_THREADS))
    numba.set_num_threads(count)
    return count


def threads() -> int:
    """Return the number of threads that parallel kernels have now."""
    return int(_numba().get_num_threads()) if "numba" in sys.modules else default_threads()


# ---------------------------------------------------------------------------------------- compilation


class _CompileListener:
    """Hears every compilation of numba: adds up the seconds and calls back at the first.

    numba reports a compilation, not a load from the cache, and reports those of called functions inside that
    of the caller; only the outermost one is counted.
    """

    _instance: _CompileListener | None = None

    def __init__(self) -> None:
        self.seconds = 0.0
        self.count = 0
        self.callbacks: list[Callable[[], None]] = []
        self._local = threading.local()

    @classmethod
    def instance(cls) -> _CompileListener:
        """Return the one listener of the process."""
        if cls._instance is None:
            cls._instance = cls()
        return cls._instance

    def notify(self, event: Any) -> None:
        """Receive an event; the interface numba expects of a listener."""
        if event.is_start:
            self.on_start(event)
        elif event.is_end:
            self.on_end(event)

    def on_start(self, event: Any) -> None:
        """Begin a compilation."""
        depth = getattr(self._local, "depth", 0)
        if depth == 0:
            self._local.start = time.perf_counter()
            self.count += 1
            callbacks, self.callbacks = self.callbacks, []
            for callback in callbacks:
                callback()
        self._local.depth = depth + 1

    def on_end(self, event: Any) -> None:
        """End a compilation; one that failed keeps nobody waiting."""
        # numba's `is_failed` says the opposite of what its name does.
        if getattr(event, "_exc_details", None) is not None:
            abandon(event.data["dispatcher"])
        self._local.depth = getattr(self._local, "depth", 1) - 1
        if self._local.depth == 0:
            self.seconds += time.perf_counter() - self._local.start


def on_first_compile(callback: Callable[[], None]) -> None:
    """Call ``callback`` once, just before the next compilation; never if everything comes from the cache."""
    _CompileListener.instance().callbacks.append(callback)


def compile_seconds() -> float:
    """Return the seconds this process has spent compiling kernels so far."""
    return _CompileListener.instance().seconds


class CompilationAnnouncer:
    """Announces the first compilation inside a ``with`` block and measures all of them.

    Parameters
    ----------
    announce : callable
        Called with one line of text, at most once.

    Attributes
    ----------
    seconds : float
        Seconds spent compiling inside the block [s].
    count : int
        Number of compilations inside the block, called functions not counted.
    """

    MESSAGE = "compiling kernels (first run only)..."

    def __init__(self, announce: Callable[[str], None]) -> None:
        self._announce = announce
        self._seconds = 0.0
        self._count = 0

    def _callback(self) -> None:
        self._announce(self.MESSAGE)

    @property
    def seconds(self) -> float:
        """Seconds spent compiling since the block was entered [s]."""
        return compile_seconds() - self._seconds

    @property
    def count(self) -> int:
        """Number of compilations since the block was entered."""
        return _CompileListener.instance().count - self._count

    def __enter__(self) -> CompilationAnnouncer:
        listener = _CompileListener.instance()
        self._seconds, self._count = listener.seconds, listener.count
        on_first_compile(self._callback)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        callbacks = _CompileListener.instance().callbacks
        if self._callback in callbacks:
            callbacks.remove(self._callback)
