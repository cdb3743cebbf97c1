"""Tables that grow by a row at a time and survive a kill: ``history.csv`` and ``iterations.csv``.

A row is written and flushed in one go. Only the last line can be torn, and it then lacks its line end: it
is dropped on reading and on resuming.
"""

from __future__ import annotations

import contextlib
import csv
import os
from collections.abc import Mapping, Sequence
from io import FileIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run import atomic

Value = float | int | str


class Table:
    """A CSV file to append to; goes on with the columns of a file that is there already.

    Parameters
    ----------
    path : Path
        The file; created with the first row.
    columns : sequence of str
        Columns that are always there and come first; others follow in the order of the first row.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.path = path
        self._standard = tuple(columns)
        self._columns: list[str] | None = None
        self._file: FileIO | None = None
        if path.exists():
            self._columns = _read_lines(path)[0] or None

    def append(self, row: Mapping[str, Value]) -> None:
        """Write one row and hand it to the system.

        Raises
        ------
        OutputError
            If it cannot be written.
        ValueError
            If the row has no `step`, or a column that the table does not have.
        """
        if "step" not in row:
            raise ValueError(f"a row of {self.path.name} needs `step`")
        row = {**row, "step": int(row["step"])}
        lines = []
        if self._columns is None:
            self._columns = [*self._standard, *(name for name in row if name not in self._standard)]
            lines.append(self._columns)
        unknown = [name for name in row if name not in self._columns]
        if unknown:
            raise ValueError(f"{self.path.name} has no column {unknown[0]!r}: its first row fixed them")
        lines.append([_cell(row[name]) if name in row else "" for name in self._columns])
        with atomic.writing(self.path):
            if self._file is None:
                # Without a buffer: what a full disk leaves in one would be written later, behind our back.
                self._file = FileIO(self.path, "a")
            _append(self._file, _to_csv(lines).encode("utf-8"))

    def sync(self) -> None:
        """Flush to the disk itself."""
        if self._file is not None:
            with atomic.writing(self.path):
                os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file; the next row would open it again."""
        if self._file is not None:
            with contextlib.suppress(OSError):  # every row is with the system already
                self._file.close()
            self._file = None


def _append(file: FileIO, data: bytes) -> None:
    """Write all of it or, where the disk is full, nothing."""
    size = os.fstat(file.fileno()).st_size
    rest = memoryview(data)
    try:
        while rest:
            rest = rest[file.write(rest) :]
    except BaseException:
        with contextlib.suppress(OSError):
            file.truncate(size)
        raise


def read_table(path: Path) -> dict[str, NDArray[Any]]:
    """Read a table by columns.

    Parameters
    ----------
    path : Path
        The CSV file.

    Returns
    -------
    dict of str to (n_rows,) arrays
        int64 where every cell is an integer, float64 where every cell is a number or empty (NaN), else str.
        A torn last line is left out.

    Raises
    ------
    InputError
        If the file is missing, or a line other than a torn last one does not have the cells of the header.
    """
    columns, rows = _read_lines(path)
    return {name: _column([row[i] for row in rows]) for i, name in enumerate(columns)}


def last_step(path: Path) -> int:
    """Step of the last whole row; 0 where there is no row or no file."""
    if not path.exists():
        return 0
    columns, rows = _read_lines(path)
    return _steps(path, columns, rows)[-1] if rows else 0


def time_of_step(path: Path, step: int) -> float | None:
    """Time of a step, None where the table has no row of it."""
    if not path.exists():
        return None
    columns, rows = _read_lines(path)
    for number, row in zip(_steps(path, columns, rows), rows, strict=True):
        if number == step and "time" in columns and row[columns.index("time")]:
            return float(row[columns.index("time")])
    return None


def truncate_table(path: Path, step: int) -> None:
    """Drop the rows after a step, and a torn last line; a table without rows left is removed.

    Raises
    ------
    InputError
        If the table is corrupt.
    OutputError
        If it cannot be written.
    """
    if not path.exists():
        return
    columns, rows = _read_lines(path)
    steps = _steps(path, columns, rows)
    kept = [row for number, row in zip(steps, rows, strict=True) if number <= step]
    if kept:
        atomic.write_text(path, _to_csv([columns, *kept]))
    else:
        with atomic.writing(path):
            path.unlink()


def _read_lines(path: Path) -> tuple[list[str], list[list[str]]]:
    try:
        data = path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1].decode("utf-8")
        lines = list(csv.reader(StringIO(whole)))
    except FileNotFoundError as error:
        raise InputError([Fault(str(path), 0, "", "no such file")]) from error
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError([Fault(str(path), 0, "", f"the table cannot be read ({error})")]) from error
    if not lines:
        return [], []
    columns, rows = lines[0], lines[1:]
    for number, row in enumerate(rows, start=2):
        if len(row) != len(columns):
            message = f"{len(row)} cells, the header has {len(columns)}: the table is corrupt"
            raise InputError([Fault(str(path), number, "", message)])
    return columns, rows


def _steps(path: Path, columns: list[str], rows: list[list[str]]) -> list[int]:
    if not rows:
        return []
    try:
        index = columns.index("step")
        return [int(row[index]) for row in rows]
    except ValueError as error:
        raise InputError([Fault(str(path), 0, "step", f"the table is corrupt ({error})")]) from error


def _column(cells: list[str]) -> NDArray[Any]:
    try:
        return np.array([int(cell) for cell in cells], dtype=np.int64)
    except (ValueError, OverflowError):
        pass
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells], dtype=np.float64)
    except ValueError:
        return np.array(cells, dtype=np.str_)


def _cell(value: Value) -> str:
    if isinstance(value, str):
        return " ".join(value.splitlines())  # a line of the file is a row
    if isinstance(value, bool | np.bool_):
        return str(int(value))
    if isinstance(value, int | np.integer):
        return str(int(value))
    # repr gives the shortest digits that read back as the same number.
    return repr(float(value))


def _to_csv(lines: Sequence[Sequence[str]]) -> str:
    stream = StringIO()
    csv.writer(stream, lineterminator="\n").writerows(lines)
    return stream.getvalue()
