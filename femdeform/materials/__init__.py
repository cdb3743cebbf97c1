"""Constitutive laws: from the material block of a scene to the parameters compiled kernels work with.

Importing this package does not import numba; `law_for` does, with the module of the law asked for. Parts:

- `femdeform.materials.dispatch`: ``energy_density``, ``pk1``, ``tangent`` ... of one F, for compiled code.
- `femdeform.materials.batch`: the same for arrays of F.
- one module per law, with its formulas, sources and limitations; `femdeform.materials.small_matrix`.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol, cast

from femdeform.errors import InputError

if TYPE_CHECKING:
    from femdeform.materials.dispatch import Law

# The word of the scene -> "module:class".
LAWS = {
    "linear": "femdeform.materials.linear:Linear",
    "saint_venant_kirchhoff": "femdeform.materials.saint_venant_kirchhoff:SaintVenantKirchhoff",
    "arap": "femdeform.materials.arap:ARAP",
    "corotated": "femdeform.materials.corotated:Corotated",
    "fixed_corotated": "femdeform.materials.fixed_corotated:FixedCorotated",
    "neo_hookean": "femdeform.materials.neo_hookean:NeoHookean",
    "stable_neo_hookean": "femdeform.materials.stable_neo_hookean:StableNeoHookean",
    "logarithmic_neo_hookean": "femdeform.materials.logarithmic_neo_hookean:LogarithmicNeoHookean",
}


class MaterialModel(Protocol):
    """The material block of a scene, as far as the law needs it."""

    @property
    def law(self) -> str:
        """Key of `LAWS`."""
        ...

    @property
    def youngs_modulus(self) -> float:
        """Young's modulus at small strain [Pa]."""
        ...

    @property
    def poisson_ratio(self) -> float:
        """Poisson's ratio at small strain [-]."""
        ...


def lame_parameters(youngs_modulus: float, poisson_ratio: float) -> tuple[float, float]:
    """Return (mu, lmbda) [Pa] of three-dimensional linear elasticity; plane strain uses the same.

    Raises
    ------
    InputError
        Unless ``youngs_modulus`` is positive and finite and -1 < ``poisson_ratio`` < 0.5.
    """
    E, nu = float(youngs_modulus), float(poisson_ratio)
    if not (E > 0.0 and math.isfinite(E)):
        raise InputError(f"youngs_modulus: must be positive and finite, got {E!r}")
    if not -1.0 < nu < 0.5:
        raise InputError(f"poisson_ratio: must lie between -1 and 0.5, both excluded, got {nu!r}")
    return E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def law_class(word: str) -> type[Law]:
    """Return the class behind a law's word in the scene.

    Raises
    ------
    InputError
        If there is no such law.
    """
    if word not in LAWS:
        raise InputError(f"law: there is no {word!r}; known are {', '.join(sorted(LAWS))}")
    module, _, name = LAWS[word].partition(":")
    return cast("type[Law]", getattr(import_module(module), name))


def law_for(material: MaterialModel, dim: int) -> Law:
    """Return the law of a material block, with its constants computed.

    Parameters
    ----------
    material : MaterialModel
        A material of `femdeform.scene.schema`, or anything with the same three attributes.
    dim : int
        3, or 2 for plane strain. Membranes and rods use the three-dimensional law whatever the space they
        live in.

    Returns
    -------
    NamedTuple
        The law; the first two fields are ``mu`` and ``lmbda`` [Pa].

    Raises
    ------
    InputError
        For an unknown law, or moduli outside their bounds.
    ValueError
        If ``dim`` is neither 2 nor 3.
    """
    if dim not in (2, 3):
        raise ValueError(f"dim must be 2 or 3, got {dim}")
    mu, lmbda = lame_parameters(material.youngs_modulus, material.poisson_ratio)
    return law_class(material.law).from_lame(mu, lmbda, dim)


def supports_codimension(law: Law) -> bool:
    """Tell whether a law can serve membranes and rods: whether it is one of the principal stretches."""
    from femdeform.materials.dispatch import kernels_of

    return kernels_of(type(law), 3).energy_from_stretches is not None


def with_precision(law: Law, dtype: Any) -> Law:
    """Return the law with its parameters in another floating-point type, for example ``numpy.float32``."""
    import numpy as np

    scalar = np.dtype(dtype).type
    return type(law)(*(scalar(value) for value in cast("tuple[float, ...]", law)))
