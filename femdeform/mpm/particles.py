"""Material points: what they carry, as one array for each quantity."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from femdeform.types import FloatArray, IntArray

# Values of `Particles.phase`.
SOLID, LIQUID = 0, 1


@dataclass
class Particles:
    """Material points; rows of all arrays belong together.

    Attributes
    ----------
    x : (n, dim) float64
        Positions [m].
    v : (n, dim) float64
        Velocities [m/s].
    affine : (n, dim, dim) float64
        Affine velocity of the transfers: ``v(y) = v + affine (y - x)`` near the point [1/s].
    mass : (n,) float64
        Masses [kg]; in 2D [kg/m].
    volume : (n,) float64
        Volumes V0 at rest [m^3]; in 2D [m^2].
    J : (n,) float64
        Volume over V0 of liquid points [-].
    F : (n, dim, dim) float64
        Deformation gradients of solid points [-].
    temperature : (n,) float64
        Temperatures [K].
    temperature_gradient : (n, dim) float64
        Their gradients [K/m].
    phase : (n,) int8
        `SOLID` or `LIQUID`.
    body : (n,) int32
        Number of the body of each point, which has the material.
    """

    x: FloatArray
    v: FloatArray
    affine: FloatArray
    mass: FloatArray
    volume: FloatArray
    J: FloatArray
    F: FloatArray
    temperature: FloatArray
    temperature_gradient: FloatArray
    phase: np.ndarray[tuple[int, ...], np.dtype[np.int8]]
    body: np.ndarray[tuple[int, ...], np.dtype[np.int32]]

    @classmethod
    def at(cls, x: FloatArray, mass: FloatArray, volume: FloatArray) -> Particles:
        """Solid points at rest, undeformed, of body 0 and temperature 0, at positions x (n, dim) [m]."""
        n, dim = x.shape
        return cls(
            x=np.array(x, dtype=np.float64),
            v=np.zeros((n, dim)),
            affine=np.zeros((n, dim, dim)),
            mass=np.array(mass, dtype=np.float64),
            volume=np.array(volume, dtype=np.float64),
            J=np.ones(n),
            F=np.tile(np.eye(dim), (n, 1, 1)),
            temperature=np.zeros(n),
            temperature_gradient=np.zeros((n, dim)),
            phase=np.zeros(n, dtype=np.int8),
            body=np.zeros(n, dtype=np.int32),
        )

    @property
    def n(self) -> int:
        """Number of points."""
        return int(self.x.shape[0])

    @property
    def dim(self) -> int:
        """Dimension of space."""
        return int(self.x.shape[1])

    def take(self, order: IntArray) -> Particles:
        """The points of the given numbers, in that order, as copies."""
        return Particles(**{each.name: getattr(self, each.name)[order] for each in fields(self)})

    @staticmethod
    def joined(parts: list[Particles]) -> Particles:
        """Points of several sets after one another."""
        names = [each.name for each in fields(Particles)]
        return Particles(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def current_volumes(particles: Particles) -> FloatArray:
    """Volumes (n,) [m^3] of material points: J V0 of liquids, det F V0 of solids."""
    stretch = np.where(particles.phase == LIQUID, particles.J, np.linalg.det(particles.F))
    return np.asarray(stretch * particles.volume)
