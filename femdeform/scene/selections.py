"""From an `on:` of a scene to nodes and facets of the meshes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from femdeform.errors import InputError
from femdeform.scene.selection_schema import BoxSelection, NodeSelection, PlaneSelection, Selection, SphereSelection
from femdeform.types import BoolArray, FloatArray, IntArray, Mesh

# What lies on the border of a box or sphere up to rounding belongs to it; relative to the size of the bodies.
_ROUNDING = 1e-9
_PLANE_TOLERANCE = 1e-6


def select_nodes(selection: Selection, meshes: Mapping[str, Mesh]) -> dict[str, IntArray]:
    """Nodes that a selection names.

    Parameters
    ----------
    selection : str or selection model
        ``body``, ``body.group``, or a box, plane, sphere or list of nodes.
    meshes : mapping of str to Mesh
        Meshes by body.

    Returns
    -------
    dict of str to (n,) int64
        Sorted nodes by body; bodies of which nothing is selected are left out.

    Raises
    ------
    InputError
        If a name does not exist, or a node number is out of range.
    """
    if isinstance(selection, str):
        body, group = split_name(selection, meshes)
        mesh = meshes[body]
        nodes = np.arange(mesh.n_points, dtype=np.int64) if group is None else mesh.group_nodes(group)
        return {body: nodes} if nodes.size else {}
    chosen = _bodies(selection.body, meshes)
    if isinstance(selection, NodeSelection):
        if len(chosen) > 1:
            raise InputError("`nodes` needs `body`, because there are several bodies")
        ((body, mesh),) = chosen.items()
        nodes = np.unique(np.array(selection.nodes, dtype=np.int64))
        if nodes[-1] >= mesh.n_points:
            raise InputError(f"node {nodes[-1]} is out of range; body `{body}` has {mesh.n_points} nodes, from 0")
        return {body: nodes}
    size = _size(chosen)
    inside = {body: np.flatnonzero(_is_inside(selection, mesh.points, size)) for body, mesh in chosen.items()}
    return {body: nodes for body, nodes in inside.items() if nodes.size}


def select_facets(selection: Selection, meshes: Mapping[str, Mesh]) -> dict[str, IntArray]:
    """Facets with an area that a selection names: of the boundary, or where a mesh is a surface in space, its cells.

    Parameters
    ----------
    selection : str or selection model
        A facet group gives its facets; anything else gives the facets all of whose nodes it selects.
    meshes : mapping of str to Mesh
        Meshes by body.

    Returns
    -------
    dict of str to (n, k - 1) int64
        Facets by body, outward, or as the cells of a surface are turned; bodies of which nothing is selected are left
        out.

    Raises
    ------
    InputError
        As `select_nodes`.
    """
    if isinstance(selection, str):
        body, group = split_name(selection, meshes)
        mesh = meshes[body]
        if group is not None and group in (mesh.cell_groups if _is_surface(mesh) else mesh.facet_groups):
            facets = mesh.cells[mesh.cell_groups[group]] if _is_surface(mesh) else mesh.facet_groups[group]
            return {body: facets} if len(facets) else {}
    result: dict[str, IntArray] = {}
    for body, nodes in select_nodes(selection, meshes).items():
        mesh = meshes[body]
        boundary = mesh.cells if _is_surface(mesh) else mesh.facet_groups.get("boundary")
        if boundary is None or not len(boundary):
            continue
        is_selected = np.zeros(mesh.n_points, dtype=np.bool_)
        is_selected[nodes] = True
        facets = boundary[is_selected[boundary].all(axis=1)]
        if len(facets):
            result[body] = facets
    return result


def _is_surface(mesh: Mesh) -> bool:
    """Whether its cells are facets themselves: those of membranes. The lines around them have no area."""
    return mesh.cell_type == "triangle" and mesh.dim == 3


def split_name(name: str, meshes: Mapping[str, Mesh]) -> tuple[str, str | None]:
    """Split ``body.group`` and make sure that both exist.

    Raises
    ------
    InputError
        If there is no such body or group.
    """
    body, dot, group = name.partition(".")
    if body not in meshes:
        raise InputError(f"there is no body `{body}`")
    if not dot:
        return body, None
    if group not in meshes[body].group_names():
        raise InputError(f"body `{body}` has no group `{group}`")
    return body, group


def _bodies(name: str | None, meshes: Mapping[str, Mesh]) -> dict[str, Mesh]:
    if name is None:
        return dict(meshes)
    if name not in meshes:
        raise InputError(f"there is no body `{name}`")
    return {name: meshes[name]}


def _size(meshes: Mapping[str, Mesh]) -> float:
    """Diagonal of the box around all bodies [m]."""
    low = np.min([mesh.points.min(axis=0) for mesh in meshes.values()], axis=0)
    high = np.max([mesh.points.max(axis=0) for mesh in meshes.values()], axis=0)
    return float(np.linalg.norm(high - low))


def _is_inside(
    selection: BoxSelection | PlaneSelection | SphereSelection, points: FloatArray, size: float
) -> BoolArray:
    rounding = _ROUNDING * size
    if isinstance(selection, BoxSelection):
        low, high = np.array(selection.box)
        inside = ((points >= low - rounding) & (points <= high + rounding)).all(axis=1)
    elif isinstance(selection, PlaneSelection):
        plane = selection.plane
        normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
        tolerance = plane.tolerance if plane.tolerance is not None else _PLANE_TOLERANCE * size
        inside = np.abs((points - np.array(plane.point)) @ normal) <= tolerance
    else:
        sphere = selection.sphere
        distance = np.linalg.norm(points - np.array(sphere.center), axis=1)
        inside = distance <= sphere.radius + rounding
    return np.asarray(inside, dtype=np.bool_)
