"""Elasticity of a cell as constraints C(F) with a stiffness k: its energy is V k C^2 / 2, up to a constant.

| law | C1 | k1 | C2 | k2 |
|---|---|---|---|---|
| fixed corotated, ARAP | sqrt(abs(F - R)^2 + epsilon) | 2 mu | J - 1 | lambda |
| neo-Hookean | abs(F) | mu | J - 1 - mu/lambda^ | lambda^ = lambda + mu |
| any, as a root | sqrt(2 Psi/mu + epsilon) | mu | none | |

C is a number without units; the compliance of XPBD is 1 / (k V). (The second stiffness of the neo-Hookean pair is
printed as lambda in the dissertation.)
"""

from __future__ import annotations

import math
from typing import Any

from numba.extending import overload

from femdeform.jit import TypingError, njit
from femdeform.materials.arap import ARAP
from femdeform.materials.corotated import Corotated
from femdeform.materials.dispatch import energy_density, pk1
from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.materials.linear import Linear
from femdeform.materials.logarithmic_neo_hookean import LogarithmicNeoHookean
from femdeform.materials.neo_hookean import NeoHookean
from femdeform.materials.saint_venant_kirchhoff import SaintVenantKirchhoff
from femdeform.materials.small_matrix import (
    cofactor_3d,
    det_3d,
    polar_rotation_2d,
    polar_rotation_3d,
)
from femdeform.materials.stable_neo_hookean import StableNeoHookean
from solvers.position_based.cell_algebra import cofactor, combine, determinant, dot
from solvers.position_based.inlining import inlined_overload

ROTATED = (FixedCorotated, ARAP)
# Laws that are a pair of constraints, and those of them whose constraints vanish at rest.
PAIRED = (*ROTATED, NeoHookean)
VANISHING = ROTATED

# What the last relative correction of Halley's rule may be, its next being its cube; and how near to a jump of R.
CORRECTION, JUMP = 1e-5, 1e3


# ---------------------------------------------------------------------------------------- rotation


@njit
def _rotation_3d(F: Any) -> Any:
    """R of F = R S with det R = 1; see `fast_kernels.add_rotated` for the formula."""
    C0 = F[0] * F[0] + F[3] * F[3] + F[6] * F[6]
    C1 = F[1] * F[1] + F[4] * F[4] + F[7] * F[7]
    C2 = F[2] * F[2] + F[5] * F[5] + F[8] * F[8]
    C3 = F[1] * F[2] + F[4] * F[5] + F[7] * F[8]
    C4 = F[0] * F[2] + F[3] * F[5] + F[6] * F[8]
    C5 = F[0] * F[1] + F[3] * F[4] + F[6] * F[7]
    J = det_3d(F)
    square = C0 + C1 + C2
    constant = 2.0 * (C0 * C0 + C1 * C1 + C2 * C2) + 4.0 * (C3 * C3 + C4 * C4 + C5 * C5) - square * square
    t = math.sqrt(3.0 * square)
    correction = t
    for _ in range(6):
        tt = t * t
        value = (tt - 2.0 * square) * tt - 8.0 * J * t + constant
        slope = 4.0 * (tt - square) * t - 8.0 * J
        bend = 12.0 * tt - 4.0 * square
        correction = 2.0 * value * slope / (2.0 * slope * slope - value * bend)
        t -= correction
        if abs(correction) <= CORRECTION * t:
            break
    bottom = (t * t - square) * t - 2.0 * J
    if not (abs(correction) <= CORRECTION * t and t * t * t <= JUMP * bottom):
        return polar_rotation_3d(F)
    inverse = 1.0 / bottom
    a, b, c = (t * t + square) * inverse, 2.0 * t * inverse, -2.0 * inverse
    W = cofactor_3d(F)
    return (
        a * F[0] + b * W[0] + c * (F[0] * C0 + F[1] * C5 + F[2] * C4),
        a * F[1] + b * W[1] + c * (F[0] * C5 + F[1] * C1 + F[2] * C3),
        a * F[2] + b * W[2] + c * (F[0] * C4 + F[1] * C3 + F[2] * C2),
        a * F[3] + b * W[3] + c * (F[3] * C0 + F[4] * C5 + F[5] * C4),
        a * F[4] + b * W[4] + c * (F[3] * C5 + F[4] * C1 + F[5] * C3),
        a * F[5] + b * W[5] + c * (F[3] * C4 + F[4] * C3 + F[5] * C2),
        a * F[6] + b * W[6] + c * (F[6] * C0 + F[7] * C5 + F[8] * C4),
        a * F[7] + b * W[7] + c * (F[6] * C5 + F[7] * C1 + F[8] * C3),
        a * F[8] + b * W[8] + c * (F[6] * C4 + F[7] * C3 + F[8] * C2),
    )


def rotation(F: Any) -> Any:
    """The rotation closest to F, with determinant 1 also for det F < 0."""
    raise NotImplementedError("compiled code only")


@overload(rotation)
def _rotation(F: Any) -> Any:
    kernel = polar_rotation_2d if len(F) == 4 else _rotation_3d

    def implementation(F: Any) -> Any:
        return kernel(F)

    return implementation


# ---------------------------------------------------------------------------------------- constraints


def shear_constraint(F: Any, R: Any, law: Any, epsilon: Any) -> Any:
    """C1 and its derivative with respect to F; no derivative where C1 has none (F = R with epsilon = 0).

    R is the rotation of F where the law knows one, else anything.
    """
    raise NotImplementedError("compiled code only")


