"""Forces of surface tension at the nodes before they move, for explicit steps."""

from __future__ import annotations

import numpy as np

from femdeform.mpm.groups import Groups
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.types import FloatArray


def surface_forces(groups: Groups, samples: SurfaceSamples, k: FloatArray) -> FloatArray:
    """Forces ``-sum_r k_r |dA_r| (I - n_r n_r^T) grad N_i(s_r)`` (n_nodes, dim) [N].

    The derivative of ``sum_r k_r |cof(F) n_r dA_r|`` at F = I.

    Parameters
    ----------
    groups : Groups
        Of the points with these samples.
    samples : SurfaceSamples
        The samples.
    k : (n_samples,) float64
        Their tension [N/m].
    """
    stencils, rows = groups.stencils, groups.samples
    weight = k * samples.measure
    gradients = groups.force_gradients[rows]
    across = np.einsum("rkc,rc->rk", gradients, samples.normals)
    pull = weight[:, None, None] * (across[:, :, None] * samples.normals[:, None, :] - gradients)
    nodes = stencils.nodes[rows].ravel()
    flat = pull.reshape(-1, samples.points.shape[1])
    return np.stack([np.bincount(nodes, column, stencils.n_nodes) for column in flat.T], axis=1)
