"""Where compiled kernels are kept: what makes a kept one stale, and that two processes never make the same one.

numba keeps compiled code per source file and does not notice when a function in *another* file, compiled into a
kernel, has changed; nor that a law was, which a kernel meets only as the type of an argument. Here a kernel is kept
in a folder named after its module and a hash of that module with all kernel modules it imports, under a key that
holds the same hash of the modules of its arguments' classes. Where the files lie has no part in it: copies of the
project share what is equal.

Compiling twice does not give the same bits twice. So who is first to compile a kernel locks it, and others, ranks of
one run above all, wait for it and take that one.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import sys
import tempfile
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

PACKAGES = ("femdeform", "solvers", "meshes", "verification")

_ROOT = Path(__file__).resolve().parent.parent
_UNUSED_CACHE_SECONDS = 30 * 86400.0
_LONGEST_COMPILATION_SECONDS = 600.0
# Names that talk to numba from outside: a module that imports nothing else has no part in compiled code.
_FROM_OUTSIDE = frozenset({"CompilationAnnouncer", "set_threads"})


# ---------------------------------------------------------------------------------------- what a kernel depends on

_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n#]*)|import[ \t]+([^\n#]+))", re.MULTILINE
)
_FOR_TYPES_ONLY = re.compile(r"^if TYPE_CHECKING:\n(?:[ \t]+[^\n]*\n|\n)+", re.MULTILINE)


@cache
def dependency_hash(source: Path) -> str:
    """Return a hash of a source file and of every kernel module of the project that it imports, directly or not.

    A kernel module is one that imports from ``femdeform.jit`` what ends up in compiled code (anything but
    `_FROM_OUTSIDE`). A module that only holds constants for kernels has to do so as well, otherwise a change of such a
    constant goes unnoticed.
    """
    first = source.resolve()
    reached, waiting = {first}, [first]
    while waiting:
        for path in _facts(waiting.pop()).imported:
            if path not in reached:
                reached.add(path)
                waiting.append(path)
    digest = hashlib.blake2b(f"{sys.version_info[:2]}".encode(), digest_size=8)
    reached.add(_ROOT / "femdeform" / "jit.py")
    for path in sorted(reached, key=_name_of):
        facts = _facts(path)
        if path == first or facts.is_kernel_module or path.name == "jit.py":
            digest.update(_name_of(path).encode() + b"\0" + facts.digest)
    return digest.hexdigest()


def _hash_of_module(name: str) -> str:
    """`dependency_hash` of an imported module, or of its name where it has no source."""
    path = getattr(sys.modules.get(name), "__file__", None)
    return dependency_hash(Path(path)) if path and Path(path).is_file() else name


def _name_of(path: Path) -> str:
    """A name of a module that does not depend on where the project lies."""
    return path.relative_to(_ROOT).as_posix() if path.is_relative_to(_ROOT) else path.name


class _Facts:
    """What is read from a source file once."""

    def __init__(self, path: Path) -> None:
        text = path.read_text(encoding="utf-8")
        self.digest = hashlib.blake2b(text.encode()).digest()
        found = list(_IMPORT.finditer(_FOR_TYPES_ONLY.sub("", text)))
        self.imported = {file for match in found for name in _modules_named(match) for file in _files_of(name)}
        self.is_kernel_module = any(
            match[1] == "femdeform.jit" and set(_names_in(match[2])) - _FROM_OUTSIDE for match in found
        )


@cache
def _facts(path: Path) -> _Facts:
    return _Facts(path)


def _names_in(text: str) -> list[str]:
    return [part.split()[0] for part in re.sub(r"#[^\n]*|[()]", "", text).split(",") if part.split()]


def _modules_named(match: re.Match[str]) -> Iterator[str]:
    """Modules an import statement may mean: ``from a import b`` means a, and a.b where that is a module."""
    if match[1]:
        yield match[1]
        yield from (f"{match[1]}.{name}" for name in _names_in(match[2]))
    else:
        yield from _names_in(match[3])


def _files_of(module: str) -> Iterator[Path]:
    """The file of a module of the project and those of the packages around it; none for others."""
    parts = module.split(".")
    if parts[0] not in PACKAGES:
        return
    for depth in range(1, len(parts) + 1):
        stem = _ROOT.joinpath(*parts[:depth])
        yield from (path for path in (stem / "__init__.py", stem.with_suffix(".py")) if path.is_file())


# ---------------------------------------------------------------------------------------- folder


def cache_folder() -> Path:
    """Return a folder of this user for compiled code, made if needed; else a temporary one.

    ``NUMBA_CACHE_DIR`` names it where it is set, and is set here to a temporary one, for the processes we start.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen)
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "femdeform" / "kernels"
        if _is_private(folder):
            return folder
    except (OSError, RuntimeError):  # Path.home() raises RuntimeError for a user without a home
        pass
    try:
        shared = Path(tempfile.gettempdir()) / f"femdeform-{os.getuid()}-kernels"
        if _is_private(shared):
            return shared
    except (OSError, AttributeError):  # no os.getuid on Windows
        pass
    os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(prefix="femdeform-kernels-")
    return Path(os.environ["NUMBA_CACHE_DIR"])


