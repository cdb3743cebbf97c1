"""What `femdeform mesh` prints: a description of a mesh, after making or reading it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from femdeform.errors import Fault, InputError
from femdeform.scene.mesh_schema import RECIPE_NAMES, FileMesh, MeshSource, PlacedMesh
from femdeform.types import FloatArray, Mesh
from meshes.boundary import boundary_facets, connected_parts, measures
from meshes.build import build_mesh
from meshes.quality import cell_quality, check_mesh, edge_statistics, quality_histogram

_CELL_WORDS = {"line": "lines", "triangle": "triangles", "tetra": "tetrahedra"}
_MEASURES = {1: ("length", "m"), 2: ("area", "m^2"), 3: ("volume", "m^3")}
_BAR = 40


def describe(mesh: Mesh, name: str) -> str:
    """Describe a mesh in plain text: counts, extent, measure, edges, groups, quality.

    Parameters
    ----------
    mesh : Mesh
        A mesh that `check_mesh` has passed.
    name : str
        Headline.

    Returns
    -------
    str
        Several lines, without a newline at the end.
    """
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    word, unit = _MEASURES[mesh.cells.shape[1] - 1]
    edges = edge_statistics(mesh)
    n_parts, _ = connected_parts(mesh.cells, mesh.n_points)
    rows = [
        ("cells", f"{mesh.n_cells} {_CELL_WORDS[mesh.cell_type]} in {mesh.dim}D"),
        ("points", str(mesh.n_points)),
        ("box", f"{_vector(low)} to {_vector(high)} m, size {_vector(high - low)} m"),
        (word, f"{measures(mesh.points, mesh.cells).sum():.6g} {unit}"),
    ]
    if mesh.cell_type != "line":
        facets = boundary_facets(mesh.cells)
        facet_word, facet_unit = _MEASURES[mesh.cells.shape[1] - 2]
        total = measures(mesh.points, facets).sum() if len(facets) else 0.0
        rows.append(("boundary", f"{len(facets)} facets, {facet_word} {total:.6g} {facet_unit}"))
    rows.append(("edges", f"{edges.shortest:.4g} to {edges.longest:.4g} m, mean {edges.mean:.4g} m"))
    rows.append(("parts", "1, connected" if n_parts == 1 else f"{n_parts}, sharing no node"))
    lines = [name, *(f"  {label:<9} {text}" for label, text in rows), *_group_lines(mesh)]
    if mesh.cell_type != "line":
        lines += _quality_lines(cell_quality(mesh.points, mesh.cells))
    return "\n".join(lines)


def _vector(values: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.5g}" for value in values) + ")"


def _group_lines(mesh: Mesh) -> list[str]:
    rows: list[tuple[str, str, str, str]] = []
    for group, members in sorted(mesh.cell_groups.items()):
        rows.append((group, "cells", str(len(members)), _size(mesh.points, mesh.cells[members])))
    for group, facets in sorted(mesh.facet_groups.items()):
        rows.append((group, "facets", str(len(facets)), _size(mesh.points, facets)))
    for group, nodes in sorted(mesh.node_groups.items()):
        rows.append((group, "nodes", str(len(nodes)), ""))
    if not rows:
        return ["  groups    none"]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    return ["  groups"] + [
        f"    {name:<{widths[0]}}  {kind:<{widths[1]}}  {count:>{widths[2]}}  {size}".rstrip()
        for name, kind, count, size in rows
    ]


def _size(points: FloatArray, cells: np.ndarray[Any, np.dtype[np.int64]]) -> str:
    dimension = cells.shape[1] - 1
    if dimension == 0:
        return ""
    word, unit = _MEASURES[dimension]
    return f"{word} {measures(points, cells).sum():.6g} {unit}"


def _quality_lines(quality: FloatArray) -> list[str]:
    counts, edges = quality_histogram(quality)
    digits = len(str(counts.max()))
    spread = f"{quality.min():.3g} to {quality.max():.3g}, mean {quality.mean():.3g}"
    lines = [f"  quality   {spread} (1 is regular)"]
    for count, low, high in zip(counts, edges[:-1], edges[1:], strict=True):
        # Any cell at all shows as a mark: the few bad ones matter most.
        bar = "#" * max(round(_BAR * count / counts.max()), int(count > 0))
        lines.append(f"    {low:.1f}-{high:.1f}  {count:>{digits}}  {bar}".rstrip())
    return lines


class _Settings(BaseModel):
    """Holder that lets a mesh block be judged like any other part of a scene."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    mesh: MeshSource


