"""From the muscles of a scene to the fibres of cells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from femdeform.errors import InputError
from femdeform.fem.conditions import Curve
from femdeform.fem.fibre_fields import constant_directions, harmonic_directions, stored_directions
from femdeform.fem.fibres import FibreInput, Muscle
from femdeform.scene import muscle_schema
from femdeform.scene.amplitude_schema import Amplitude
from femdeform.scene.selection_schema import Selection
from femdeform.scene.selections import select_nodes
from femdeform.types import FloatArray, IntArray, Mesh


def muscle_inputs(name: str, body: Any, meshes: Mapping[str, Mesh]) -> list[FibreInput]:
    """Fibres of the cells of a body.

    Parameters
    ----------
    name : str
        The body's name.
    body : schema.Body
        Its block.
    meshes : mapping of str to Mesh
        Meshes of all bodies.

    Raises
    ------
    InputError
        If a muscle has no direction in some cell.
    """
    inputs = []
    for group, muscle in getattr(body, "all_muscles", ()):
        mesh = meshes[name]
        cells = np.arange(mesh.n_cells, dtype=np.int64) if group is None else np.sort(mesh.cell_groups[group])
        key = f"bodies.{name}.muscle" if group is None else f"bodies.{name}.muscles.{group}"
        try:
            directions = _directions(muscle.fibres, name, cells, meshes)
        except InputError as error:
            raise InputError(f"{key}.fibres: {error.faults[0].message}") from None
        law = Muscle(muscle.max_isometric_stress, muscle.optimal_stretch, _activation(muscle.activation))
        inputs.append(FibreInput(cells, directions, law))
    return inputs


def _activation(value: float | Amplitude) -> Curve:
    if isinstance(value, Amplitude):
        return Curve(np.array(value.times), np.array(value.values))
    return Curve(np.zeros(1), np.array([value]))


def _directions(fibres: muscle_schema.Fibres, name: str, cells: IntArray, meshes: Mapping[str, Mesh]) -> FloatArray:
    mesh = meshes[name]
    if isinstance(fibres, muscle_schema.ConstantFibres):
        return constant_directions(fibres.direction, len(cells))
    if isinstance(fibres, muscle_schema.CellDataFibres):
        return stored_directions(mesh, fibres.name, cells)
    ends = [_nodes(selection, name, meshes) for selection in (fibres.origin, fibres.insertion)]
    return harmonic_directions(mesh, cells, *ends)


def _nodes(selection: Selection, name: str, meshes: Mapping[str, Mesh]) -> IntArray:
    """Points of a body's mesh that a selection names; what it names of other bodies does not count."""
    return select_nodes(selection, meshes).get(name, np.empty(0, dtype=np.int64))
