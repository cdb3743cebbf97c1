"""Groups of a material point, the samples of its surface and their mirror images: conservative transfers.

A point p with n_p samples s_r of the surface becomes 2 n_p + 1 members: itself, the samples, and ``b_r = 2 x_p - s_r``,
so that the centre of mass stays. All have the mass ``m_p / (2 n_p + 1)``, the velocity and the affine velocity of the
point. The grid gets ``m_i v_i = sum_k m_k N_i(x_k) (v_p + A_p (x_i - x_k))``; points get ``v_p = sum_i m_ip v_i / m_p``
and ``B_p = sum_i m_ip v_i (x_i - x_p)^T / m_p`` with the mass m_ip that the whole group has at a node. Mass, linear and
angular momentum and the centre of mass are kept by all of that, and by ``x_p += dt v_p``; what else a motion of the
points needs to keep them, see `displaced`.

`Particles.affine` is ``4/dx^2 B_p`` in all cases, and ``(dx^2/4) m_p (A_ba - A_ab)`` a point's own angular momentum.
The plain scheme takes it as the affine velocity A_p of each member; ``group_apic`` takes ``A_p = B_p D_p^-1`` with the
second moment D_p of the group, and offsets from x_p: it conserves the same, and reproduces an affine velocity exactly,
where the plain scheme makes it larger at points with samples.

Samples without mass are there for comparison: points are alone, samples only receive forces. Nodes that only samples
reach have no mass, so the forces there are lost, and with them the momentum.

References
----------
D. Hyde, S. Gagniere, A. Marquez-Razon, J. Teran, An implicit updated Lagrangian formulation for liquids with large
surface energy (2020), for samples without mass.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from femdeform.mpm import group_kernels as kernels
from femdeform.mpm.grid import Grid, Stencils
from femdeform.mpm.point_quadrature import consistent_gradients
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.mpm.transfers import momentum_to_grid, velocity_to_points
from femdeform.types import FloatArray, IntArray


@dataclass(frozen=True)
class Groups:
    """The groups of all points, and their stencils on a grid with quadratic splines.

    Attributes
    ----------
    mass : (n_points,) float64
        Of the points [kg].
    positions : (n_members, dim) float64
        Members: all points, then all samples, then their mirror images in the order of the samples [m]; there are no
        images of samples without mass.
    owner : (n_members,) int64
        Point of each member.
    sizes : (n_points,) int64
        Number of members of each group that have mass.
    stencils : Stencils
        Of all members.
    massless : bool
        Whether samples have no mass, for comparison.
    """

    mass: FloatArray
    positions: FloatArray
    owner: IntArray
    sizes: IntArray
    stencils: Stencils
    massless: bool = False

    @classmethod
    def split(
        cls, x: FloatArray, mass: FloatArray, samples: SurfaceSamples | None, grid: Grid, massless: bool = False
    ) -> Groups:
        """Groups of points x (n, dim) with masses (n,); without samples each point is alone.

        Samples that are `massless` have no images, and no nodes but those of the points.

        Raises
        ------
        ValueError
            If the grid has no quadratic splines, or a position is not finite.
        """
        if grid.degree != 2:
            raise ValueError("groups need quadratic splines")
        n = len(x)
        own, near = np.arange(n), np.empty(0, np.int64)
        positions = np.array(x, dtype=float)
        if samples is not None and samples.n:
            near = samples.owner
            images = positions[:0] if massless else 2.0 * positions[near] - samples.points
            positions = np.concatenate([positions, samples.points, images])
        if massless:
            stencils = grid.stencils(positions, n)
            return cls(np.asarray(mass), positions, np.concatenate([own, near]), np.ones_like(own), stencils, True)
        owner = np.concatenate([own, near, near])
        return cls(np.asarray(mass), positions, owner, np.bincount(owner, minlength=n), grid.stencils(positions))

    @property
    def n(self) -> int:
        """Number of points."""
        return int(self.mass.size)

    @property
    def points(self) -> IntArray:
        """Member of each point."""
        return np.arange(self.n)

    @property
    def samples(self) -> IntArray:
        """Member of each sample."""
        return np.arange(self.n, self.owner.size if self.massless else (self.n + self.owner.size) // 2)

    @property
    def carriers(self) -> IntArray:
        """Members that have mass."""
        return self.points if self.massless else np.arange(self.owner.size)

    @cached_property
    def force_gradients(self) -> FloatArray:
        """Gradients of points and samples whose forces add up to nothing, see `consistent_gradients` [1/m]."""
        return consistent_gradients(self.stencils, self.n + self.samples.size)

    def arms(self) -> FloatArray:
        """Positions of the members relative to their points, (n_members, dim) [m]."""
        return self.positions - self.positions[self.owner]

    def moments(self) -> FloatArray:
        """Second moments of the groups, ``D_p = dx^2/4 I + mean (x_k - x_p)(x_k - x_p)^T``, (n, dim, dim) [m^2]."""
        arms = self.arms()
        dim = arms.shape[1]
        return 0.25 * self.stencils.spacing**2 * np.eye(dim) + self.mean(arms[:, :, None] * arms[:, None, :])

    def mean(self, values: FloatArray) -> FloatArray:
        """Means over the groups, by mass, (n_points, ...) of values of the members (n_members, ...)."""
        flat, owner = values.reshape(len(values), -1)[self.carriers], self.owner[self.carriers]
        # One owner after another, each member in turn: sums do not depend on anything else.
        sums = np.stack([np.bincount(owner, column, self.n) for column in flat.T], axis=1)
        return np.asarray((sums / self.sizes[:, None]).reshape(self.n, *values.shape[1:]))

    def to_grid(self, v: FloatArray, affine: FloatArray, group_apic: bool = False) -> tuple[FloatArray, FloatArray]:
        """Masses (n_nodes,) [kg] and velocities (n_nodes, dim) [m/s] of the nodes.

        Parameters
        ----------
        v, affine : (n_points, dim), (n_points, dim, dim) float64
            See `Particles`; PIC and FLIP pass zeros as `affine`.
        group_apic : bool
            See the module.
        """
        share = np.zeros(self.owner.size)
        share[self.carriers] = (self.mass / self.sizes)[self.owner[self.carriers]]
        carried = v[self.owner]
        if group_apic:
            # A B-spline's own moment is taken out of `affine`, that of the group put in.
            rates = 0.25 * self.stencils.spacing**2 * affine @ np.linalg.inv(self.moments())
            carried = carried + np.einsum("kab,kb->ka", rates[self.owner], self.arms())
        else:
            rates = affine
        return momentum_to_grid(self.stencils, self.positions, share, carried, rates[self.owner])

    def to_points(self, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocities (n_points, dim) [m/s] and `affine` (n_points, dim, dim) [1/s] of the merged points.

        FLIP adds ``to_points(v_new - v_old)[0]`` to the velocities of the points; in all cases points move with the
        velocities that this returns for the new velocities of the nodes.
        """
        carried, rates = velocity_to_points(self.stencils, self.positions, velocity)
        turned = rates + 4.0 / self.stencils.spacing**2 * carried[:, :, None] * self.arms()[:, None, :]
        return self.mean(carried), self.mean(turned)

    def displaced(
        self, velocity: FloatArray, v: FloatArray, affine: FloatArray, dt: float
    ) -> tuple[FloatArray, FloatArray]:
        """Positions (n_points, dim) [m] of points that moved with the grid where they are, and their `affine`.

        ``x_p + dt (v(x_p) + c)`` with one c for all, so that the centre of mass moves by dt times its velocity. In
        place of ``x_p + dt v_p`` that is a shift s_p, which takes the momentum of the point along: the angular momentum
        ``m_p s_p x v_p`` goes to its own, with velocities relative to the centre of mass, so that a common one does
        nothing.

        Parameters
        ----------
        velocity : (n_nodes, dim) float64
            Of the nodes [m/s].
        v, affine
            What `to_points` makes of it.
        dt : float
            [s].
        """
        total = self.mass.sum()
        shift = dt * (self.stencils.to_points(velocity)[self.points] - v)
        shift -= self.mass @ shift / total
        relative = v - self.mass @ v / total
        turned = shift[:, :, None] * relative[:, None, :]
        # A point's own angular momentum is dx^2/4 m (A_ba - A_ab).
        own = 2.0 / self.stencils.spacing**2 * (turned - np.swapaxes(turned, 1, 2))
        return self.positions[: self.n] + dt * v + shift, affine + own

    def gradients(self, velocity: FloatArray) -> FloatArray:
        """Gradients of the velocity at the points themselves, ``sum v_i grad N_i(x_p)^T``, (n_points, d, d) [1/s]."""
        dim = velocity.shape[1]
        out = np.empty((self.mass.size, dim, dim))
        kernels.velocity_gradients(
            np.ascontiguousarray(velocity), self.stencils.nodes, self.stencils.gradients, self.points, out
        )
        return out

    def forces(self, stress: FloatArray) -> FloatArray:
        """Forces of stresses at the nodes (n_nodes, dim) [N].

        Parameters
        ----------
        stress : (n_points, 6) or (n_points, 3) float64
            ``V0 P F^T`` of each point [J], see `group_step.stresses`.
        """
        s = self.stencils
        point = np.full(self.owner.size, -1, dtype=np.int64)
        point[self.points] = np.arange(self.mass.size)
        out = np.empty_like(s.positions)
        kernel = kernels.stress_forces_2d if out.shape[1] == 2 else kernels.stress_forces_3d
        kernel(np.ascontiguousarray(stress), point, self.force_gradients, s.offsets, s.entries, out)
        return out
