"""Random drops of material points for tests, and the function of their implicit step written down a second time.

The reference is dense, slow and from the formulas: SVD, inverse and eigenvalues by NumPy, one point after another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.mpm.grid import Grid, Stencils
from femdeform.mpm.node_walls import NodeWall
from femdeform.mpm.particles import LIQUID, SOLID, Particles
from femdeform.mpm.point_potential import PointPotential
from femdeform.mpm.point_terms import PointMaterials, SurfaceTension
from femdeform.mpm.surface_samples import SurfaceSamples

Array = NDArray[np.float64]
SPACING = 0.1
LAW = FixedCorotated(30.0, 50.0)


def cofactor(F: Array) -> Array:
    return np.asarray(np.linalg.det(F) * np.linalg.inv(F).T)


def corotated(F: Array, law: FixedCorotated) -> float:
    """Fixed corotated energy from the singular values, the smallest one with the sign of det F."""
    s = np.linalg.svd(F, compute_uv=False)
    s[-1] *= np.sign(np.linalg.det(F))
    return float(law.mu * np.sum((s - 1.0) ** 2) + 0.5 * law.lmbda * (np.prod(s) - 1.0) ** 2)


@dataclass
class Drop:
    """Points and samples with the mass and momentum of their groups on a grid."""

    points: Particles
    tension: SurfaceTension
    materials: PointMaterials
    stencils: Stencils
    mass: Array
    velocity: Array
    gravity: Array
    symmetric: bool
    share: Array  # mass of each member of a group
    owner: NDArray[np.int64]  # of each member
    places: Array  # of each member
    walls: Sequence[NodeWall] = field(default_factory=list)

    @property
    def dim(self) -> int:
        return self.points.dim

    def begun(self, dt: float, walls: Sequence[NodeWall] = ()) -> PointPotential:
        problem = PointPotential(self.gravity, self.symmetric)
        self.begin(problem, dt, walls)
        return problem

    def begin(self, problem: PointPotential, dt: float, walls: Sequence[NodeWall] = ()) -> None:
        problem.begin_step(
            self.stencils, self.mass, self.velocity, self.points, self.materials, dt, self.tension, walls
        )

    # ------------------------------------------------------------------------------------ the reference

    def energy(self, u: Array, dt: float, parts: str = "lvhs") -> float:
        """e(u): liquid, viscosity, solid (h), surface."""
        d, points, s = self.dim, self.points, self.stencils
        n, total = points.n, 0.0
        F = np.eye(d) + np.einsum("pki,pkj->pij", u[s.nodes], np.where(s.weights[..., None] > 0.0, s.gradients, 0.0))
        for p in range(n):
            if points.phase[p] == LIQUID:
                J = (1.0 - d + np.trace(F[p])) * points.J[p]
                if "l" in parts:
                    total += 0.5 * self.materials.bulk_modulus[p] * (J - 1.0) ** 2 * points.volume[p]
                if "v" in parts:
                    strain = 0.5 * (F[p] + F[p].T) - np.eye(d)
                    total += self.materials.viscosity[p] / dt * points.J[p] * points.volume[p] * np.sum(strain**2)
            elif "h" in parts:
                total += points.volume[p] * corotated(F[p] @ points.F[p], LAW)
        if "s" in parts:
            samples = self.tension.samples
            for r in range(samples.n):
                A = 0.5 * (F[n + r] + F[n + r].T) if self.symmetric else F[n + r]
                total += (
                    self.tension.coefficient[r]
                    * samples.measure[r]
                    * float(np.linalg.norm(cofactor(A) @ samples.normals[r]))
                )
        return total

    def objective(self, u: Array, dt: float) -> float:
        drift = dt * self.velocity + dt**2 * self.gravity
        return float(0.5 / dt**2 * np.sum(self.mass[:, None] * (u - drift) ** 2)) + self.energy(u, dt)

    def momentum(self, velocity: Array) -> tuple[Array, Array]:
        """Linear momentum, and angular momentum about the origin as a skew matrix, of the nodes."""
        p = self.mass[:, None] * velocity
        L = self.stencils.positions.T @ p
        return p.sum(axis=0), L - L.T


def turning(x: Array, p: Array) -> Array:
    """Angular momentum ``sum x_a p_b - x_b p_a``."""
    product = x.T @ p
    return np.asarray(product - product.T)


def spin(points: Particles, spacing: float) -> Array:
    """Angular momentum of points with affine velocities about the origin, that of the points themselves included."""
    own = 0.25 * spacing**2 * np.einsum("p,pab->ab", points.mass, points.affine)
    return turning(points.x, points.mass[:, None] * points.v) + own.T - own


def drop(
    dim: int,
    seed: int = 0,
    n: int = 14,
    n_samples: int = 10,
    liquid: str = "mixed",
    symmetric: bool = False,
    gravity: Sequence[float] | None = None,
    **constants: Any,
) -> Drop:
    """A cloud of about four cells with random state; every second point is solid, or none, or all."""
    rng = np.random.default_rng(seed)
    x = 0.37 + 0.8 * SPACING * rng.standard_normal((n, dim)).clip(-1.5, 1.5)
    points = Particles.at(x, 0.02 * (1.0 + rng.random(n)), 1e-3 * (1.0 + rng.random(n)))
    points.phase[:] = {"mixed": np.arange(n) % 2, "all": LIQUID, "none": SOLID}[liquid]
    points.J[:] = 1.0 + 0.05 * rng.standard_normal(n)
    points.F[:] = np.eye(dim) + 0.1 * rng.standard_normal((n, dim, dim))
    points.v[:] = 0.5 * rng.standard_normal((n, dim))
    points.affine[:] = 2.0 * rng.standard_normal((n, dim, dim))
    owner = np.sort(rng.integers(0, n, n_samples))
    normals = rng.standard_normal((n_samples, dim))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    samples = SurfaceSamples(x[owner] + 0.8 * SPACING * normals, normals, 0.05 * (1.0 + rng.random(n_samples)), owner)
    tension = SurfaceTension(samples, 1.0 + rng.random(n_samples))
    # A group is a point, its samples and their mirror images; all share its mass.
    places = np.concatenate([x, samples.points, 2.0 * x[owner] - samples.points])
    of = np.concatenate([np.arange(n), owner, owner])
    share = (points.mass / (2.0 * np.bincount(owner, minlength=n) + 1.0))[of]
    stencils = Grid(SPACING, "quadratic").stencils(places)
    mass = stencils.to_nodes(share[:, None])[:, 0]
    W = np.zeros((len(places), stencils.n_nodes))
    np.add.at(W, (np.arange(len(places))[:, None], stencils.nodes), stencils.weights)
    apart = stencils.positions[None] - places[:, None]
    v = points.v[of][:, None] + np.einsum("kab,kib->kia", points.affine[of], apart)
    velocity = np.einsum("ki,kia->ia", share[:, None] * W, v) / mass[:, None]
    materials = PointMaterials(
        {0: LAW}, np.full(n, constants.get("bulk", 80.0)), np.full(n, constants.get("viscosity", 0.3))
    )
    g = np.zeros(dim) if gravity is None else np.array(gravity, dtype=float)
    return Drop(points, tension, materials, stencils, mass, velocity, g, symmetric, share, of, places)
