"""SIGTERM and SIGINT: heard at once where that does no harm, a moment later where it would, never lost."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from types import FrameType
from typing import Any

INTERRUPTED = 130
_SIGNALS = (signal.SIGTERM, signal.SIGINT)
# A library that keeps Python from hearing a signal (a mesher, a factorisation) gets this long to come back.
_PATIENCE = 5.0
# After this long what has to be written is written: a launcher of ranks kills them within a second.
_SHORT = 0.3

# What tells the watcher of the block that is being run that a signal was heard; one block is run at a time.
_watched: list[threading.Event] = []
# Those that hear signals now; the last one does, each within the block of the one before it.
_hearing: list[Interrupts] = []
# What is still to be written when the process has to end in the middle of a library; at most one run has such.
_last_words: list[Callable[[], None]] = []


class Interrupts:
    """Turns SIGTERM and SIGINT into `KeyboardInterrupt` inside a ``with`` block.

    In a thread other than the main one, and for signals that the process was started to ignore, it does nothing.

    Attributes
    ----------
    is_pending : bool
        Whether a signal has come.
    """

    def __init__(self) -> None:
        self.is_pending = False
        self._holds = 0
        self._before: dict[signal.Signals, Any] = {}
        self._on_arrival: Callable[[], None] | None = None

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._arrive)
        _hearing.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _hearing.remove(self)
        for number, handler in self._before.items():
            # None stands for a handler that was not installed by Python and cannot be put back.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._before.clear()

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep signals waiting in a block whose work belongs together; they are raised at its end."""
        self._holds += 1
        try:
            yield
        finally:
            self._holds -= 1
        # Also one that was raised and lost on the way, as in a destructor.
        if self.is_pending and not self._holds:
            raise KeyboardInterrupt

    def hold(self, on_arrival: Callable[[], None] | None = None) -> None:
        """Raise nothing from now on; call `on_arrival` when a signal comes."""
        self._holds += 1
        self._on_arrival = on_arrival

    def _arrive(self, number: int, frame: FrameType | None) -> None:
        for heard in _watched:
            heard.set()
        self.is_pending = True
        if self._on_arrival is not None:
            self._on_arrival()
        if not self._holds:
            raise KeyboardInterrupt


@contextmanager
def signals_held() -> Iterator[None]:
    """Keep signals waiting in a block, as `Interrupts.held`, for code that is not handed the one that hears them.

    Outside all blocks of `Interrupts` it does nothing.
    """
    with _hearing[-1].held() if _hearing else nullcontext():
        yield


@contextmanager
def last_words(say: Callable[[], None]) -> Iterator[None]:
    """Have something written should a signal go unheard during a block; see `answered_in_time`."""
    _last_words.append(say)
    try:
        yield
    finally:
        _last_words.remove(say)


@contextmanager
def answered_in_time(patience: float = _PATIENCE) -> Iterator[None]:
    """End the process, with a message and exit code 130, if a library keeps it from hearing a signal.

    For commands whose signals are heard by `Interrupts`: nothing of Python runs while a mesher or a factorisation is
    at work, which may take minutes. All files are replaced atomically, so nothing is torn by that. Does nothing
    outside the main thread.

    Parameters
    ----------
    patience : float
        How long the signal may go unheard [s].
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    # The interpreter writes a byte there from within the signal handler of the system, whoever is at work.
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    # One of its own for each block: a watcher that wakes up late must not wait for what belongs to a later block.
    heard = threading.Event()
    _watched.append(heard)

    def watch() -> None:
        while number := os.read(reader, 1):
            if number[0] not in _SIGNALS or heard.wait(min(_SHORT, patience)):
                continue
            for say in _last_words:
                with suppress(Exception):
                    say()
            if not heard.wait(patience):
                with suppress(Exception):
                    print("femdeform: interrupted", file=sys.stderr, flush=True)
                os._exit(INTERRUPTED)
        os.close(reader)

    threading.Thread(target=watch, name="femdeform-signals", daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        _watched.remove(heard)
        heard.set()  # whatever came, the block has ended: nothing keeps Python from hearing
        os.close(writer)  # the thread reads the end of the pipe and ends
