"""Parts of VTK's XML files, written without VTK: arrays, the document around them, lists of frames.

Arrays are stored inline as zlib blocks in base64, so that a file is well-formed XML, needs no byte offsets, and is read
by ParaView, VTK and meshio alike. Numbers keep all their digits.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from femdeform.run import atomic

_TYPE_NAMES = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "i4": "Int32", "u1": "UInt8"}
DTYPES = {name: np.dtype("<" + code) for code, name in _TYPE_NAMES.items()}
HEADER = np.dtype("<u8")

_BLOCK = 1 << 20  # bytes a zlib block holds before compression
_LEVEL = 1  # higher levels cost several times as long and save a few percent on floating-point data


def write_document(path: Path, kind: str, attributes: str, time: float, piece: Iterable[str]) -> None:
    """Write a VTK file of one piece atomically.

    Parameters
    ----------
    path : Path
        The file.
    kind : str
        ``UnstructuredGrid``, ``PolyData`` or ``ImageData``.
    attributes : str
        Attributes of the element of that name, with a space before each.
    time : float
        Time [s], stored as ``TimeValue``, where ParaView looks for it.
    piece : iterable of str
        The element ``Piece`` with all that is in it.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    text = [
        '<?xml version="1.0"?>\n',
        f'<VTKFile type="{kind}" version="1.0" byte_order="LittleEndian" header_type="UInt64" ',
        f'compressor="vtkZLibDataCompressor">\n<{kind}{attributes}>\n',
        "<FieldData>\n",
        data_array("TimeValue", np.array([time]), tuples=1),
        "</FieldData>\n",
        *piece,
        f"</{kind}>\n</VTKFile>\n",
    ]
    atomic.write_text(path, "".join(text))


def write_pvd(path: Path, entries: Sequence[tuple[float, str]]) -> None:
    """Write the list of frames that ParaView opens as one animation.

    Parameters
    ----------
    path : Path
        The ``.pvd`` file.
    entries : sequence of (time, file)
        Time [s] and path of each frame relative to the ``.pvd``, with forward slashes.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    rows = [f'<DataSet timestep="{time!r}" part="0" file={quoteattr(file)}/>\n' for time, file in entries]
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n'
    atomic.write_text(path, head + "".join(rows) + "</Collection>\n</VTKFile>\n")


def as_vtk_columns(array: NDArray[Any]) -> NDArray[Any]:
    """Bring an array into the columns VTK takes for scalars, vectors and tensors.

    Parameters
    ----------
    array : (n,), (n, k), (n, 2, 2) or (n, 3, 3) array
        Two components become three with a zero, 2 x 2 becomes the upper left part of 3 x 3, row by row.
    """
    if array.ndim == 3 and array.shape[1:] == (2, 2):
        array = np.pad(array, ((0, 0), (0, 1), (0, 1)))
    if array.ndim == 3 and array.shape[1:] == (3, 3):
        return np.reshape(array, (len(array), 9))
    if array.ndim == 2 and array.shape[1] == 2:
        return np.pad(array, ((0, 0), (0, 1)))
    if array.ndim == 2 and array.shape[1] == 1:
        return array[:, 0]
    if array.ndim > 2 or array.ndim < 1:
        raise ValueError(f"an array of shape {array.shape} is neither scalars, vectors nor tensors")
    return array


def data_array(name: str, array: NDArray[Any], *, tuples: int | None = None) -> str:
    """The element ``DataArray`` of an array (n,) or (n, k); `tuples` says how many there are, in field data."""
    if array.dtype == np.bool_:
        array = array.astype(np.uint8)
    code = f"{array.dtype.kind}{array.dtype.itemsize}"
    if code not in _TYPE_NAMES:
        array = array.astype(np.float64 if array.dtype.kind == "f" else np.int64)
        code = f"{array.dtype.kind}{array.dtype.itemsize}"
    attributes = f'type="{_TYPE_NAMES[code]}" Name={quoteattr(name)}'
    if array.ndim == 2:
        attributes += f' NumberOfComponents="{array.shape[1]}"'
    if tuples is not None:
        attributes += f' NumberOfTuples="{tuples}"'
    encoded = _encode(np.ascontiguousarray(array, dtype=DTYPES[_TYPE_NAMES[code]]))
    return f'<DataArray {attributes} format="binary">{encoded}</DataArray>\n'


def _encode(array: NDArray[Any]) -> str:
    data = array.tobytes()
    blocks = [zlib.compress(data[start : start + _BLOCK], _LEVEL) for start in range(0, len(data), _BLOCK)]
    # Number of blocks, size of a full block, size of the last one when it is not full, compressed sizes.
    header = np.array([len(blocks), _BLOCK, len(data) % _BLOCK, *map(len, blocks)], dtype=HEADER)
    return (base64.b64encode(header.tobytes()) + base64.b64encode(b"".join(blocks))).decode("ascii")
