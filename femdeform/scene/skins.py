"""The skins of a scene: fine surfaces that pictures show in place of coarse bodies."""

from __future__ import annotations

from femdeform.errors import Fault, InputError
from femdeform.scene.load import LoadedScene, sort_faults
from femdeform.scene.meshing import build_source
from femdeform.types import Mesh


def load_skins(loaded: LoadedScene) -> dict[str, Mesh]:
    """Build the surface of every body that has a skin.

    Parameters
    ----------
    loaded : LoadedScene
        The scene.

    Returns
    -------
    dict of str to Mesh
        Triangles in 3D, by body.

    Raises
    ------
    InputError
        If a surface cannot be built, or is not one of triangles in space.
    """
    skins: dict[str, Mesh] = {}
    faults: list[Fault] = []
    if loaded.scene.simulation != "deformable":
        return skins
    for name, body in loaded.scene.bodies.items():
        source = getattr(body, "skin", None)
        if source is None:
            continue
        key = ("bodies", name, "skin")
        try:
            mesh, _ = build_source(loaded, key, source, f"skin of body {name}")
        except InputError as error:
            faults += error.faults
            continue
        if (mesh.cell_type, mesh.dim) == ("triangle", 3):
            skins[name] = mesh
        else:
            found = {"line": "lines", "triangle": "triangles", "tetra": "tetrahedra"}[mesh.cell_type]
            faults.append(loaded.fault(key, f"a skin is made of triangles in 3D, not of {found} in {mesh.dim}D"))
    if faults:
        raise InputError(sort_faults(faults))
    return skins
