"""The curl of a velocity on a grid."""

from __future__ import annotations

import numpy as np

from femdeform.types import FloatArray


def vorticity(velocity: FloatArray, spacing: float, dim: int) -> FloatArray:
    """Curl of a velocity.

    Parameters
    ----------
    velocity : (nx, ny, nz, 2 or 3) float64
        At the centres of voxels [m/s].
    spacing : float
        Side of a voxel [m].
    dim : int
        Dimension of the flow.

    Returns
    -------
    (nx, ny, nz, 3) float64, in the plane the z component (nx, ny, nz)
        By central differences [1/s].
    """

    def slope(component: int, axis: int) -> FloatArray:
        return np.asarray(np.gradient(velocity[..., component], spacing, axis=axis))

    z = slope(1, 0) - slope(0, 1)
    if dim == 2:
        return z
    return np.stack([slope(2, 1) - slope(1, 2), slope(0, 2) - slope(2, 0), z], axis=-1)
