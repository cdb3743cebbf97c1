"""Faults of muscles that only the meshes and the solver show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from femdeform.scene import schema
from femdeform.scene.key_path import KeyPath
from femdeform.scene.muscle_schema import CellDataFibres, ConstantFibres, Fibres, HarmonicFibres
from femdeform.scene.selection_checks import hint_of, judge_selection
from femdeform.scene.validation import Finding
from femdeform.types import Mesh

# Methods that minimise the energy of fibres.
_METHODS = ("projected_newton", "pbng", "fp_pxpbd")


def muscle_findings(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], coarse: frozenset[str]
) -> Iterator[Finding]:
    """Faults of the muscles of all bodies.

    Parameters
    ----------
    scene : DeformableScene
        A scene that passed the schema.
    meshes : mapping of str to Mesh
        Meshes by body, as far as there are any.
    coarse : frozenset of str
        Bodies whose mesh is a stand-in.
    """
    has_muscles = False
    for name, body in scene.bodies.items():
        if not isinstance(body, schema.SolidBody):
            continue
        mesh = meshes.get(name)
        for group, muscle in body.all_muscles:
            has_muscles = True
            path: KeyPath = ("bodies", name, "muscle") if group is None else ("bodies", name, "muscles", group)
            if mesh is not None and group is not None and group not in mesh.cell_groups:
                yield Finding(path, f"there is no group of cells `{group}`; {hint_of(group, mesh.cell_groups)}")
                continue
            yield from _fibre_findings(muscle.fibres, (*path, "fibres"), mesh, scene, meshes, coarse)
        if mesh is not None:
            yield from _overlap_findings(list(body.muscles), mesh, ("bodies", name, "muscles"))
    if has_muscles and scene.solver.method not in _METHODS:
        message = f"{scene.solver.method} does not know muscle fibres; use {', '.join(_METHODS)}"
        yield Finding(("solver", "method"), message)


def _fibre_findings(
    fibres: Fibres,
    path: KeyPath,
    mesh: Mesh | None,
    scene: schema.DeformableScene,
    meshes: Mapping[str, Mesh],
    coarse: frozenset[str],
) -> Iterator[Finding]:
    if isinstance(fibres, HarmonicFibres):
        yield from judge_selection(fibres.origin, (*path, "origin"), scene, meshes, coarse)
        yield from judge_selection(fibres.insertion, (*path, "insertion"), scene, meshes, coarse)
    elif mesh is None:
        return
    elif isinstance(fibres, ConstantFibres) and len(fibres.direction) != mesh.dim:
        message = f"needs {mesh.dim} entries in a {mesh.dim}D scene, not {len(fibres.direction)}"
        yield Finding((*path, "direction"), message)
    elif isinstance(fibres, CellDataFibres) and fibres.name not in mesh.cell_data:
        known = ", ".join(sorted(mesh.cell_data)) or "none"
        yield Finding((*path, "name"), f"the mesh has no vectors of cells `{fibres.name}` (there are: {known})")


def _overlap_findings(groups: list[str], mesh: Mesh, path: KeyPath) -> Iterator[Finding]:
    known = [group for group in groups if group in mesh.cell_groups]
    count = np.zeros(mesh.n_cells, dtype=np.int64)
    for group in known:
        count[mesh.cell_groups[group]] += 1
    if (count > 1).any():
        shared = [f"`{group}`" for group in known if (count[mesh.cell_groups[group]] > 1).any()]
        yield Finding(path, f"share cells, which can have the fibres of one muscle only: {', '.join(shared)}")
