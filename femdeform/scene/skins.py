"""The skins of a scene: fine surfaces that pictures show in place of coarse bodies."""

from __future__ import annotations

from femdeform import registry
from femdeform.errors import Fault, InputError
from femdeform.scene.load import LoadedScene, sort_faults
from femdeform.scene.meshing import mesh_faults
from femdeform.types import Mesh


def load_skins(loaded: LoadedScene) -> dict[str, Mesh]:
    """Build the surface of every body that has a skin.

    Raises
    ------
    InputError
        If a surface cannot be built, or is not one of triangles in space.
    """
    skins: dict[str, Mesh] = {}
    faults: list[Fault] = []
    for name, body in loaded.scene.bodies.items():
        source = getattr(body, "skin", None)
        if source is None:
            continue
        key = ("bodies", name, "skin")
        try:
            found = mesh_faults(loaded, key, source)
            if found:
                faults += found
                continue
            mesh = registry.resolve(registry.MESH["build"])(source, loaded.base_dir)
        except InputError as error:
            faults += [loaded.fault(key, fault.message) for fault in error.faults]
            continue
        if mesh.cell_type != "triangle" or mesh.dim != 3:
            faults.append(loaded.fault(key, f"a skin is made of triangles in 3D, not of {mesh.cell_type}s in {mesh.dim}D"))
        else:
            skins[name] = mesh
    if faults:
        raise InputError(sort_faults(faults))
    return skins
