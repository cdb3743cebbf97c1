"""What the explicit kernels ask of a material: its stress at a point, and how the point's deformation goes on.

Solids are the laws of `femdeform.materials`, with ``F`` (n, dim, dim) as their state; liquids are `Liquid`, with ``J``
(n,). numba selects the code by the class of the law when a kernel is compiled, as `materials.dispatch` does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from femdeform.errors import InputError
from femdeform.jit import extending, njit, types
from femdeform.materials.dispatch import pk1
from femdeform.mpm.particles import LIQUID, Particles
from femdeform.types import IntArray

# Material of each body and phase that occurs, by (body, phase): a law of `femdeform.materials`, or `Liquid`.
Laws = Mapping[tuple[int, int], Any]

# Volume ratios of liquid points are kept between these; reaching them is reported.
LOWEST_J, HIGHEST_J = 0.1, 10.0


class Liquid(NamedTuple):
    """A liquid of little compressibility: Kirchhoff stress ``bulk_modulus (J - 1) J I + 2 viscosity J eps``.

    Attributes
    ----------
    bulk_modulus : float
        Pressure over the loss of volume, -p / (J - 1) [Pa].
    viscosity : float
        Dynamic viscosity [Pa s].
    """

    bulk_modulus: float
    viscosity: float


def is_viscous(law: Any) -> bool:
    """Whether the stress depends on the gradient of the velocity."""
    return isinstance(law, Liquid) and bool(law.viscosity > 0.0)


def material_sets(particles: Particles, laws: Laws) -> list[tuple[IntArray, Any]]:
    """Rows of the points of each body and phase, and their material.

    Raises
    ------
    InputError
        If a body has no material for a phase of its points, or one that is not of that phase.
    """
    out = []
    kinds = 2 * particles.body.astype(np.int64) + particles.phase
    for kind in np.unique(kinds).tolist():
        body, phase = divmod(kind, 2)
        name = "liquid" if phase == LIQUID else "solid"
        if (body, phase) not in laws:
            raise InputError(f"body {body} has no material for {name} points")
        law = laws[body, phase]
        if isinstance(law, Liquid) != (phase == LIQUID):
            raise InputError(f"body {body}: {type(law).__name__} is no material of {name} points")
        out.append((np.flatnonzero(kinds == kind), law))
    return out


# ---------------------------------------------------------------------------------------- 3D


@njit
def _solid_stress_3d(F: Any, p: Any, gradient: Any, law: Any) -> Any:
    a = (
        F[p, 0, 0],
        F[p, 0, 1],
        F[p, 0, 2],
        F[p, 1, 0],
        F[p, 1, 1],
        F[p, 1, 2],
        F[p, 2, 0],
        F[p, 2, 1],
        F[p, 2, 2],
    )
    P = pk1(a, law)
    return (
        P[0] * a[0] + P[1] * a[1] + P[2] * a[2],
        P[3] * a[3] + P[4] * a[4] + P[5] * a[5],
        P[6] * a[6] + P[7] * a[7] + P[8] * a[8],
        P[3] * a[6] + P[4] * a[7] + P[5] * a[8],
        P[0] * a[6] + P[1] * a[7] + P[2] * a[8],
        P[0] * a[3] + P[1] * a[4] + P[2] * a[5],
    )


@njit
def _liquid_stress_3d(J: Any, p: Any, gradient: Any, law: Any) -> Any:
    volume = J[p]
    pull = law.bulk_modulus * (volume - 1) * volume
    if law.viscosity == 0:
        return (pull, pull, pull, 0 * pull, 0 * pull, 0 * pull)
    drag = law.viscosity * volume
    return (
        pull + 2 * drag * gradient[p, 0, 0],
        pull + 2 * drag * gradient[p, 1, 1],
        pull + 2 * drag * gradient[p, 2, 2],
        drag * (gradient[p, 1, 2] + gradient[p, 2, 1]),
        drag * (gradient[p, 0, 2] + gradient[p, 2, 0]),
        drag * (gradient[p, 0, 1] + gradient[p, 1, 0]),
    )


def stress_3d(state: Any, p: Any, gradient: Any, law: Any) -> Any:
    """Kirchhoff stress ``P F^T`` of a point [Pa], (xx, yy, zz, yz, xz, xy).

    Parameters
    ----------
    state : (n, 3, 3) or (n,) array
        F of solids, J of liquids.
    p : int
        The point.
    gradient : (n, 3, 3) array
        Gradients of the velocity before the step [1/s]; read of viscous liquids only.
    law : NamedTuple
        A law of `femdeform.materials`, or `Liquid`.
    """
    return (_liquid_stress_3d if isinstance(law, Liquid) else _solid_stress_3d)(state, p, gradient, law)


@njit
def _deform_3d(F: Any, p: Any, L: Any, dt: Any, law: Any) -> int:
    for c in range(3):
        a, b, e = F[p, 0, c], F[p, 1, c], F[p, 2, c]
        F[p, 0, c] = a + dt * (L[0] * a + L[1] * b + L[2] * e)
        F[p, 1, c] = b + dt * (L[3] * a + L[4] * b + L[5] * e)
        F[p, 2, c] = e + dt * (L[6] * a + L[7] * b + L[8] * e)
    return 0


@njit
def _swell(J: Any, p: Any, linear: Any, higher: Any) -> int:
    # det(I + dt L) - 1; not where a point turns inside out, of which the even powers know nothing.
    change = linear + higher if linear > -1 else linear
    # Written so that nan stays nan.
    J[p] += change * J[p]
    if J[p] < LOWEST_J:
        J[p] = LOWEST_J
        return 1
    if J[p] > HIGHEST_J:
        J[p] = HIGHEST_J
        return 1
    return 0


@njit
def _swell_3d(J: Any, p: Any, L: Any, dt: Any, law: Any) -> int:
    xx, xy, xz = L[4] * L[8] - L[5] * L[7], L[5] * L[6] - L[3] * L[8], L[3] * L[7] - L[4] * L[6]
    second = xx + L[0] * L[8] - L[2] * L[6] + L[0] * L[4] - L[1] * L[3]
    return _swell(J, p, dt * (L[0] + L[4] + L[8]), dt * dt * (second + dt * (L[0] * xx + L[1] * xy + L[2] * xz)))


def deform_3d(state: Any, p: Any, L: Any, dt: Any, law: Any) -> int:
    """Deform a point: ``F <- (I + dt L) F``, ``J <- det(I + dt L) J``; 1 where J was kept in its bounds, else 0."""
    done: int = (_swell_3d if isinstance(law, Liquid) else _deform_3d)(state, p, L, dt, law)
    return done


# ---------------------------------------------------------------------------------------- 2D


@njit
def _solid_stress_2d(F: Any, p: Any, gradient: Any, law: Any) -> Any:
    a = (F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1])
    P = pk1(a, law)
    return (P[0] * a[0] + P[1] * a[1], P[2] * a[2] + P[3] * a[3], P[0] * a[2] + P[1] * a[3])


@njit
def _liquid_stress_2d(J: Any, p: Any, gradient: Any, law: Any) -> Any:
    volume = J[p]
    pull = law.bulk_modulus * (volume - 1) * volume
    if law.viscosity == 0:
        return (pull, pull, 0 * pull)
    drag = law.viscosity * volume
    return (
        pull + 2 * drag * gradient[p, 0, 0],
        pull + 2 * drag * gradient[p, 1, 1],
        drag * (gradient[p, 0, 1] + gradient[p, 1, 0]),
    )


def stress_2d(state: Any, p: Any, gradient: Any, law: Any) -> Any:
    """Kirchhoff stress of a point [Pa], (xx, yy, xy); see `stress_3d`."""
    return (_liquid_stress_2d if isinstance(law, Liquid) else _solid_stress_2d)(state, p, gradient, law)


@njit
def _deform_2d(F: Any, p: Any, L: Any, dt: Any, law: Any) -> int:
    for c in range(2):
        a, b = F[p, 0, c], F[p, 1, c]
        F[p, 0, c] = a + dt * (L[0] * a + L[1] * b)
        F[p, 1, c] = b + dt * (L[2] * a + L[3] * b)
    return 0


@njit
def _swell_2d(J: Any, p: Any, L: Any, dt: Any, law: Any) -> int:
    return _swell(J, p, dt * (L[0] + L[3]), dt * dt * (L[0] * L[3] - L[1] * L[2]))


def deform_2d(state: Any, p: Any, L: Any, dt: Any, law: Any) -> int:
    """Deform a point; see `deform_3d`."""
    done: int = (_swell_2d if isinstance(law, Liquid) else _deform_2d)(state, p, L, dt, law)
    return done


# ---------------------------------------------------------------------------------------- selection


def _is_liquid(law: Any) -> bool:
    return isinstance(law, types.BaseNamedTuple) and law.instance_class is Liquid


def _select_stress(stub: Any, solid: Any, liquid: Any) -> None:
    @extending.overload(stub)
    def _chosen(state: Any, p: Any, gradient: Any, law: Any) -> Any:
        kernel = liquid if _is_liquid(law) else solid

        def implementation(state: Any, p: Any, gradient: Any, law: Any) -> Any:
            return kernel(state, p, gradient, law)

        return implementation


def _select_deformation(stub: Any, solid: Any, liquid: Any) -> None:
    @extending.overload(stub)
    def _chosen(state: Any, p: Any, L: Any, dt: Any, law: Any) -> Any:
        kernel = liquid if _is_liquid(law) else solid

        def implementation(state: Any, p: Any, L: Any, dt: Any, law: Any) -> Any:
            return kernel(state, p, L, dt, law)

        return implementation


_select_stress(stress_3d, _solid_stress_3d, _liquid_stress_3d)
_select_stress(stress_2d, _solid_stress_2d, _liquid_stress_2d)
_select_deformation(deform_3d, _deform_3d, _swell_3d)
_select_deformation(deform_2d, _deform_2d, _swell_2d)
