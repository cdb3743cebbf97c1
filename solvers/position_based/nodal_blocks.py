"""The modified Hessian of one node: what a cell adds to the 3x3 or 2x2 matrix of the node's step.

With u the gradient n of the node's shape function, moving the node by s changes F by s n^T. The published block of a
law with the Lame parameters (mu, lambda) is ``A = 2 mu |n|^2 I + lambda c c^T`` with ``c = cof(F) n`` (dissertation,
eq. 6.36, with its transposed index corrected). It bounds the energy along the step for the fixed corotated law and
ARAP, whatever F is; other laws need a little more, which their function below adds. Blocks are per volume [Pa/m^2] and
ordered (00, 11, 22, 12, 02, 01).

Laws of which the block is no bound for every step are `is_bounded` = False: the sweep then looks at the energy itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from numba.extending import overload

from femdeform.jit import TypingError, njit, types
from femdeform.materials.arap import ARAP
from femdeform.materials.corotated import Corotated
from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.materials.linear import Linear
from femdeform.materials.logarithmic_neo_hookean import LogarithmicNeoHookean
from femdeform.materials.neo_hookean import NeoHookean
from femdeform.materials.saint_venant_kirchhoff import SaintVenantKirchhoff
from femdeform.materials.small_matrix import (
    cofactor_2d,
    cofactor_3d,
    det_2d,
    det_3d,
    rotation_and_trace_2d,
    rotation_and_trace_3d,
)
from femdeform.materials.stable_neo_hookean import StableNeoHookean

# ---------------------------------------------------------------------------------------- sums


@njit
def apply_3d(F: Any, n: Any) -> Any:
    """F n."""
    return (
        F[0] * n[0] + F[1] * n[1] + F[2] * n[2],
        F[3] * n[0] + F[4] * n[1] + F[5] * n[2],
        F[6] * n[0] + F[7] * n[1] + F[8] * n[2],
    )


@njit
def apply_2d(F: Any, n: Any) -> Any:
    """F n."""
    return (F[0] * n[0] + F[1] * n[1], F[2] * n[0] + F[3] * n[1])


@njit
def _square_3d(n: Any) -> Any:
    return n[0] * n[0] + n[1] * n[1] + n[2] * n[2]


@njit
def _identity_and_square_3d(m: Any, k: Any, v: Any) -> Any:
    """m I + k v v^T."""
    a, b, c = k * v[0], k * v[1], k * v[2]
    return (m + a * v[0], m + b * v[1], m + c * v[2], b * v[2], a * v[2], a * v[1])


@njit
def _identity_and_square_2d(m: Any, k: Any, v: Any) -> Any:
    return (m + k * v[0] * v[0], m + k * v[1] * v[1], k * v[0] * v[1])


# ---------------------------------------------------------------------------------------- 3D


@njit
def published_3d(F: Any, n: Any, law: Any) -> Any:
    """2 mu |n|^2 I + lambda c c^T."""
    return _identity_and_square_3d(2.0 * law.mu * _square_3d(n), law.lmbda, apply_3d(cofactor_3d(F), n))


@njit
def _neo_hookean_3d(F: Any, n: Any, law: Any) -> Any:
    # The energy is quadratic in the step, with mu |n|^2 I + lambda^ c c^T: half of lambda^ = lambda + mu keeps it from
    # rising where lambda < mu.
    k = max(law.lmbda, 0.5 * law.lmbda_hat)
    return _identity_and_square_3d(2.0 * law.mu * _square_3d(n), k, apply_3d(cofactor_3d(F), n))


@njit
def _stable_neo_hookean_3d(F: Any, n: Any, law: Any) -> Any:
    # Its shear part is never stiffer than 1.125 mu' |n|^2 < 2 mu |n|^2.
    k = max(law.lmbda, 0.5 * law.lmbda_corrected)
    return _identity_and_square_3d(2.0 * law.mu * _square_3d(n), k, apply_3d(cofactor_3d(F), n))


@njit
def _logarithmic_3d(F: Any, n: Any, law: Any) -> Any:
    # g'' grows like 1 / J^2 under compression.
    J = det_3d(F)
    k = max(law.lmbda, (law.mu + law.lmbda - law.lmbda * math.log(J)) / (J * J)) if J > 0.0 else law.lmbda
    return _identity_and_square_3d(2.0 * law.mu * _square_3d(n), k, apply_3d(cofactor_3d(F), n))


@njit
def _linear_3d(F: Any, n: Any, law: Any) -> Any:
    return _identity_and_square_3d(2.0 * law.mu * _square_3d(n), law.lmbda, n)


@njit
def _corotated_3d(F: Any, n: Any, law: Any) -> Any:
    # d(tr S)/dF = R, and under tension lambda t times the derivative of R: with K = tr(S) I - F R^T and r = R n its
    # nodal part is ((r.K r) K - (K r)(K r)^T) / det K. (What is returned beside R is t = tr(S - I).)
    R, strain = rotation_and_trace_3d(F)
    r = apply_3d(R, n)
    block = _identity_and_square_3d(2.0 * law.mu * _square_3d(n), law.lmbda, r)
    tension, trace = law.lmbda * strain, strain + 3.0
    if not tension > 0.0:
        return block
    k00 = trace - (F[0] * R[0] + F[1] * R[1] + F[2] * R[2])
    k11 = trace - (F[3] * R[3] + F[4] * R[4] + F[5] * R[5])
    k22 = trace - (F[6] * R[6] + F[7] * R[7] + F[8] * R[8])
    k01 = -(F[0] * R[3] + F[1] * R[4] + F[2] * R[5])
    k02 = -(F[0] * R[6] + F[1] * R[7] + F[2] * R[8])
    k12 = -(F[3] * R[6] + F[4] * R[7] + F[5] * R[8])
    p = (
        k00 * r[0] + k01 * r[1] + k02 * r[2],
        k01 * r[0] + k11 * r[1] + k12 * r[2],
        k02 * r[0] + k12 * r[1] + k22 * r[2],
    )
    det = k00 * (k11 * k22 - k12 * k12) - k01 * (k01 * k22 - k12 * k02) + k02 * (k01 * k12 - k11 * k02)
    if not det > 1e-3 * trace * trace * trace:  # inverted cells, where R may jump
        return block
    c = tension / det
    q = r[0] * p[0] + r[1] * p[1] + r[2] * p[2]
    return (
        block[0] + c * (q * k00 - p[0] * p[0]),
        block[1] + c * (q * k11 - p[1] * p[1]),
        block[2] + c * (q * k22 - p[2] * p[2]),
        block[3] + c * (q * k12 - p[1] * p[2]),
        block[4] + c * (q * k02 - p[0] * p[2]),
        block[5] + c * (q * k01 - p[0] * p[1]),
    )


@njit
def _saint_venant_kirchhoff_3d(F: Any, n: Any, law: Any) -> Any:
    # The exact block is (n.S n) I + mu |n|^2 F F^T + (mu + lambda) (F n)(F n)^T; a compressive n.S n is cut off.
    u = apply_3d(F, n)
    nn = _square_3d(n)
    square = 0.0
    for k in range(9):
        square += F[k] * F[k]
    w0 = F[0] * u[0] + F[3] * u[1] + F[6] * u[2]
    w1 = F[1] * u[0] + F[4] * u[1] + F[7] * u[2]
    w2 = F[2] * u[0] + F[5] * u[1] + F[8] * u[2]
    pull = law.mu * ((w0 * n[0] + w1 * n[1] + w2 * n[2]) - nn) + 0.5 * law.lmbda * (square - 3.0) * nn
    m = law.mu * nn
    block = _identity_and_square_3d(max(pull, 0.1 * m), law.mu + law.lmbda, u)
    return (
        block[0] + m * (F[0] * F[0] + F[1] * F[1] + F[2] * F[2]),
        block[1] + m * (F[3] * F[3] + F[4] * F[4] + F[5] * F[5]),
        block[2] + m * (F[6] * F[6] + F[7] * F[7] + F[8] * F[8]),
        block[3] + m * (F[3] * F[6] + F[4] * F[7] + F[5] * F[8]),
        block[4] + m * (F[0] * F[6] + F[1] * F[7] + F[2] * F[8]),
        block[5] + m * (F[0] * F[3] + F[1] * F[4] + F[2] * F[5]),
    )


# ---------------------------------------------------------------------------------------- 2D


@njit
def published_2d(F: Any, n: Any, law: Any) -> Any:
    """2 mu |n|^2 I + lambda c c^T."""
    return _identity_and_square_2d(2.0 * law.mu * (n[0] * n[0] + n[1] * n[1]), law.lmbda, apply_2d(cofactor_2d(F), n))


@njit
def _neo_hookean_2d(F: Any, n: Any, law: Any) -> Any:
    k = max(law.lmbda, 0.5 * law.lmbda_hat)
    return _identity_and_square_2d(2.0 * law.mu * (n[0] * n[0] + n[1] * n[1]), k, apply_2d(cofactor_2d(F), n))


@njit
def _stable_neo_hookean_2d(F: Any, n: Any, law: Any) -> Any:
    k = max(law.lmbda, 0.5 * law.lmbda_corrected)
    return _identity_and_square_2d(2.0 * law.mu * (n[0] * n[0] + n[1] * n[1]), k, apply_2d(cofactor_2d(F), n))


@njit
def _logarithmic_2d(F: Any, n: Any, law: Any) -> Any:
    J = det_2d(F)
    k = max(law.lmbda, (law.mu + law.lmbda - law.lmbda * math.log(J)) / (J * J)) if J > 0.0 else law.lmbda
    return _identity_and_square_2d(2.0 * law.mu * (n[0] * n[0] + n[1] * n[1]), k, apply_2d(cofactor_2d(F), n))


@njit
def _linear_2d(F: Any, n: Any, law: Any) -> Any:
    return _identity_and_square_2d(2.0 * law.mu * (n[0] * n[0] + n[1] * n[1]), law.lmbda, n)


@njit
def _corotated_2d(F: Any, n: Any, law: Any) -> Any:
    R, strain = rotation_and_trace_2d(F)
    block = _identity_and_square_2d(2.0 * law.mu * (n[0] * n[0] + n[1] * n[1]), law.lmbda, apply_2d(R, n))
    if not strain > 0.0:
        return block
    k = law.lmbda * strain / (strain + 2.0)
    p = apply_2d(R, (-n[1], n[0]))
    return (block[0] + k * p[0] * p[0], block[1] + k * p[1] * p[1], block[2] + k * p[0] * p[1])


@njit
def _saint_venant_kirchhoff_2d(F: Any, n: Any, law: Any) -> Any:
    u = apply_2d(F, n)
    nn = n[0] * n[0] + n[1] * n[1]
    square = F[0] * F[0] + F[1] * F[1] + F[2] * F[2] + F[3] * F[3]
    w0, w1 = F[0] * u[0] + F[2] * u[1], F[1] * u[0] + F[3] * u[1]
    pull = law.mu * ((w0 * n[0] + w1 * n[1]) - nn) + 0.5 * law.lmbda * (square - 2.0) * nn
    m = law.mu * nn
    block = _identity_and_square_2d(max(pull, 0.1 * m), law.mu + law.lmbda, u)
    return (
        block[0] + m * (F[0] * F[0] + F[1] * F[1]),
        block[1] + m * (F[2] * F[2] + F[3] * F[3]),
        block[2] + m * (F[0] * F[2] + F[1] * F[3]),
    )


# ---------------------------------------------------------------------------------------- by law

_Block = Callable[..., Any]
_BLOCKS: dict[type, tuple[_Block, _Block]] = {
    NeoHookean: (_neo_hookean_2d, _neo_hookean_3d),
    StableNeoHookean: (_stable_neo_hookean_2d, _stable_neo_hookean_3d),
    LogarithmicNeoHookean: (_logarithmic_2d, _logarithmic_3d),
    Linear: (_linear_2d, _linear_3d),
    Corotated: (_corotated_2d, _corotated_3d),
    SaintVenantKirchhoff: (_saint_venant_kirchhoff_2d, _saint_venant_kirchhoff_3d),
}
_BOUNDED = (FixedCorotated, ARAP, Linear, NeoHookean, StableNeoHookean)


def is_bounded(law: Any) -> bool:
    """Whether a step with the law's block can never raise the energy, whatever the state and the other cells are."""
    return isinstance(law, _BOUNDED)


def block_function(law_class: type, dim: int) -> _Block:
    """The function of a law, the published form for a law that has none of its own."""
    functions: tuple[_Block, _Block] = _BLOCKS.get(law_class, (published_2d, published_3d))
    return functions[dim - 2]


def nodal_block(F: Any, n: Any, law: Any) -> Any:
    """The block of a cell, per volume; F and n are tuples.

    Returns
    -------
    tuple
        (00, 11, 22, 12, 02, 01), in 2D (00, 11, 01) [Pa/m^2].
    """
    return block_function(type(law), len(n))(F, n, law)


@overload(nodal_block)
def _nodal_block(F: Any, n: Any, law: Any) -> Any:
    if not isinstance(law, types.BaseNamedTuple):
        raise TypingError(f"nodal_block: the law must be a named tuple, not {law}")
    function = block_function(law.instance_class, len(n))

    def implementation(F: Any, n: Any, law: Any) -> Any:
        return function(F, n, law)

    return implementation