@inlined_overload(shear_constraint)
def _shear_constraint(F: Any, R: Any, law: Any, epsilon: Any) -> Any:
    def rotated(F: Any, R: Any, law: Any, epsilon: Any) -> Any:
        E = combine(F, 1.0, R, -1.0)
        C = math.sqrt(dot(E, E) + epsilon)
        scale = 1.0 / C if C > 0.0 else 0.0
        return C, combine(E, scale, E, 0.0)

    def neo_hookean(F: Any, R: Any, law: Any, epsilon: Any) -> Any:
        C = math.sqrt(dot(F, F))
        scale = 1.0 / C if C > 0.0 else 0.0
        return C, combine(F, scale, F, 0.0)

    return neo_hookean if _class(law, PAIRED) is NeoHookean else rotated


def volume_constraint(F: Any, law: Any) -> Any:
    """C2 and its derivative with respect to F."""
    raise NotImplementedError("compiled code only")


@inlined_overload(volume_constraint)
def _volume_constraint(F: Any, law: Any) -> Any:
    def rotated(F: Any, law: Any) -> Any:
        return determinant(F) - 1.0, cofactor(F)

    def neo_hookean(F: Any, law: Any) -> Any:
        return determinant(F) - 1.0 - law.mu / law.lmbda_hat, cofactor(F)

    return neo_hookean if _class(law, PAIRED) is NeoHookean else rotated


def stiffnesses(law: Any) -> Any:
    """k1 and k2 [Pa]."""
    raise NotImplementedError("compiled code only")


@overload(stiffnesses)
def _stiffnesses(law: Any) -> Any:
    def rotated(law: Any) -> Any:
        return 2.0 * law.mu, law.lmbda

    def neo_hookean(law: Any) -> Any:
        return law.mu, law.lmbda_hat

    return neo_hookean if _class(law, PAIRED) is NeoHookean else rotated


def _class(law: Any, known: tuple[type, ...]) -> type:
    kind: type = law.instance_class
    if kind not in known:
        raise TypingError(f"no constraints are known for {kind.__name__}")
    return kind


@njit
def root_constraint(F: Any, law: Any, epsilon: Any) -> Any:
    """C = sqrt(2 Psi/mu + epsilon) and its derivative, of any law."""
    C = math.sqrt(2.0 * max(energy_density(F, law), 0.0) / law.mu + epsilon)
    scale = 1.0 / (law.mu * C) if C > 0.0 else 0.0
    P = pk1(F, law)
    return C, combine(P, scale, P, 0.0)


# ---------------------------------------------------------------------------------------- stress and its model


def stress(F: Any, R: Any, law: Any) -> Any:
    """First Piola-Kirchhoff stress [Pa]; `pk1` with R already known where the law knows one, else anything."""
    raise NotImplementedError("compiled code only")


@inlined_overload(stress)
def _stress(F: Any, R: Any, law: Any) -> Any:
    def rotated(F: Any, R: Any, law: Any) -> Any:
        E = combine(F, 1.0, R, -1.0)
        return combine(E, 2.0 * law.mu, cofactor(F), law.lmbda * (determinant(F) - 1.0))

    def any_law(F: Any, R: Any, law: Any) -> Any:
        return pk1(F, law)

    return rotated if law.instance_class in ROTATED else any_law


def stress_model(F: Any, law: Any) -> Any:
    """``(a, c, W)`` of the definite model ``a I + c W (x) W`` of the tangent at F [Pa].

    Published: a = 2 mu, c = lambda, W = cof F (mu for the neo-Hookean law is a misprint, half its stiffness in shear).
    """
    raise NotImplementedError("compiled code only")


@inlined_overload(stress_model)
def _stress_model(F: Any, law: Any) -> Any:
    kind = law.instance_class

    def published(F: Any, law: Any) -> Any:
        return 2.0 * law.mu, law.lmbda, cofactor(F)

    def neo_hookean(F: Any, law: Any) -> Any:
        # Half of lambda^ = lambda + mu keeps single steps from overshooting where lambda < mu.
        return 2.0 * law.mu, max(law.lmbda, 0.5 * law.lmbda_hat), cofactor(F)

    def stable_neo_hookean(F: Any, law: Any) -> Any:
        return 2.0 * law.mu, max(law.lmbda, 0.5 * law.lmbda_corrected), cofactor(F)

    def logarithmic(F: Any, law: Any) -> Any:
        J = determinant(F)
        bulk = (law.mu + law.lmbda - law.lmbda * math.log(J)) / (J * J) if J > 0.0 else law.lmbda
        return 2.0 * law.mu, max(law.lmbda, bulk), cofactor(F)

    def linear(F: Any, law: Any) -> Any:
        return 2.0 * law.mu, law.lmbda, identity(F)

    def corotated(F: Any, law: Any) -> Any:
        return 2.0 * law.mu, law.lmbda, rotation(F)

    def saint_venant_kirchhoff(F: Any, law: Any) -> Any:
        # F^T dF is stretched by at most |F|, and tension adds the stress itself.
        square = dot(F, F)
        excess = max(square / dot(identity(F), identity(F)) - 1.0, 0.0)
        return 2.0 * law.mu * (1.0 + 2.0 * excess) + law.lmbda * excess, law.lmbda, F

    return {
        NeoHookean: neo_hookean,
        StableNeoHookean: stable_neo_hookean,
        LogarithmicNeoHookean: logarithmic,
        Linear: linear,
        Corotated: corotated,
        SaintVenantKirchhoff: saint_venant_kirchhoff,
    }.get(kind, published)


def identity(F: Any) -> Any:
    """I of the size of F."""
    raise NotImplementedError("compiled code only")


@inlined_overload(identity)
def _identity(F: Any) -> Any:
    def planar(F: Any) -> Any:
        return (1.0, 0.0, 0.0, 1.0)

    def spatial(F: Any) -> Any:
        return (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

    return planar if len(F) == 4 else spatial
