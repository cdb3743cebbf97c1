"""Laws on arrays of deformation gradients: one threaded loop each over the scalar kernels of `dispatch`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from femdeform.jit import njit, prange
from femdeform.materials import dispatch, with_precision
from femdeform.materials.dispatch import Law

FloatArray = NDArray[Any]


# ---------------------------------------------------------------------------------------- drivers


@njit
def load_2d(F: FloatArray, e: int) -> tuple[float, float, float, float]:
    """Return row e of an (n, 4) array as a tuple."""
    return (F[e, 0], F[e, 1], F[e, 2], F[e, 3])


@njit
def load_3d(F: FloatArray, e: int) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return row e of an (n, 9) array as a tuple."""
    return (F[e, 0], F[e, 1], F[e, 2], F[e, 3], F[e, 4], F[e, 5], F[e, 6], F[e, 7], F[e, 8])


@njit(parallel=True)
def _energies_2d(F: FloatArray, law: Law, result: FloatArray) -> None:
    for e in prange(F.shape[0]):
        result[e] = dispatch.energy_density(load_2d(F, e), law)


@njit(parallel=True)
def _energies_3d(F: FloatArray, law: Law, result: FloatArray) -> None:
    for e in prange(F.shape[0]):
        result[e] = dispatch.energy_density(load_3d(F, e), law)


@njit(parallel=True)
def _stresses_2d(F: FloatArray, law: Law, result: FloatArray) -> None:
    for e in prange(F.shape[0]):
        P = dispatch.pk1(load_2d(F, e), law)
        result[e, 0], result[e, 1], result[e, 2], result[e, 3] = P[0], P[1], P[2], P[3]


@njit(parallel=True)
def _stresses_3d(F: FloatArray, law: Law, result: FloatArray) -> None:
    for e in prange(F.shape[0]):
        P = dispatch.pk1(load_3d(F, e), law)
        result[e, 0], result[e, 1], result[e, 2] = P[0], P[1], P[2]
        result[e, 3], result[e, 4], result[e, 5] = P[3], P[4], P[5]
        result[e, 6], result[e, 7], result[e, 8] = P[6], P[7], P[8]


@njit(parallel=True)
def _tangents_2d(F: FloatArray, law: Law, project: bool, result: FloatArray) -> None:
    for e in prange(F.shape[0]):
        dispatch.tangent(load_2d(F, e), law, project, result[e])


@njit(parallel=True)
def _tangents_3d(F: FloatArray, law: Law, project: bool, result: FloatArray) -> None:
    for e in prange(F.shape[0]):
        dispatch.tangent(load_3d(F, e), law, project, result[e])


# ---------------------------------------------------------------------------------------- arrays


def _flat(F: ArrayLike, law: Law) -> tuple[FloatArray, int, Law]:
    array = np.asarray(F)
    if array.ndim != 3 or array.shape[1] != array.shape[2] or array.shape[1] not in (2, 3):
        raise ValueError(f"F must have the shape (n, 3, 3) or (n, 2, 2), got {array.shape}")
    if array.dtype != np.float32:
        array = array.astype(np.float64, copy=False)
    dim = array.shape[1]
    return np.ascontiguousarray(array).reshape(-1, dim * dim), dim, with_precision(law, array.dtype)


def energy_density(F: ArrayLike, law: Law) -> FloatArray:
    """Return the elastic energy per reference volume.

    Parameters
    ----------
    F : (n, d, d) array_like
        Deformation gradients, d = 2 (plane strain) or 3; float32 stays float32, all else becomes float64.
    law : NamedTuple
        The law with its parameters, made for d dimensions.

    Returns
    -------
    (n,) ndarray
        Energy densities [J/m^3].

    Raises
    ------
    ValueError
        If F has another shape.
    """
    flat, dim, law = _flat(F, law)
    result = np.empty(len(flat), dtype=flat.dtype)
    (_energies_2d if dim == 2 else _energies_3d)(flat, law, result)
    return result


def pk1(F: ArrayLike, law: Law) -> FloatArray:
    """Return first Piola-Kirchhoff stresses [Pa], (n, d, d), of deformation gradients (n, d, d).

    See `energy_density` for the arguments and errors.
    """
    flat, dim, law = _flat(F, law)
    result = np.empty_like(flat)
    (_stresses_2d if dim == 2 else _stresses_3d)(flat, law, result)
    return result.reshape(-1, dim, dim)


def tangent(F: ArrayLike, law: Law, projected: bool = False) -> FloatArray:
    """Return tangents H_abcd = d2Psi/dF_ab dF_cd [Pa], (n, d, d, d, d), of deformation gradients (n, d, d).

    Parameters
    ----------
    F, law
        See `energy_density`.
    projected : bool
        Return the closest positive semi-definite tangents instead.

    Raises
    ------
    ValueError
        If F has another shape.
    """
    flat, dim, law = _flat(F, law)
    size = dim * dim
    result = np.empty((len(flat), size, size), dtype=flat.dtype)
    (_tangents_2d if dim == 2 else _tangents_3d)(flat, law, projected, result)
    return result.reshape(-1, dim, dim, dim, dim)