def _is_private(folder: Path) -> bool:
    """Make a folder and tell whether only this user can write to it: numba unpickles, so runs, its contents."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    facts = os.stat(folder)
    if not os.access(folder, os.W_OK | os.X_OK):
        return False
    return not (
        hasattr(os, "getuid") and (facts.st_uid != os.getuid() or facts.st_mode & (stat.S_IWGRP | stat.S_IWOTH))
    )


def note_use(folder: Path) -> None:
    """Make a module's folder, or note once a day that it is in use; a new one removes those unused for a month."""
    with suppress(OSError):
        if not folder.is_dir():
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            _remove_unused(folder.parent)
        elif time.time() - folder.stat().st_mtime > 86400.0:
            os.utime(folder)


def _remove_unused(parent: Path) -> None:
    import shutil

    oldest = time.time() - _UNUSED_CACHE_SECONDS
    for folder in parent.iterdir():
        with suppress(OSError):
            if folder.is_dir() and folder.stat().st_mtime < oldest:
                shutil.rmtree(folder, ignore_errors=True)


# ---------------------------------------------------------------------------------------- one compilation for all


class CompilationLock:
    """Held by the process that compiles a kernel; ends with the process, whatever happens to it.

    Kernels call one another in one direction, so processes that wait for one another's kernels cannot do so in a
    circle. Where a file system knows no locks nobody waits.

    Parameters
    ----------
    path : Path
        File that is locked.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[bytes] | None = None
        self._depth = 0

    def acquire(self) -> None:
        """Wait until no other process compiles; may be called again by the one that holds it."""
        self._depth += 1
        if self._depth > 1:
            return
        try:
            import fcntl

            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._file = self._path.open("ab")
            # A process that was stopped in the middle must not stop all others for good.
            patience = time.monotonic() + _LONGEST_COMPILATION_SECONDS
            while time.monotonic() < patience:
                try:
                    fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    time.sleep(0.02)
                else:
                    return
        except (ImportError, OSError):
            return

    def release(self) -> None:
        """Let others go on; nothing where it is not held."""
        self._depth = max(0, self._depth - 1)
        if self._depth == 0 and self._file is not None:
            self._file.close()
            self._file = None


# ---------------------------------------------------------------------------------------- numba's cache


@cache
def _cache_class() -> type[Any]:
    """Make numba's cache with our folder, keys and lock; a function, since it needs numba."""
    from numba.core import caching
    from numba.core.types.containers import BaseNamedTuple, BaseTuple
    from numba.core.types.functions import Dispatcher

    class Locator(caching._CacheLocator):  # type: ignore[misc]
        """Tells numba the folder of a function's module."""

        def __init__(self, py_func: Any, py_file: str) -> None:
            self._py_file = py_file
            self._line = py_func.__code__.co_firstlineno
            source = Path(py_file).resolve()
            self._stamp = dependency_hash(source)
            self._folder = cache_folder() / f"{_name_of(source).removesuffix('.py').replace('/', '.')}-{self._stamp}"

        def get_cache_path(self) -> str:
            return str(self._folder)

        def get_source_stamp(self) -> str:
            return self._stamp

        def get_disambiguator(self) -> str:
            return str(self._line)

        def ensure_cache_path(self) -> None:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)

        @classmethod
        def from_function(cls, py_func: Any, py_file: str) -> Any:
            return cls(py_func, py_file)

    class Implementation(caching.CompileResultCacheImpl):  # type: ignore[misc]
        _locator_classes = (Locator,)

    def modules_of(kind: Any) -> Iterator[str]:
        """Modules of classes and functions that a type brings in from outside the kernel's module."""
        if isinstance(kind, BaseNamedTuple):
            yield kind.instance_class.__module__
        if isinstance(kind, BaseTuple):
            for part in kind:
                yield from modules_of(part)
        if isinstance(kind, Dispatcher):
            yield kind.dispatcher.py_func.__module__

    class KernelCache(caching.Cache):  # type: ignore[misc]
        """Compiled versions of one function."""

        _impl_class = Implementation

        def __init__(self, py_func: Any) -> None:
            super().__init__(py_func)
            note_use(Path(self.cache_path))
            self._lock = CompilationLock(Path(self.cache_path, f"{self._impl.filename_base}.lock"))

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            found = super().load_overload(sig, target_context)
            if found is None and self._enabled:
                self._lock.acquire()
                found = super().load_overload(sig, target_context)
                if found is not None:
                    self._lock.release()
            return found

        def save_overload(self, sig: Any, data: Any) -> None:
            try:
                super().save_overload(sig, data)
            finally:
                self._lock.release()

        def abandon(self) -> None:
            self._lock.release()

        def _index_key(self, sig: Any, codegen: Any) -> Any:
            names = {name for kind in getattr(sig, "args", sig) for name in modules_of(kind)}
            return (*super()._index_key(sig, codegen), tuple(_hash_of_module(name) for name in sorted(names)))

    return KernelCache


def keep_on_disk(dispatcher: Any) -> Any:
    """Give one of numba's dispatchers a cache of compiled versions on disk.

    Parameters
    ----------
    dispatcher : numba dispatcher
        What ``numba.njit`` has made of a function of a source file.

    Returns
    -------
    numba dispatcher
        The same. A function without a source file, typed in or executed from text, is compiled anew each time.
    """
    if Path(dispatcher.py_func.__code__.co_filename).is_file():
        dispatcher._cache = _cache_class()(dispatcher.py_func)
    return dispatcher


def abandon(dispatcher: Any) -> None:
    """Let others compile a kernel of which the compilation here has failed."""
    cache = getattr(dispatcher, "_cache", None)
    if isinstance(cache, _cache_class()):
        cache.abandon()
