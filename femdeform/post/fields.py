"""Which field of a frame to colour by: its values, its label with the unit, and whether it names bodies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run.frames import BodyFrame
from femdeform.types import FloatArray

UNITS = {
    "displacement": "m",
    "velocity": "m/s",
    "von_mises": "Pa",
    "cauchy_stress": "Pa",
    "pk1": "Pa",
    "energy_density": "J/m³",
    "jacobian": "-",
}
NAMES_OF_PARTS = ("body", "region")
MARKS = ("contact",)

_VECTOR = {"x": 0, "y": 1, "z": 2}
_TENSOR = {a + b: 3 * i + j for i, a in enumerate("xyz") for j, b in enumerate("xyz")}


@dataclass(frozen=True)
class Field:
    """A scalar to colour by.

    Attributes
    ----------
    values : (n_points,) or (n_cells,) float64
        Cells counted over all blocks.
    on_cells : bool
        Whether there is a value per cell.
    label : str
        Name and unit.
    categorical : bool
        Whether the values number bodies or regions.
    is_norm : bool
        Whether the values are lengths of vectors or tensors, whose colours start at zero.
    is_mark : bool
        Whether the values are 1 at marked places and 0 elsewhere.
    """

    values: FloatArray
    on_cells: bool
    label: str
    categorical: bool
    is_norm: bool = False
    is_mark: bool = False


def select_field(frame: BodyFrame, name: str | None, place: Path) -> Field:
    """Find a field in a frame.

    Parameters
    ----------
    frame : BodyFrame
        The frame.
    name : str, optional
        ``displacement`` (its norm; the default), ``velocity.x``, ``cauchy_stress.xy``, ``von_mises``,
        ``body``, ... A vector or tensor without a component stands for its norm.
    place : Path
        Result folder, for the error.

    Raises
    ------
    InputError
        If there is no such field or component.
    """
    base, _, component = (name or "displacement").partition(".")
    values: NDArray[Any]
    if base in frame.point_data:
        values, on_cells = frame.point_data[base], False
    elif base in frame.cell_data:
        values, on_cells = np.concatenate([np.asarray(part) for part in frame.cell_data[base]]), True
    else:
        known = ", ".join(sorted({*frame.point_data, *frame.cell_data}))
        raise InputError([Fault(str(place), 0, "", f"no field {base!r} in this result; it has {known}")])
    unit = f" [{UNITS[base]}]" if base in UNITS else ""
    title = base.replace("_", " ")
    if component:
        columns = {3: _VECTOR, 9: _TENSOR}.get(values.shape[1] if values.ndim == 2 else 1, {})
        if component not in columns:
            known = f"its components are {', '.join(columns)}" if columns else "it has no components"
            message = f"field {base!r} has no component {component!r}; {known}"
            raise InputError([Fault(str(place), 0, "", message)])
        return Field(_floats(values[:, columns[component]]), on_cells, f"{title} {component}{unit}", False)
    is_norm = values.ndim == 2
    if is_norm:
        values = np.linalg.norm(values, axis=1)
    return Field(_floats(values), on_cells, title + unit, base in NAMES_OF_PARTS, is_norm, base in MARKS)


def value_range(values: FloatArray) -> tuple[float, float]:
    """Smallest and largest finite value; (0, 0) where there is none."""
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def _floats(values: NDArray[Any]) -> FloatArray:
    return np.ascontiguousarray(values, dtype=np.float64)
