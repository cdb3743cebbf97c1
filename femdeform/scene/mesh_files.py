"""Which mesh files a scene reads, and what is in them."""

from __future__ import annotations

import hashlib
from typing import Any

from femdeform.errors import InputError
from femdeform.scene.load import LoadedScene
from femdeform.scene.mesh_schema import FileMesh


def mesh_file_hashes(loaded: LoadedScene) -> dict[str, str]:
    """SHA-256 of the file of every mesh that is read from one.

    Together with the hash of the scene, which knows the names of the files only, it says whether two runs compute the
    same.

    Parameters
    ----------
    loaded : LoadedScene
        The scene.

    Returns
    -------
    dict of str to str
        Hexadecimal digests by body, or by what else the meshes are of.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    hashes = {}
    for name, (key, source) in loaded.scene.mesh_sources().items():
        if isinstance(source, FileMesh):
            try:
                with (loaded.base_dir / source.file).open("rb") as file:
                    hashes[name] = hashlib.file_digest(file, "sha256").hexdigest()
            except OSError as error:
                message = f"cannot be read: {error.strerror}"
                raise InputError([loaded.fault((*key, "file"), message)]) from None
    return hashes


def with_absolute_paths(loaded: LoadedScene, resolved: dict[str, Any]) -> None:
    """Make the paths of mesh files in a dumped scene absolute, in place, so that it can be run from anywhere."""
    for key, source in loaded.scene.mesh_sources().values():
        if isinstance(source, FileMesh):
            block: Any = resolved
            for word in key:
                block = block[word]
            block["file"] = str((loaded.base_dir / source.file).resolve())
