"""Files that are either the old ones or the new ones, never half of each.

A file is written beside its target, flushed to the disk and then renamed over it; a run that is killed at
any moment leaves at most a stray ``.*.part`` file, which `remove_leftovers` clears away.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Collection, Iterator
from pathlib import Path

from femdeform.errors import OutputError

_REASONS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EACCES: "no permission to write there",
    errno.EPERM: "no permission to write there",
    errno.EROFS: "the file system is read-only",
    errno.EFBIG: "the file would be larger than allowed here",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.EISDIR: "there is a folder of that name",
    errno.EEXIST: "there is a file of that name, not a folder",
    errno.ENAMETOOLONG: "the name is too long",
}


def output_error(path: Path | str, error: OSError) -> OutputError:
    """The one-line error for a file that cannot be written.

    Parameters
    ----------
    path : Path or str
        The file or folder that was to be written, or what it is for.
    error : OSError
        What the system, or a library on its behalf, reported.
    """
    if error.errno in _REASONS:
        reason = _REASONS[error.errno]
    else:
        # Libraries such as HDF5 give long texts over several lines; the first line says what happened.
        reason = (error.strerror or str(error) or type(error).__name__).splitlines()[0]
    return OutputError(f"cannot write {path}: {reason}")


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an `OSError` raised while `path` is written into an `OutputError`."""
    try:
        yield
    except OSError as error:
        raise output_error(path, error) from error


def make_folder(folder: Path) -> None:
    """Create a folder and its parents.

    Raises
    ------
    OutputError
        If it cannot be created, or a file of that name is in the way.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)


def check_writable(folder: Path) -> None:
    """Create a folder and make sure that files can be made in it, before work is spent on what they would hold.

    Raises
    ------
    OutputError
        If not.
    """
    make_folder(folder)
    with writing(folder):
        probe = _beside(folder / "probe")
        _create(probe)
        probe.unlink()


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to; on leaving without an exception it becomes `path`.

    For libraries that insist on opening the file themselves. The temporary file lies in the same folder, so
    that the rename stays inside one file system, and has the same suffix, because libraries choose the
    format by it.

    Parameters
    ----------
    path : Path
        The file to create or replace. Its folder has to exist.

    Yields
    ------
    Path
        Where to write. After an exception in the body it is removed and `path` is as before.

    Raises
    ------
    OutputError
        If the disk is full or the folder cannot be written to.
    """
    with writing(path):
        temporary = _beside(path)
        _create(temporary)
        try:
            yield temporary
            _flush_to_disk(temporary)
            os.replace(temporary, path)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        _flush_folder(path.parent)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a whole file atomically.

    Raises
    ------
    OutputError
        If the disk is full or the folder cannot be written to.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a whole UTF-8 text file atomically, with line ends as given.

    Raises
    ------
    OutputError
        If the disk is full or the folder cannot be written to.
    """
    write_bytes(path, text.encode("utf-8"))


def remove_leftovers(folder: Path) -> None:
    """Remove what `replacing` left in a folder when a process was killed inside it."""
    with writing(folder):
        for leftover in (*folder.glob(".*.part.*"), *folder.glob(".*.part")):
            leftover.unlink(missing_ok=True)


def remove_listed(folder: Path, listed: object, kept: Collection[str] = ()) -> None:
    """Remove files of an earlier run by the list of them that it wrote.

    Parameters
    ----------
    folder : Path
        Where they lie. Nothing outside of it is removed, whatever the list says.
    listed : object
        Names, as they were read; anything else is passed over.
    kept : collection of str
        Names to leave where they are.

    Raises
    ------
    OutputError
        If a file cannot be removed.
    """
    with writing(folder):
        for name in listed if isinstance(listed, list) else []:
            if isinstance(name, str) and Path(name).name == name and name not in kept:
                (folder / name).unlink(missing_ok=True)


def _beside(path: Path) -> Path:
    """Name of a temporary file that `remove_leftovers` knows."""
    return path.with_name(f".{path.stem}-{secrets.token_hex(6)}.part{path.suffix}")


def _create(path: Path) -> None:
    # Not tempfile.mkstemp: its files are private, and a result should be as readable as any file of the user.
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))


def _flush_to_disk(path: Path) -> None:
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    # The rename itself is durable once the folder is; some systems cannot open folders, and then it stays
    # unflushed.
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
