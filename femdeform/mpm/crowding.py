"""Liquid points that have come closer together than their J says are told so.

J follows the gradient of the velocity at the points; between them the field can converge all the same, and points then
crowd where J says one. The volumes that points claim, summed on the grid over what there is of it,
``theta_i = sum_p V_p N_i(x_p)/dx^d``, show it: more than one does not fit. Their pressure is raised where it is,

    J_p <- J_p (1 - a max(0, theta(x_p) - 1.05)),        theta(x_p) = sum_i theta_i N_i(x_p)

which is a force between points like any pressure and keeps momenta. Nothing is done where theta is less than one, as it
is at every surface.

Limitations
-----------
Energy is not kept: pressure that is added pushes. What moves without crowding pays nothing for it.
"""

from __future__ import annotations

import numpy as np

from femdeform.mpm.explicit_laws import HIGHEST_J, LOWEST_J
from femdeform.mpm.grid import Stencils
from femdeform.mpm.particles import LIQUID, Particles, current_volumes
from femdeform.types import FloatArray

# Of random points at their density of rest, theta(x_p) is up to this [-]; a drop at rest would swell were it one.
CROWDED = 1.05


def filling(particles: Particles, stencils: Stencils) -> FloatArray:
    """theta at the points (n,) [-]: volume that points claim over what there is of it, as the grid sees it.

    Parameters
    ----------
    particles : Particles
        Solid ones have the volume det F V0.
    stencils : Stencils
        Of these points where they are.
    """
    claimed = stencils.to_nodes(current_volumes(particles)[:, None])
    claimed /= stencils.spacing**particles.dim
    return stencils.to_points(claimed)[:, 0]


def uncrowded(particles: Particles, stencils: Stencils, strength: float) -> FloatArray:
    """J of all points (n,) [-], lowered at liquid ones that are crowded.

    Parameters
    ----------
    particles, stencils
        See `filling`.
    strength : float
        The part a of the excess that J takes up [-].
    """
    excess = np.maximum(filling(particles, stencils) - CROWDED, 0.0)
    lowered = np.clip(particles.J * (1.0 - strength * excess), LOWEST_J, HIGHEST_J)
    return np.where(particles.phase == LIQUID, lowered, particles.J)