def parse_recipe_arguments(arguments: Iterable[str]) -> dict[str, object]:
    """Turn ``key=value`` words of a command line into settings; values are YAML, keys may be dotted.

    Raises
    ------
    InputError
        If a word has no ``=``, or its value is no YAML.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    settings: dict[str, object] = {}
    for argument in arguments:
        key, separator, text = argument.partition("=")
        if not separator or not key.strip():
            raise InputError([Fault("--set", 0, "", f"`{argument}` is not of the form key=value")])
        try:
            settings[key.strip()] = YAML(typ="safe", pure=True).load(text)
        except YAMLError as error:
            reason = " ".join(str(error).split())
            raise InputError([Fault("--set", 0, key.strip(), f"not a value: {reason}")]) from None
    return settings


def mesh_command(recipe: str | None, settings: dict[str, object], out: Path | None, info: Path | None) -> str:
    """Make a mesh by a recipe, or read one from a file; check it, write it, and describe it.

    Parameters
    ----------
    recipe : str or None
        Name of a recipe.
    settings : dict
        Parameters of the recipe, or options of the file block (``scale``, ``fill``, ...), as plain values;
        keys may be dotted (``rotate.angle``).
    out : Path or None
        File to write the mesh to.
    info : Path or None
        File to read instead of making a mesh.

    Returns
    -------
    str
        Text for the user.

    Raises
    ------
    InputError
        If not exactly one of recipe and file is given, or a setting is wrong.
    MeshError
        If the mesh cannot be made, read or written, or is faulty.
    """
    if (recipe is None) == (info is None):
        raise InputError("femdeform mesh needs either the name of a recipe or --info FILE")
    if recipe is not None and recipe not in RECIPE_NAMES:
        close = difflib.get_close_matches(recipe, RECIPE_NAMES, n=1)
        hint = f"did you mean `{close[0]}`?" if close else f"known: {', '.join(RECIPE_NAMES)}"
        raise InputError(f"`{recipe}` is not a recipe; {hint}")
    block: dict[str, object] = {"recipe": recipe} if recipe is not None else {"file": str(info)}
    if out is not None:
        from meshes.writers import check_writable

        check_writable(out)
    source = _validated(block, settings)
    name = f"recipe {recipe}" if recipe is not None else str(info)
    notices: list[str] = []
    mesh, found = check_mesh(build_mesh(source, Path(), notices), name)
    lines = [describe(mesh, name), *(f"  note: {notice}" for notice in notices + found)]
    if out is not None:
        from meshes.writers import write_mesh

        lost = write_mesh(mesh, out)
        lines += [f"written to {out}", *(f"  note: {notice}" for notice in lost)]
    return "\n".join(lines)


def _validated(block: dict[str, object], settings: dict[str, object]) -> PlacedMesh | FileMesh:
    from femdeform.scene.validation import find_faults

    for dotted, value in settings.items():
        *parents, key = dotted.split(".")
        place: dict[str, Any] = block
        for parent in parents:
            inner = place.setdefault(parent, {})
            if not isinstance(inner, dict):
                raise InputError([Fault("--set", 0, dotted, f"`{parent}` has no keys of its own")])
            place = inner
        place[key] = value
    findings = find_faults(_Settings, {"mesh": block})
    if findings:
        raise InputError([Fault("--set", 0, ".".join(map(str, path[1:])), message) for path, message in findings])
    return _Settings.model_validate({"mesh": block}).mesh
