"""APIC transfers of mass and momentum between points and grid nodes.

References
----------
C. Jiang, C. Schroeder, A. Selle, J. Teran, A. Stomakhin, The affine particle-in-cell method (2015).

Limitations
-----------
Linear momentum is kept to rounding by both kernels, angular momentum over many steps by the quadratic one only: the
inertia of a linear stencil depends on where in its cell a point is, and points move.
"""

from __future__ import annotations

import numpy as np

from femdeform.mpm import kernels
from femdeform.mpm.grid import Stencils
from femdeform.types import FloatArray


def momentum_to_grid(
    stencils: Stencils, points: FloatArray, mass: FloatArray, velocity: FloatArray, affine: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Masses (n_nodes,) [kg] and velocities (n_nodes, dim) [m/s] of the grid nodes.

    Parameters
    ----------
    stencils : Stencils
        Of the points.
    points, velocity : (n_points, dim) float64
        [m], [m/s].
    mass : (n_points,) float64
        [kg].
    affine : (n_points, dim, dim) float64
        C, the gradient of the velocity around each point [1/s].
    """
    out_mass = np.empty(stencils.n_nodes)
    out_velocity = np.empty_like(stencils.positions)
    kernels.momentum_to_nodes(
        np.ascontiguousarray(points),
        mass,
        np.ascontiguousarray(velocity),
        affine,
        stencils.weights,
        stencils.offsets,
        stencils.entries,
        stencils.positions,
        out_mass,
        out_velocity,
    )
    return out_mass, out_velocity


def velocity_to_points(stencils: Stencils, points: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocities (n_points, dim) [m/s] and their gradients C (n_points, dim, dim) [1/s] from those of the nodes."""
    n, dim = points.shape
    out_velocity = np.empty((n, dim))
    out_affine = np.empty((n, dim, dim))
    kernels.velocity_to_points(
        np.ascontiguousarray(points),
        stencils.nodes,
        stencils.weights,
        stencils.gradients,
        stencils.positions,
        np.ascontiguousarray(velocity),
        stencils.spacing,
        stencils.degree,
        out_velocity,
        out_affine,
    )
    return out_velocity, out_affine


def spin(spacing: float, degree: int, points: FloatArray, mass: FloatArray, affine: FloatArray) -> FloatArray:
    """Angular momentum that the affine velocity of each point carries about the point [kg m^2/s], (n_points, 3).

    ``m eps_abc (C D)_cb`` with the inertia ``D = sum w (x_I - x_p)(x_I - x_p)^T`` of the stencil, which is diagonal:
    dx^2/4 for quadratic splines, dx^2 f (1 - f) with the place f in the cell for linear ones.
    """
    dim = points.shape[1]
    if degree == 2:
        inertia = np.full(points.shape, 0.25 * spacing**2)
    else:
        f = points / spacing - np.floor(points / spacing)
        inertia = spacing**2 * f * (1.0 - f)
    moment = mass[:, None, None] * affine * inertia[:, None, :]
    out = np.zeros((len(points), 3))
    out[:, 2] = moment[:, 1, 0] - moment[:, 0, 1]
    if dim == 3:
        out[:, 0] = moment[:, 2, 1] - moment[:, 1, 2]
        out[:, 1] = moment[:, 0, 2] - moment[:, 2, 0]
    return out
