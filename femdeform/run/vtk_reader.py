"""Parts of VTK's XML files as `femdeform.run.vtk_xml` writes them, read without VTK."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run.vtk_xml import DTYPES, HEADER

Arrays = dict[str, NDArray[Any]]


@contextmanager
def reading(path: Path) -> Iterator[ElementTree.Element]:
    """The root of a frame's file; whatever is wrong with the file inside of the block is an `InputError`.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    InputError
        If the file is missing or torn, or the block raises ValueError, KeyError or IndexError.
    """
    try:
        yield ElementTree.parse(path).getroot()
    except FileNotFoundError as error:
        raise InputError([Fault(str(path), 0, "", "no such file")]) from error
    except (OSError, ElementTree.ParseError, zlib.error, ValueError, KeyError, IndexError) as error:
        message = f"the file is corrupt or not a frame of femdeform ({error})"
        raise InputError([Fault(str(path), 0, "", message)]) from error


def read_time(path: Path) -> float:
    """Time of a frame of any kind [s]; NaN where it has none.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    with reading(path) as root:
        return time_of(root)


def time_of(root: ElementTree.Element) -> float:
    """Time of a frame [s]; NaN where it has none."""
    time = root.find("*/FieldData/DataArray[@Name='TimeValue']")
    return float(read_array(time)[0]) if time is not None else float("nan")


def read_pvd(path: Path) -> list[tuple[float, str]]:
    """Times and files of the frames in a ``.pvd``; an empty list where there is no such file.

    Raises
    ------
    InputError
        If the file is not a list of frames.
    """
    try:
        rows = ElementTree.parse(path).getroot().iterfind("Collection/DataSet")
        return [(float(row.attrib["timestep"]), row.attrib["file"]) for row in rows]
    except FileNotFoundError:
        return []
    except (OSError, ElementTree.ParseError, KeyError, ValueError) as error:
        raise InputError([Fault(str(path), 0, "", f"the list of frames is corrupt ({error})")]) from error


def child(element: ElementTree.Element, path: str) -> ElementTree.Element:
    """An element below another one.

    Raises
    ------
    ValueError
        If there is none.
    """
    found = element.find(path)
    if found is None:
        raise ValueError(f"<{path}> is missing")
    return found


def read_arrays(piece: ElementTree.Element, group: str, n: int) -> Arrays:
    """The arrays of a group (``PointData``, ``CellData``) by name.

    Raises
    ------
    ValueError
        If one of them has not `n` entries.
    """
    arrays = {str(array.get("Name")): read_array(array) for array in piece.findall(f"{group}/DataArray")}
    if any(len(array) != n for array in arrays.values()):
        raise ValueError(f"the arrays of {'points' if group == 'PointData' else 'cells'} do not have {n} entries")
    return arrays


def read_array(element: ElementTree.Element) -> NDArray[Any]:
    """A ``DataArray``, (n,) or (n, k), read-only.

    Raises
    ------
    ValueError, KeyError, IndexError, zlib.error
        If it is damaged.
    """
    if element.get("format") != "binary":
        raise ValueError(f"array {element.get('Name')!r} is not of the inline binary format")
    text = (element.text or "").strip()
    n_blocks = int(np.frombuffer(base64.b64decode(text[:12], validate=True), dtype=HEADER, count=1)[0])
    # Header and blocks are encoded one after the other, each padded to full groups of four characters.
    n_header = -(-8 * (3 + n_blocks) // 3) * 4
    header = np.frombuffer(base64.b64decode(text[:n_header], validate=True), dtype=HEADER)
    packed = base64.b64decode(text[n_header:], validate=True)
    ends = np.cumsum(header[3:]).astype(np.int64)
    if len(header) != 3 + n_blocks or (n_blocks and ends[-1] != len(packed)):
        raise ValueError(f"array {element.get('Name')!r} is cut short")
    parts = [packed[start:end] for start, end in zip([0, *ends], ends, strict=False)]
    array = np.frombuffer(b"".join(map(zlib.decompress, parts)), dtype=DTYPES[element.get("type", "")])
    n_components = int(element.get("NumberOfComponents", 1))
    return array.reshape(-1, n_components) if n_components > 1 else array
