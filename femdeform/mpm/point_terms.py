"""The energies of an implicit step over material points and samples of their surface.

Every term writes to rows of arrays over the points of a `Quadrature`: energies, stresses, tangents; see
`mpm.point_kernels`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from femdeform.materials.dispatch import Law
from femdeform.mpm import point_laws
from femdeform.mpm.particles import LIQUID, SOLID, Particles
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.types import FloatArray, IntArray


@dataclass(frozen=True)
class PointMaterials:
    """What material points are made of.

    Attributes
    ----------
    solids : mapping of int to NamedTuple
        Law of each body that has solid points, by its number (`Particles.body`).
    bulk_modulus, viscosity : (n,) float64
        Of liquid points, pressure ``-bulk_modulus (J - 1)`` [Pa] and ``viscosity (grad v + grad v^T)`` [Pa s]; others
        are not read.
    moduli : (n, 2) float64, optional
        mu and lmbda of solid points [Pa], in place of those of their laws; rows that are not finite keep the latter.
    """

    solids: Mapping[int, Law]
    bulk_modulus: FloatArray
    viscosity: FloatArray
    moduli: FloatArray | None = None

    def take(self, rows: IntArray) -> PointMaterials:
        """Those of the points of the given numbers."""
        moduli = None if self.moduli is None else self.moduli[rows]
        return PointMaterials(self.solids, self.bulk_modulus[rows], self.viscosity[rows], moduli)


@dataclass(frozen=True)
class SurfaceTension:
    """Samples and their coefficients, which stay with the material during a step.

    Attributes
    ----------
    samples : SurfaceSamples
    coefficient : (n_samples,) float64
        k [N/m].
    """

    samples: SurfaceSamples
    coefficient: FloatArray

    def take(self, rows: IntArray) -> SurfaceTension:
        """The samples of the given numbers."""
        return SurfaceTension(self.samples.take(rows), self.coefficient[rows])


class PointTerm(Protocol):
    """A sum over points."""

    name: str

    def energies(self, D: FloatArray, out: FloatArray) -> None:
        """Write the energies [J] of its points to `out` (n_points,); D is (n_points, dim^2)."""

    def stresses(self, D: FloatArray, out: FloatArray) -> None:
        """Write their derivatives by D [J] to `out` (n_points, dim^2)."""

    def tangents(self, D: FloatArray, project: bool, out: FloatArray) -> None:
        """Write their second derivatives [J] to rows of `out` (n_tangents, dim^2, dim^2), if they have any there."""


class LiquidTerm:
    """Pressure and viscosity; the tangent is the pair (alpha, beta) of `mpm.point_kernels`, always semi-definite.

    Parameters
    ----------
    points : Particles
    rows : (n,) int64
        Liquid points.
    materials : PointMaterials
    dt : float
        [s].
    alpha, beta : (n_points,) float64
        Receive the tangents [J].
    """

    name = "liquid"

    def __init__(
        self,
        points: Particles,
        rows: IntArray,
        materials: PointMaterials,
        dt: float,
        alpha: FloatArray,
        beta: FloatArray,
    ) -> None:
        self.rows, self._dim = rows, (0,) * points.dim
        self._J, self._volume = points.J, points.volume
        self._bulk = np.ascontiguousarray(materials.bulk_modulus, dtype=np.float64)
        alpha[rows] = (self._bulk * points.J**2 * points.volume)[rows]
        beta[rows] = (2.0 / dt * materials.viscosity * points.J * points.volume)[rows]
        self._beta = beta

    def energies(self, D: FloatArray, out: FloatArray) -> None:
        """See `PointTerm`."""
        point_laws.liquid_energies(D, self.rows, self._bulk, self._J, self._volume, self._beta, self._dim, out)

    def stresses(self, D: FloatArray, out: FloatArray) -> None:
        """See `PointTerm`."""
        point_laws.liquid_stresses(D, self.rows, self._bulk, self._J, self._volume, self._beta, self._dim, out)

    def tangents(self, D: FloatArray, project: bool, out: FloatArray) -> None:
        """Liquids have none as matrices."""


class SolidTerm:
    """Points of one law: ``V0 Psi(F^ F^n)``.

    Parameters
    ----------
    law : NamedTuple
    rows : (n,) int64
        Its points.
    base : (n_points, dim^2) float64
        F^n [-].
    volume : (n_points,) float64
        V0 [m^3].
    place : (n_points,) int64
        Row of each point among the tangents.
    moduli : (n_points, 2) float64, optional
        See `PointMaterials`.
    """

    name = "solid"

    def __init__(
        self,
        law: Law,
        rows: IntArray,
        base: FloatArray,
        volume: FloatArray,
        place: IntArray,
        moduli: FloatArray | None = None,
    ) -> None:
        self.law, self.rows = law, rows
        self._base, self._volume, self._place = base, volume, place
        dim = 2 if base.shape[1] == 4 else 3
        self._dim = (0,) * dim
        self._laws = (type(law).from_lame(1.0, 0.0, dim), type(law).from_lame(0.0, 1.0, dim))
        self._moduli = np.tile(np.array([law.mu, law.lmbda]), (len(base), 1))
        if moduli is not None:
            own = np.isfinite(moduli).all(axis=1)
            self._moduli[: len(moduli)][own] = moduli[own]

    def energies(self, D: FloatArray, out: FloatArray) -> None:
        """See `PointTerm`."""
        point_laws.solid_energies(D, self._base, self.rows, self._volume, *self._laws, self._moduli, self._dim, out)

    def stresses(self, D: FloatArray, out: FloatArray) -> None:
        """See `PointTerm`."""
        point_laws.solid_stresses(D, self._base, self.rows, self._volume, *self._laws, self._moduli, self._dim, out)

    def tangents(self, D: FloatArray, project: bool, out: FloatArray) -> None:
        """See `PointTerm`."""
        point_laws.solid_tangents(
            D, self._base, self.rows, self._volume, *self._laws, self._moduli, self._dim, project, self._place, out
        )


class SurfaceTerm:
    """Surface energy ``k |dA| |cof(F) n|`` of samples.

    Parameters
    ----------
    tension : SurfaceTension
    first : int
        The samples' first point.
    symmetric : bool
        Take the symmetric part of F^, for the sake of angular momentum.
    place : (n_points,) int64
        Row of each point among the tangents.
    """

    name = "surface"

    def __init__(self, tension: SurfaceTension, first: int, symmetric: bool, place: IntArray) -> None:
        self.rows = np.arange(first, first + tension.samples.n)
        self._first, self._symmetric, self._place = first, symmetric, place
        self._weight = np.ascontiguousarray(tension.coefficient * tension.samples.measure)
        self._frames = surface_tangents(tension.samples.normals)

    def energies(self, D: FloatArray, out: FloatArray) -> None:
        """See `PointTerm`."""
        point_laws.surface_energies(D, self._first, self._frames, self._weight, self._symmetric, out)

    def stresses(self, D: FloatArray, out: FloatArray) -> None:
        """See `PointTerm`."""
        point_laws.surface_stresses(D, self._first, self._frames, self._weight, self._symmetric, out)

    def tangents(self, D: FloatArray, project: bool, out: FloatArray) -> None:
        """See `PointTerm`."""
        point_laws.surface_tangents(
            D, self._first, self._frames, self._weight, self._symmetric, project, self._place, out
        )


def surface_tangents(normals: FloatArray) -> FloatArray:
    """Unit tangents (n, dim - 1, dim) of unit normals (n, dim); t1, t2 and the normal are right-handed in 3D."""
    if normals.shape[1] == 2:
        return np.ascontiguousarray(np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None])
    # Across the axis that the normal is farthest from.
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normals, first)], axis=1)


def rows_of(points: Particles, materials: PointMaterials) -> tuple[IntArray, dict[int, IntArray]]:
    """Liquid points, and solid points of each body.

    Raises
    ------
    ValueError
        If a body has solid points and no law.
    """
    liquid = np.flatnonzero(points.phase == LIQUID)
    solid = points.phase == SOLID
    bodies = [int(body) for body in np.unique(points.body[solid])]
    missing = [body for body in bodies if body not in materials.solids]
    if missing:
        raise ValueError(f"no law for the solid points of body {missing[0]}")
    return liquid, {body: np.flatnonzero(solid & (points.body == body)) for body in bodies}
