"""Which field of a frame to colour by: its values, its label with the unit, and whether it names bodies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.flow.curl import vorticity
from femdeform.run.frames import BodyFrame, Frame, GridFrame, ParticleFrame
from femdeform.types import FloatArray

UNITS = {
    "displacement": "m",
    "velocity": "m/s",
    "von_mises": "Pa",
    "cauchy_stress": "Pa",
    "pk1": "Pa",
    "energy_density": "J/m³",
    "density": "-",
    "speed": "m/s",
    "pressure": "Pa",
    "vorticity": "1/s",
    "divergence": "1/s",
    "temperature": "K",
    "J": "-",
    "jacobian": "-",
}
NAMES_OF_PARTS = ("body", "region", "phase", "solid")
MARKS = ("contact",)
# Nothing of these is their lowest value.
AMOUNTS = ("density", "speed")
# Zero is in the middle of these.
SIGNED = ("pressure", "vorticity", "divergence")
# What particles show unless something else is asked for, in this order, if it differs among them.
_OF_PARTICLES = ("temperature", "velocity", "J", "phase", "body")

_VECTOR = {"x": 0, "y": 1, "z": 2}
# By name: what gives the values, (n,) or (n, k), and whether they are those of cells.
_Columns = dict[str, tuple[Callable[[], NDArray[Any]], bool]]
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
        Whether the values are lengths of vectors or tensors, or amounts, whose colours start at zero.
    is_mark : bool
        Whether the values are 1 at marked places and 0 elsewhere.
    is_signed : bool
        Whether zero is a value like none other, with values on both sides.
    """

    values: FloatArray
    on_cells: bool
    label: str
    categorical: bool
    is_norm: bool = False
    is_mark: bool = False
    is_signed: bool = False


def select_field(frame: Frame, name: str | None, place: Path) -> Field:
    """Find a field in a frame.

    Parameters
    ----------
    frame : Frame
        The frame.
    name : str, optional
        ``displacement`` (its norm; the default for bodies), ``velocity.x``, ``cauchy_stress.xy``, ``von_mises``,
        ``body``, ``density``, ... A vector or tensor without a component stands for its norm.
    place : Path
        Result folder, for the error.

    Returns
    -------
    Field
        Values of voxels are those of the array (nx, ny, nz), its last index fastest.

    Raises
    ------
    InputError
        If there is no such field or component.
    """
    known = _columns(frame)
    base, _, component = (name or default_field(frame)).partition(".")
    if base not in known:
        message = f"no field {base!r} in this result; it has {', '.join(sorted(known))}"
        raise InputError([Fault(str(place), 0, "", message)])
    make, on_cells = known[base]
    values = make()
    unit = f" [{UNITS[base]}]" if base in UNITS else ""
    title = base.replace("_", " ")
    if component:
        columns = {3: _VECTOR, 9: _TENSOR}.get(values.shape[1] if values.ndim == 2 else 1, {})
        if component not in columns:
            known_ones = f"its components are {', '.join(columns)}" if columns else "it has no components"
            message = f"field {base!r} has no component {component!r}; {known_ones}"
            raise InputError([Fault(str(place), 0, "", message)])
        column = _floats(values[:, columns[component]])
        return Field(column, on_cells, f"{title} {component}{unit}", False, is_signed=True)
    is_norm = values.ndim == 2
    if is_norm:
        values = np.linalg.norm(values, axis=1)
    return Field(
        _floats(values),
        on_cells,
        title + unit,
        base in NAMES_OF_PARTS,
        is_norm or base in AMOUNTS,
        base in MARKS,
        base in SIGNED and not is_norm,
    )


def default_field(frame: Frame) -> str:
    """What a frame is coloured by unless something else is asked for.

    That is the displacement of bodies and the density of smoke. Particles show their temperature if it differs among
    them, else the velocity.
    """
    if isinstance(frame, BodyFrame):
        return "displacement"
    if isinstance(frame, GridFrame):
        return next((name for name in ("density", *frame.cell_data) if name in frame.cell_data), "density")
    present = [name for name in (*_OF_PARTICLES, *frame.point_data) if name in frame.point_data]
    varied = (name for name in present if len(frame.positions) and np.ptp(frame.point_data[name], axis=0).any())
    return next(varied, present[0] if present else "velocity")


def _columns(frame: Frame) -> _Columns:
    """For each field what gives its values, (n,) or (n, k), and whether they are those of cells."""
    if isinstance(frame, ParticleFrame):
        given = _at_hand(frame.point_data, False)
        return ({"speed": given["velocity"]} if "velocity" in given else {}) | given
    if isinstance(frame, BodyFrame):
        merged = {name: partial(_joined, parts) for name, parts in frame.cell_data.items()}
        return {name: (make, True) for name, make in merged.items()} | _at_hand(frame.point_data, False)
    rows = {name: values.reshape(-1, *values.shape[3:]) for name, values in frame.cell_data.items()}
    given = _at_hand(rows, True)
    if "velocity" not in rows:
        return given
    derived: _Columns = {"speed": given["velocity"], "vorticity": (partial(_vorticity, frame), True)}
    return derived | given


def _at_hand(arrays: Mapping[str, NDArray[Any]], on_cells: bool) -> _Columns:
    return {name: (partial(np.asarray, values), on_cells) for name, values in arrays.items()}


def _joined(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return np.concatenate([np.asarray(part) for part in parts])


def _vorticity(frame: GridFrame) -> NDArray[Any]:
    values = vorticity(frame.cell_data["velocity"], float(frame.spacing[0]), frame.dim)
    return values.reshape(-1, *values.shape[3:])


def value_range(values: FloatArray) -> tuple[float, float]:
    """Smallest and largest finite value; (0, 0) where there is none."""
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def _floats(values: NDArray[Any]) -> FloatArray:
    return np.ascontiguousarray(values, dtype=np.float64)
