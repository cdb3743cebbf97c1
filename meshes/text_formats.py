"""Text formats read here, because they carry more than the general readers keep.

Medit files of version 1 are read in single precision elsewhere although their text has all digits; Wavefront
files may hold lines, polygons, groups, and normals numbered on their own.
"""

from __future__ import annotations

import re
from contextlib import suppress
from itertools import islice

import numpy as np

from femdeform.errors import MeshError
from femdeform.types import FloatArray, IntArray
from meshes.parts import PART_SIZES, MeshParts, NamedPart, PartKind, fault

_MEDIT_CELLS: dict[str, PartKind] = {
    "edges": "line",
    "triangles": "triangle",
    "tetrahedra": "tetra",
}
# Numbers a record of sections that carry no cells we use; any other section's cells are refused.
_MEDIT_SKIPPED = {
    "corners": 1,
    "requiredvertices": 1,
    "ridges": 1,
    "requirededges": 1,
    "requiredtriangles": 1,
    "normals": 3,
    "tangents": 3,
    "normalatvertices": 2,
    "tangentatvertices": 2,
}
_MEDIT_REFUSED = {"quadrilaterals", "hexahedra", "prisms", "pyramids", "hexaedra"}


def read_medit(text: str, name: str) -> tuple[FloatArray, dict[PartKind, IntArray], dict[PartKind, IntArray]]:
    """Read an ASCII Medit (.mesh) file.

    Returns
    -------
    points : (n, dim) float64
        Positions.
    cells : dict of str to (n, k) int64
        0-based nodes of lines, triangles and tetrahedra; empty sections are left out.
    references : dict of str to (n,) int64
        Reference number of each cell.

    Raises
    ------
    MeshError
        If the file breaks off, has no vertices, or holds other cells.
    """
    text = re.sub(r"#[^\n]*", "", text) if "#" in text else text
    words = text.split()
    dim = 3
    points: FloatArray | None = None
    cells: dict[PartKind, IntArray] = {}
    references: dict[PartKind, IntArray] = {}
    at = 0

    def table(width: int, dtype: type) -> tuple[int, FloatArray]:
        count = int(words[at + 1])
        chunk = words[at + 2 : at + 2 + count * width]
        if count < 0 or len(chunk) != count * width:
            raise fault(name, f"breaks off in section {words[at]} ({len(chunk) // width} of {count} rows)")
        rows: FloatArray | None = None
        with suppress(ValueError, OverflowError):
            rows = np.array(chunk, dtype=dtype)
        if rows is None or not np.all(np.isfinite(rows)):
            raise _bad_number(text, name, chunk, at + 2, dtype)
        return count * width + 2, rows.reshape(count, width)

    while at < len(words):
        key = words[at].lower()
        if key == "end":
            break
        if key == "meshversionformatted":
            at += 2
        elif key == "dimension":
            dim = int(words[at + 1])
            at += 2
        elif key == "vertices":
            used, rows = table(dim + 1, np.float64)
            points = rows[:, :dim]
            at += used
        elif key in _MEDIT_CELLS:
            kind = _MEDIT_CELLS[key]
            used, rows = table(PART_SIZES[kind] + 1, np.int64)
            if len(rows):
                cells[kind] = rows[:, :-1].astype(np.int64) - 1
                references[kind] = rows[:, -1].astype(np.int64)
            at += used
        elif key in _MEDIT_SKIPPED:
            at += 2 + int(words[at + 1]) * _MEDIT_SKIPPED[key]
        elif key in _MEDIT_REFUSED and int(words[at + 1]) > 0:
            raise fault(name, f"{words[at + 1]} {key}: only edges, triangles and tetrahedra can be read")
        elif key in _MEDIT_REFUSED:
            at += 2
        else:
            raise fault(name, f"unknown section `{words[at][:40]}`")
    if points is None:
        raise fault(name, "no section Vertices in it")
    return points, cells, references


