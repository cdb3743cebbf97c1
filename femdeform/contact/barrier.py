"""The barrier of a gap and the smoothed Coulomb law, as functions of one distance or one slip.

Both are those of ipctk, so that contact with obstacles and contact between bodies obey the same law.

Barrier of a gap d, active below ``d_hat``, per area and per unit of its stiffness, with D = d^2, D_hat = d_hat^2
(both less the square of a smallest gap d_min where bodies have a thickness):

    b(D) = -d_hat (D / D_hat - 1)^2 ln(D / D_hat)     [m],   b = 0 for D >= D_hat

so that ``stiffness [Pa] * area * b`` is an energy. It is twice continuously differentiable and grows without bound as
the gap closes.

Friction: the work of a slip of length y is ``mu N f0(y)``, with the force law f1 = df0/dy = 2 y/h - (y/h)^2 below the
slip h and 1 beyond.

References
----------
M. Li et al., Incremental Potential Contact (2020), eqs. (6) and (16). M. Li et al., Convergent Incremental Potential
Contact (2023), for the physical scaling.
"""

from __future__ import annotations

import numpy as np

from femdeform.types import FloatArray


def barrier(gap: FloatArray, reach: float, offset: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Barrier [m] with its first [-] and second [1/m] derivative by the distance.

    Parameters
    ----------
    gap : (n,) float64
        Distance less the offset [m]; below `reach`. Where it is not positive the barrier is infinite.
    reach : float
        Gap d_hat at which the barrier starts [m].
    offset : (n,) float64
        Smallest distance d_min [m].

    Returns
    -------
    value, slope, curvature : (n,) float64
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        # D - d_min^2 without cancellation.
        area = gap * (gap + 2.0 * offset)
        limit = reach * (reach + 2.0 * offset)
        ratio = area / limit
        log = np.log(ratio)
        below = ratio - 1.0
        value = -reach * below**2 * log
        first = -reach / limit * below * (2.0 * log + below / ratio)
        second = reach / limit**2 * (-2.0 * log - 4.0 * below / ratio + (below / ratio) ** 2)
        distance = gap + offset
        slope = 2.0 * distance * first
        curvature = 4.0 * distance**2 * second + 2.0 * first
    open_ = gap > 0.0
    return (
        np.where(open_, value, np.inf),
        np.where(open_, slope, -np.inf),
        np.where(open_, curvature, np.inf),
    )


def friction_work(slip: FloatArray, scale: float) -> FloatArray:
    """f0 of slips (n,) [m] that stick up to `scale` [m]."""
    ratio = slip / scale
    return np.asarray(np.where(ratio < 1.0, scale * (ratio**2 - ratio**3 / 3.0 + 1.0 / 3.0), slip))


def friction_force(slip: FloatArray, scale: float) -> tuple[FloatArray, FloatArray]:
    """f1 over the slip [1/m], finite at rest, and the derivative of f1 [1/m], both (n,)."""
    ratio = slip / scale
    sticks = ratio < 1.0
    secant = np.where(sticks, (2.0 - ratio) / scale, 1.0 / np.maximum(slip, scale))
    return secant, np.where(sticks, 2.0 * (1.0 - ratio) / scale, 0.0)
