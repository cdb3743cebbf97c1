"""What compiled drivers call on a law: numba picks the law's own scalar kernel at compile time.

A law is a `NamedTuple` of its parameters. numba types a named tuple by its class, so a driver that takes
``law`` as an argument is specialised, and kept on disk, per law; there is no table, pointer or branch left at
run time. The dimension follows from the length of ``F``: 9 in 3D, 4 in 2D (plane strain), row-major. Called
from Python, the same functions evaluate one ``F``.

A new law is a module with such a class and its scalar kernels, handed to `register`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self, cast

from numpy.typing import NDArray

from femdeform.jit import TypingError, extending, types


class Law(Protocol):
    """What every law offers: a named tuple that begins with the Lame parameters at rest [Pa]."""

    @property
    def mu(self) -> float:
        """Shear modulus at rest [Pa]."""
        ...

    @property
    def lmbda(self) -> float:
        """First Lame parameter at rest [Pa]."""
        ...

    @classmethod
    def from_lame(cls, mu: float, lmbda: float, dim: int) -> Self:
        """Make the law that agrees with linear elasticity (mu, lmbda) at rest, in 2D (plane strain) or 3D."""
        ...


@dataclass(frozen=True)
class Kernels:
    """Compiled scalar functions of one law in one dimension; those in stretches may be missing."""

    energy_density: Callable[..., Any]
    pk1: Callable[..., Any]
    tangent: Callable[..., Any]
    energy_from_stretches: Callable[..., Any] | None = None
    stretch_derivatives: Callable[..., Any] | None = None


_KERNELS: dict[tuple[type, int], Kernels] = {}


def register(law_class: type, dim: int, kernels: Kernels) -> None:
    """Make the kernels of a law known; done once, at the end of the law's module."""
    _KERNELS[law_class, dim] = kernels


def kernels_of(law_class: type, dim: int) -> Kernels:
    """Return the kernels of a law.

    Raises
    ------
    LookupError
        If the law has none in that dimension.
    """
    try:
        return _KERNELS[law_class, dim]
    except KeyError:
        raise LookupError(f"{law_class.__name__} has no kernels in {dim}D") from None


def _select(law_class: type, name: str, dim: int) -> Any:
    kernel = getattr(kernels_of(law_class, dim), name)
    if kernel is None:
        raise LookupError(f"{law_class.__name__} is not a function of the principal stretches: no {name}")
    return kernel


_DIM_OF_MATRIX = {4: 2, 9: 3}
_DIM_OF_STRETCHES = {2: 2, 3: 3}


def _at_compile_time(name: str, argument: Any, law: Any, dims: dict[int, int]) -> Any:
    """Return the kernel for numba's types of the arguments."""
    if not isinstance(law, types.BaseNamedTuple):
        raise TypingError(f"{name}: the law must be a named tuple, not {law}")
    if not isinstance(argument, types.BaseTuple) or len(argument) not in dims:
        raise TypingError(f"{name}: expected a tuple of {' or '.join(map(str, dims))} floats, not {argument}")
    try:
        return _select(law.instance_class, name, dims[len(argument)])
    except LookupError as error:
        raise TypingError(str(error)) from None


# ---------------------------------------------------------------------------------------- constants


def combined(first: Law, second: Law, a: float, b: float) -> Law:
    """The law whose parameters are ``a`` and ``b`` times those of two laws of one class.

    Parameters of all laws, and with them energies, are linear in the Lame parameters: with ``from_lame(1, 0, dim)`` and
    ``from_lame(0, 1, dim)`` this is the law of mu = a and lmbda = b, in compiled loops where these differ from
    point to point.
    """
    pairs = zip(cast("tuple[float, ...]", first), cast("tuple[float, ...]", second), strict=True)
    return type(first)(*(a * x + b * y for x, y in pairs))


@extending.overload(combined)
def _combined(first: Any, second: Any, a: Any, b: Any) -> Any:
    if not isinstance(first, types.BaseNamedTuple):
        raise TypingError(f"combined: laws must be named tuples, not {first}")
    law, n = first.instance_class, len(first)

    def two(first: Any, second: Any, a: Any, b: Any) -> Any:
        return law(a * first[0] + b * second[0], a * first[1] + b * second[1])

    def three(first: Any, second: Any, a: Any, b: Any) -> Any:
        return law(a * first[0] + b * second[0], a * first[1] + b * second[1], a * first[2] + b * second[2])

    def four(first: Any, second: Any, a: Any, b: Any) -> Any:
        return law(
            a * first[0] + b * second[0],
            a * first[1] + b * second[1],
            a * first[2] + b * second[2],
            a * first[3] + b * second[3],
        )

    by_length = {2: two, 3: three, 4: four}
    if n not in by_length:
        raise TypingError(f"combined: {law.__name__} has {n} parameters")
    return by_length[n]


