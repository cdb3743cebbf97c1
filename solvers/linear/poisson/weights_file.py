"""Files of learned weights: arrays and what they are, checked by their SHA-256."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import InputError

_META = "meta"
_SUM = ".sha256"
# The name of shipped weights by method and dimension.
_SHIPPED = {"spd_lmg": "spd-lmg-{dim}d", "dcdm": "dcdm-{dim}d"}


@dataclass(frozen=True)
class Weights:
    """Learned weights.

    Attributes
    ----------
    meta : dict
        ``kind`` (``dcdm`` or ``spd_lmg``), ``dim``, and what else the solver has to know.
    parameters : dict of str to float32 array
    """

    meta: dict[str, Any]
    parameters: dict[str, NDArray[Any]]


def shipped_weights() -> list[str]:
    """Names of the weights that come with the package, sorted."""
    folder = files("solvers.linear.poisson") / "weights"
    return sorted(item.name.removesuffix(".npz") for item in folder.iterdir() if item.name.endswith(".npz"))


def load_weights(name: str | None, method: str, dim: int) -> Weights:
    """Read weights for a method and a dimension.

    Parameters
    ----------
    name : str or None
        Of shipped weights, or the path of a file that ends in ``.npz``; None for the shipped ones of this method and
        dimension.
    method : str
        ``dcdm`` or ``spd_lmg``.
    dim : int
        Of the grid.

    Raises
    ------
    InputError
        If there are none, the sum does not match, or they are of another method or dimension.
    """
    if name is None:
        name = _SHIPPED[method].format(dim=dim)
        if name not in shipped_weights():
            raise InputError(
                f"linear_solver: no weights of method {method} in {dim} dimensions come with femdeform; train some "
                f"(femdeform train {method} --dim {dim}) and name the file: weights: FILE.npz"
            )
    if name.endswith(".npz"):
        data, told = _read(Path(name))
    elif name in shipped_weights():
        folder = files("solvers.linear.poisson") / "weights"
        data, told = (folder / f"{name}.npz").read_bytes(), (folder / f"{name}.npz{_SUM}").read_text()
    else:
        raise InputError(
            f"linear_solver.weights: there are no weights named {name}; shipped are "
            f"{', '.join(shipped_weights()) or 'none'}, and files end in .npz"
        )
    if hashlib.sha256(data).hexdigest() != told.split()[0]:
        raise InputError(f"linear_solver.weights: {name} is not what {name}{_SUM} says; it is damaged or has changed")
    weights = _parse(data, name)
    if (weights.meta.get("kind"), weights.meta.get("dim")) != (method, dim):
        raise InputError(
            f"linear_solver.weights: {name} holds weights of method {weights.meta.get('kind')} in "
            f"{weights.meta.get('dim')} dimensions, not of {method} in {dim}"
        )
    return weights


def _read(path: Path) -> tuple[bytes, str]:
    beside = path.with_name(path.name + _SUM)
    try:
        return path.read_bytes(), beside.read_text()
    except OSError as error:
        raise InputError(f"linear_solver.weights: cannot read {error.filename}: {error.strerror}") from error


def _parse(data: bytes, name: str) -> Weights:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            parameters = {key: held[key] for key in held.files if key != _META}
            meta = json.loads(str(held[_META]))
    except (ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"linear_solver.weights: {name} is no file of weights: {error}") from error
    return Weights(meta, parameters)


def save_weights(path: Path, weights: Weights) -> str:
    """Write a file ``.npz`` and its sum beside it; return the sum."""
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {name: np.asarray(v, dtype=np.float32) for name, v in weights.parameters.items()}
    arrays[_META] = np.array(json.dumps(weights.meta, sort_keys=True))
    np.savez_compressed(buffer, **arrays)
    data = buffer.getvalue()
    digest = hashlib.sha256(data).hexdigest()
    path.write_bytes(data)
    path.with_name(path.name + _SUM).write_text(f"{digest}  {path.name}\n")
    return digest