def read_obj(text: str, name: str) -> MeshParts:
    """Read a Wavefront (.obj) file: vertices, lines, faces (polygons are cut into fans), groups (`g`).

    Raises
    ------
    MeshError
        If there are no vertices, or curved elements.
    """
    lines = [line.split(None, 1) for line in text.replace("\\\n", " ").splitlines()]
    tagged = [(entry[0], entry[1] if len(entry) > 1 else "") for entry in lines if entry]
    vertices = [rest.split()[:3] for tag, rest in tagged if tag == "v"]
    if not vertices:
        raise fault(name, "no vertices in it")
    if any(tag in ("curv", "surf") for tag, _ in tagged):
        raise fault(name, "free-form curves and surfaces cannot be read, only lines and faces")
    points: FloatArray | None = None
    with suppress(ValueError):
        points = np.array(vertices, dtype=np.float64)
    if points is None or points.shape[1:] != (3,) or not np.all(np.isfinite(points)):
        raise _bad_vertex(text, name)

    tags = np.array([tag for tag, _ in tagged])
    seen = np.cumsum(tags == "v")
    cells: dict[PartKind, IntArray] = {}
    named: list[NamedPart] = []
    notices: list[str] = []
    if np.any(tags == "f"):
        at = np.flatnonzero(tags == "f")
        corners, lengths = _node_lists([tagged[i][1] for i in at], seen[at])
        if lengths.min() < 3:
            raise fault(name, f"face {int(np.argmin(lengths))} has fewer than three corners")
        cells["triangle"], origin = _fans(corners, lengths)
        if lengths.max() > 3:
            notices.append(f"{int(np.count_nonzero(lengths > 3))} polygons cut into triangles")
        # A group holds from its line on.
        starts = np.flatnonzero(tags == "g")
        group_of = np.searchsorted(starts, at, side="right")[origin] - 1
        for number, start in enumerate(starts):
            label, rows = "_".join(tagged[start][1].split()), np.flatnonzero(group_of == number)
            if len(rows) and label not in ("", "default", "(null)"):
                named.append(NamedPart(label, "triangle", rows))
    if np.any(tags == "l"):
        at = np.flatnonzero(tags == "l")
        corners, lengths = _node_lists([tagged[i][1] for i in at], seen[at])
        within = np.ones(len(corners), dtype=np.bool_)
        within[np.cumsum(lengths) - 1] = False  # the last node of a polyline starts no segment
        first = np.flatnonzero(within)
        cells["line"] = np.stack([corners[first], corners[first + 1]], axis=1)
    return MeshParts(points, cells, named, notices)


def _bad_vertex(text: str, name: str) -> MeshError:
    """Return the fault of the first vertex that is not three finite numbers."""
    mark = "\x1f"  # white space that stands for the line ends inside a continued line
    number = 1
    for line in text.replace("\\\n", mark).splitlines():
        tag, *words = line.split() or [""]
        if tag == "v" and len(words) < 3:
            return fault(name, f"line {number}: a vertex needs three coordinates, this one has {len(words)}")
        for word in words[:3] if tag == "v" else ():
            if not _is_number(word, np.float64):
                return fault(name, f"line {number}: {_number_complaint(word, np.float64)}")
        number += 1 + line.count(mark)
    return fault(name, "vertices without three finite coordinates")


def _bad_number(text: str, name: str, words: list[str], start: int, dtype: type) -> MeshError:
    """Return the fault of the first word that is no number; `start` words come before them in the text."""
    at, word = next((i, word) for i, word in enumerate(words) if not _is_number(word, dtype))
    place = next(islice(re.finditer(r"\S+", text), start + at, None)).start()
    return fault(name, f"line {text.count(chr(10), 0, place) + 1}: {_number_complaint(word, dtype)}")


def _is_number(word: str, dtype: type) -> bool:
    try:
        return bool(np.isfinite(dtype(word)))
    except (ValueError, OverflowError):
        return False


def _number_complaint(word: str, dtype: type) -> str:
    return f"`{word[:40]}` is not a {'whole' if dtype is np.int64 else 'finite'} number"


def _node_lists(rows: list[str], seen: IntArray) -> tuple[IntArray, IntArray]:
    """0-based nodes of all rows one after the other, and how many each row has."""
    lengths = np.array([len(row.split()) for row in rows], dtype=np.int64)
    # Of `node/texture/normal` only the node counts.
    numbers = np.array(re.sub(r"/\S*", "", " ".join(rows)).split(), dtype=np.int64)
    # Negative numbers count back from the vertices seen so far.
    return np.where(numbers > 0, numbers - 1, np.repeat(seen, lengths) + numbers), lengths


def _fans(corners: IntArray, lengths: IntArray) -> tuple[IntArray, IntArray]:
    """Cut polygons into triangles around their first corner; also the polygon each triangle came from."""
    starts = np.cumsum(lengths) - lengths
    origin = np.repeat(np.arange(len(lengths)), lengths - 2)
    step = np.arange(len(origin)) - np.repeat(np.cumsum(lengths - 2) - (lengths - 2), lengths - 2)
    first = starts[origin]
    triangles = np.stack([corners[first], corners[first + step + 1], corners[first + step + 2]], axis=1)
    return triangles.astype(np.int64), origin
