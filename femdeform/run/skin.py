"""Skins in a result folder: which nodes every point of a fine surface follows, so that frames can be drawn with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from femdeform import registry
from femdeform.errors import Fault, InputError
from femdeform.fem.interpolation import nodal_weights
from femdeform.run import atomic
from femdeform.run.setup import Simulation
from femdeform.types import FloatArray, IntArray, Mesh

FILE_NAME = "skins.npz"
_ARRAYS = ("points", "triangles", "cells", "nodes", "weights")


@dataclass(frozen=True)
class Skin:
    """A surface bound to a body.

    Attributes
    ----------
    body : int
        Number of the body, as in the cell data `body` of the frames.
    points : (n, 3) float64
        Reference positions [m].
    triangles : (m, 3) int64
        Triangles over the points.
    cells : (n,) int64
        Cell of the body that each point is bound to.
    nodes : (n, k) int64
        Points of the frames that each point follows.
    weights : (n, k) float64
        Their weights, which add up to one [-].
    """

    body: int
    points: FloatArray
    triangles: IntArray
    cells: IntArray
    nodes: IntArray
    weights: FloatArray


def bind_skins(simulation: Simulation, surfaces: Mapping[str, Mesh]) -> tuple[list[Skin], list[str]]:
    """Bind the surfaces of a scene to their bodies.

    Parameters
    ----------
    simulation : Simulation
        The wired scene.
    surfaces : mapping of str to Mesh
        Triangles in space, by body.

    Returns
    -------
    skins : list of Skin
    notices : list of str
        Which surfaces reach far out of their body.
    """
    skins, notices = [], []
    for number, (name, mesh) in enumerate(simulation.meshes.items()):
        if name not in surfaces:
            continue
        surface, place = surfaces[name], simulation.discretization.bodies[name]
        bound = registry.resolve(registry.MESH["embed"])(mesh, surface.points)
        connectivity = place.connectivity
        weights = nodal_weights(bound.weights, mesh.cell_type, connectivity.shape[1])
        skins.append(
            Skin(
                number,
                surface.points,
                surface.cells,
                bound.cells,
                place.first + connectivity[bound.cells],
                weights,
            )
        )
        size = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
        reach = float(bound.distance.max(initial=0.0))
        if reach > 0.05 * size:
            notices.append(
                f"bodies.{name}.skin: the surface reaches {reach:.3g} m out of the body, {reach / size:.0%} of its size"
            )
    return skins, notices


def write_skins(folder: Path, skins: list[Skin]) -> None:
    """Write ``skins.npz`` into a result folder; nothing where there is no skin.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    if not skins:
        return
    arrays = {f"{skin.body}_{name}": getattr(skin, name) for skin in skins for name in _ARRAYS}
    stream = BytesIO()
    np.savez_compressed(stream, **arrays)
    atomic.write_bytes(folder / FILE_NAME, stream.getvalue())


def read_skins(folder: Path) -> list[Skin]:
    """Read the skins of a result folder; an empty list where there are none.

    Raises
    ------
    InputError
        If the file is corrupt.
    """
    path = folder / FILE_NAME
    if not path.exists():
        return []
    try:
        with np.load(path) as arrays:
            bodies = sorted({int(name.partition("_")[0]) for name in arrays.files})
            return [Skin(body, *(arrays[f"{body}_{name}"] for name in _ARRAYS)) for body in bodies]
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise InputError([Fault(str(path), 0, "", f"the file is corrupt ({error})")]) from error
