"""Random samples of the surface of material points, each with its piece of area and its owner.

References
----------
D. Hyde, S. Gagniere, A. Marquez-Razon, J. Teran, An implicit updated Lagrangian formulation for liquids with large
surface energy (2020), section 5.1; M. Corsini, P. Cignoni, R. Scopigno, Efficient and flexible sampling with blue noise
properties (2012), figure 1; R. Osada, T. Funkhouser, B. Chazelle, D. Dobkin, Shape distributions (2002), section 4.1.

Limitations
-----------
Samples are new in each step, so forces of the surface have noise that falls with the root of their number; the area is
that of the contour, which lies outside of the points (`femdeform.mpm.level_set`).
"""

from __future__ import annotations

import numpy as np

from femdeform.mpm.level_set import Facets, union_of_spheres
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.types import FloatArray, IntArray

# Samples a cell's side, in 3D a cell's face, by dimension.
DENSITIES = {2: 3.0, 3: 8.0}


def sample_facets(facets: Facets, density: float, generator: np.random.Generator) -> tuple[IntArray, FloatArray]:
    """Facets (n,) of random samples, ascending, and their positions (n, dim) [m], uniform on each facet.

    A facet of measure a has max(1, Poisson(density a)) samples. It has one at least: otherwise its area would be
    missing from the surface, which would be open there.

    Parameters
    ----------
    facets : Facets
        A surface.
    density : float
        Samples a metre (2D) or square metre (3D).
    generator : numpy.random.Generator
        Source of the numbers.
    """
    counts = np.maximum(generator.poisson(density * facets.measure), 1)
    of_sample = np.repeat(np.arange(facets.n), counts)
    corners = facets.corners[of_sample]
    dim = corners.shape[1]
    u = generator.random((of_sample.size, dim - 1))
    if dim == 2:
        weights = np.stack([1.0 - u[:, 0], u[:, 0]], axis=1)
    else:
        root = np.sqrt(u[:, 0])
        weights = np.stack([1.0 - root, root * (1.0 - u[:, 1]), root * u[:, 1]], axis=1)
    return of_sample, np.einsum("rc,rca->ra", weights, corners)


class SurfaceSampler:
    """Samples of the surface of material points, new ones in each step.

    Parameters
    ----------
    spacing : float
        Distance of the grid's nodes [m].
    density : float, optional
        Samples a cell's side (2D) or face (3D); default `DENSITIES`.
    radius : float, optional
        Radius of the spheres over the spacing; default `femdeform.mpm.level_set.RADII`.
    seed : int
        Samples depend on it, on the number of the step and on the points, and on nothing else: a run that is resumed
        takes the same ones.

    Notes
    -----
    Areas add up to that of the contour and normals times areas to zero, both to rounding, whatever the numbers drawn.
    """

    def __init__(
        self, spacing: float, density: float | None = None, radius: float | None = None, seed: int = 0
    ) -> None:
        if not spacing > 0.0:
            raise ValueError(f"a spacing of {spacing} is not positive")
        if density is not None and not density > 0.0:
            raise ValueError(f"a density of {density} samples is not positive")
        self.spacing, self.density, self.radius, self.seed = spacing, density, radius, seed

    def sample(self, points: FloatArray, step: int) -> SurfaceSamples:
        """Samples of the surface of points (n, dim) [m] in a step, in ascending order of their owners.

        Raises
        ------
        ValueError
            If there are no points or one is not finite.
        """
        dim = points.shape[1]
        density = (DENSITIES[dim] if self.density is None else self.density) / self.spacing ** (dim - 1)
        # A counter with a key: streams of two steps have nothing in common.
        generator = np.random.Generator(np.random.Philox(key=np.array([self.seed, step], dtype=np.uint64)))
        places, normals, measure, owner = [], [], [], []
        for level_set in union_of_spheres(points, self.spacing, self.radius):
            facets = level_set.facets()
            of_sample, position = sample_facets(facets, density, generator)
            counts = np.bincount(of_sample, minlength=facets.n)
            places.append(position)
            normals.append(facets.normals[of_sample])
            measure.append((facets.measure / counts)[of_sample])
            owner.append(level_set.closest(position))
        owners = np.concatenate(owner)
        order = np.argsort(owners, kind="stable")
        return SurfaceSamples(
            np.concatenate(places)[order],
            np.concatenate(normals)[order],
            np.concatenate(measure)[order],
            owners[order],
        )