# ---------------------------------------------------------------------------------------- energy density


def energy_density(F: Sequence[float], law: Law) -> float:
    """Return the elastic energy per reference volume [J/m^3]; 0 at F = I.

    Parameters
    ----------
    F : tuple of 9 or 4 floats
        Deformation gradient, row-major.
    law : NamedTuple
        The law with its parameters.
    """
    return cast(float, _select(type(law), "energy_density", _DIM_OF_MATRIX[len(F)])(F, law))


@extending.overload(energy_density)
def _energy_density(F: Any, law: Any) -> Any:
    kernel = _at_compile_time("energy_density", F, law, _DIM_OF_MATRIX)

    def implementation(F: Any, law: Any) -> Any:
        return kernel(F, law)

    return implementation


# ---------------------------------------------------------------------------------------- stress


def pk1(F: Sequence[float], law: Law) -> tuple[float, ...]:
    """Return the first Piola-Kirchhoff stress, dPsi/dF [Pa], as a tuple like F."""
    return cast("tuple[float, ...]", _select(type(law), "pk1", _DIM_OF_MATRIX[len(F)])(F, law))


@extending.overload(pk1)
def _pk1(F: Any, law: Any) -> Any:
    kernel = _at_compile_time("pk1", F, law, _DIM_OF_MATRIX)

    def implementation(F: Any, law: Any) -> Any:
        return kernel(F, law)

    return implementation


# ---------------------------------------------------------------------------------------- tangent


def tangent(F: Sequence[float], law: Law, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent d2Psi/dF2 [Pa] into H.

    Parameters
    ----------
    F : tuple of 9 or 4 floats
        Deformation gradient, row-major.
    law : NamedTuple
        The law with its parameters.
    project : bool
        Write the closest positive semi-definite matrix instead: negative eigenvalues become 0.
    H : (9, 9) or (4, 4) array
        Overwritten; row and column 3 a + b (2 a + b in 2D) belong to F_ab.
    """
    _select(type(law), "tangent", _DIM_OF_MATRIX[len(F)])(F, law, project, H)


@extending.overload(tangent)
def _tangent(F: Any, law: Any, project: Any, H: Any) -> Any:
    kernel = _at_compile_time("tangent", F, law, _DIM_OF_MATRIX)

    def implementation(F: Any, law: Any, project: Any, H: Any) -> Any:
        kernel(F, law, project, H)

    return implementation


# ---------------------------------------------------------------------------------------- in stretches


def energy_from_stretches(s: Sequence[float], law: Law) -> float:
    """Return the energy density of diag(s) [J/m^3]; s are signed principal stretches in any order.

    Membranes call it with ``(s0, s1, 1)``, rods with ``(s0, 1, 1)``: the three-dimensional law with the
    thickness kept.
    """
    return cast(float, _select(type(law), "energy_from_stretches", _DIM_OF_STRETCHES[len(s)])(s, law))


@extending.overload(energy_from_stretches)
def _energy_from_stretches(s: Any, law: Any) -> Any:
    kernel = _at_compile_time("energy_from_stretches", s, law, _DIM_OF_STRETCHES)

    def implementation(s: Any, law: Any) -> Any:
        return kernel(s, law)

    return implementation


def stretch_derivatives(s: Sequence[float], law: Law) -> Any:
    """Return (gradient, hessian, twist, flip), free of divisions by s_i - s_j: all a tangent is made of.

    Parameters
    ----------
    s : tuple of 3 or 2 floats
        Signed principal stretches.
    law : NamedTuple
        The law with its parameters.

    Returns
    -------
    gradient : tuple of 3 or 2 floats
        psi_i = dPsi/ds_i [Pa].
    hessian : tuple of 6 or 3 floats
        A_ij = d2Psi/ds_i ds_j as ``(A00, A11, A22, A12, A02, A01)``; in 2D ``(A00, A11, A01)`` [Pa].
    twist : tuple of 3 or 1 floats
        (psi_i + psi_j) / (s_i + s_j) for the pairs (1, 2), (2, 0), (0, 1); in 2D for (0, 1) [Pa].
    flip : tuple of 3 or 1 floats
        (psi_i - psi_j) / (s_i - s_j) for the same pairs [Pa].
    """
    return _select(type(law), "stretch_derivatives", _DIM_OF_STRETCHES[len(s)])(s, law)


@extending.overload(stretch_derivatives)
def _stretch_derivatives(s: Any, law: Any) -> Any:
    kernel = _at_compile_time("stretch_derivatives", s, law, _DIM_OF_STRETCHES)

    def implementation(s: Any, law: Any) -> Any:
        return kernel(s, law)

    return implementation
