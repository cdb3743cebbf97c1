"""Reads the frames (.vtu) and their list (.pvd) that `femdeform.run.vtu` writes, without VTK."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run.vtk_xml import DTYPES, HEADER
from femdeform.run.vtu import VTK_CELLS
from femdeform.types import FloatArray, IntArray

_NAMES = {number: name for name, (number, _) in VTK_CELLS.items()}


@dataclass(frozen=True)
class VTUContents:
    """What a ``.vtu`` file holds, in read-only arrays; `cell_data` has one array per block.

    Neighbouring blocks of one cell type, say the tetrahedra of two bodies, come back as one block.
    """

    time: float
    points: FloatArray
    blocks: list[tuple[str, IntArray]]
    point_data: dict[str, NDArray[Any]]
    cell_data: dict[str, list[NDArray[Any]]]


def read_vtu(path: Path) -> VTUContents:
    """Read a file written by `VTUWriter`.

    Parameters
    ----------
    path : Path
        The ``.vtu`` file.

    Raises
    ------
    InputError
        If the file is missing, torn, or not of the kind `VTUWriter` writes.
    """
    try:
        root = ElementTree.parse(path).getroot()
        piece = _child(root, "UnstructuredGrid/Piece")
        points = _read_array(_child(piece, "Points/DataArray"))
        cells = {array.get("Name"): _read_array(array) for array in piece.findall("Cells/DataArray")}
        blocks, bounds = _split_blocks(cells["connectivity"], cells["offsets"], cells["types"])
        point_data = {str(a.get("Name")): _read_array(a) for a in piece.findall("PointData/DataArray")}
        cell_data = {str(a.get("Name")): _read_array(a) for a in piece.findall("CellData/DataArray")}
        counts = int(piece.get("NumberOfPoints", -1)), int(piece.get("NumberOfCells", -1))
        if len(points) != counts[0] or any(len(array) != counts[0] for array in point_data.values()):
            raise ValueError(f"the arrays of points do not have {counts[0]} entries")
        if bounds[-1] != counts[1] or any(len(array) != counts[1] for array in cell_data.values()):
            raise ValueError(f"the arrays of cells do not have {counts[1]} entries")
        for _, block in blocks:
            if block.size and (block.min() < 0 or block.max() >= counts[0]):
                raise ValueError("a cell refers to a point that is not there")
        return VTUContents(
            time=_time_of(root),
            points=points.astype(np.float64),
            blocks=blocks,
            point_data=point_data,
            cell_data={
                name: [array[first:last] for first, last in pairwise(bounds)] for name, array in cell_data.items()
            },
        )
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
    try:
        return _time_of(ElementTree.parse(path).getroot())
    except (OSError, ElementTree.ParseError, zlib.error, ValueError, KeyError, IndexError) as error:
        message = f"the file is corrupt or not a frame of femdeform ({error})"
        raise InputError([Fault(str(path), 0, "", message)]) from error


def _time_of(root: ElementTree.Element) -> float:
    time = root.find("*/FieldData/DataArray[@Name='TimeValue']")
    return float(_read_array(time)[0]) if time is not None else float("nan")


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


def _read_array(element: ElementTree.Element) -> NDArray[Any]:
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


def _child(element: ElementTree.Element, path: str) -> ElementTree.Element:
    found = element.find(path)
    if found is None:
        raise ValueError(f"<{path}> is missing")
    return found


def _split_blocks(
    connectivity: IntArray, offsets: IntArray, types: NDArray[np.uint8]
) -> tuple[list[tuple[str, IntArray]], list[int]]:
    # Runs of equal types are the blocks, as the writer laid them down one after the other.
    changes = np.flatnonzero(np.diff(types)) + 1
    bounds = [0, *changes.tolist(), len(types)] if len(types) else [0]
    starts = np.concatenate([[0], offsets])
    blocks = []
    for first, last in pairwise(bounds):
        name = _NAMES[int(types[first])]
        cells = connectivity[starts[first] : starts[last]].reshape(-1, VTK_CELLS[name][1])
        blocks.append((name, cells.astype(np.int64)))
    return blocks, bounds
