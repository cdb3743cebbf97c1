"""Points on the surface of material points, each with its piece of area."""

from __future__ import annotations

from dataclasses import dataclass

from femdeform.types import FloatArray, IntArray


@dataclass(frozen=True)
class SurfaceSamples:
    """Samples of a surface, in ascending order of their owners.

    Attributes
    ----------
    points : (n_samples, dim) float64
        Positions s_r [m].
    normals : (n_samples, dim) float64
        Unit normals, outward.
    measure : (n_samples,) float64
        Areas |dA_r| that the samples stand for [m^2]; in 2D lengths [m].
    owner : (n_samples,) int64
        The material point that each belongs to, the one closest to it.
    """

    points: FloatArray
    normals: FloatArray
    measure: FloatArray
    owner: IntArray

    @property
    def n(self) -> int:
        """Number of samples."""
        return int(self.points.shape[0])

    def take(self, order: IntArray) -> SurfaceSamples:
        """The samples of the given numbers, in that order."""
        return SurfaceSamples(self.points[order], self.normals[order], self.measure[order], self.owner[order])
