"""Which mesh files a scene reads, and what is in them."""

from __future__ import annotations

import hashlib

from femdeform.errors import InputError
from femdeform.scene.load import LoadedScene
from femdeform.scene.mesh_schema import FileMesh


def mesh_file_hashes(loaded: LoadedScene) -> dict[str, str]:
    """SHA-256 of the mesh file of every body that has one.

    Together with the hash of the scene, which knows the names of the files only, it says whether two runs compute the
    same.

    Parameters
    ----------
    loaded : LoadedScene
        The scene.

    Returns
    -------
    dict of str to str
        Hexadecimal digests by body.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    hashes = {}
    for name, body in loaded.scene.bodies.items():
        if isinstance(body.mesh, FileMesh):
            try:
                with (loaded.base_dir / body.mesh.file).open("rb") as file:
                    hashes[name] = hashlib.file_digest(file, "sha256").hexdigest()
            except OSError as error:
                message = f"cannot be read: {error.strerror}"
                raise InputError([loaded.fault(("bodies", name, "mesh", "file"), message)]) from None
    return hashes
