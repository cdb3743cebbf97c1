"""Rings under inner pressure in plane strain: Lame's solution, and any law at finite strain.

At finite strain r(R) obeys P_r' = (P_t - P_r) / R with P = dPsi/d(stretch) at the stretches r' and r / R, P_r = -p
r / R at the inner radius (pressure acts on the deformed surface) and 0 at the outer one. The two-point problem is
solved by collocation to a tolerance far below that of any mesh; Psi is the one of `verification.manufactured`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from femdeform.errors import InputError
from femdeform.materials import lame_parameters
from femdeform.scene import schema
from femdeform.scene.mesh_schema import RingMesh
from femdeform.types import FloatArray
from verification.analytic.facts import only_body, only_condition, only_material
from verification.manufactured import symbolic_energy

_TOLERANCE = 1e-9


def lame_ring_displacement(
    youngs_modulus: float, poisson_ratio: float, inner: float, outer: float, pressure: float, radius: float
) -> float:
    """Radial displacement of a ring in plane strain under inner pressure, at small strain [m].

    Parameters
    ----------
    youngs_modulus : float
        [Pa]
    poisson_ratio : float
        [-]
    inner, outer : float
        Radii of the ring [m].
    pressure : float
        On the inner surface [Pa].
    radius : float
        Where [m].

    References
    ----------
    G. Lame and B. P. E. Clapeyron, Memoire sur l'equilibre interieur des corps solides homogenes (1833). S. P.
    Timoshenko and J. N. Goodier, Theory of Elasticity, section 28.
    """
    E, nu = youngs_modulus, poisson_ratio
    scale = (1.0 + nu) / E * pressure * inner**2 / (outer**2 - inner**2)
    return scale * ((1.0 - 2.0 * nu) * radius + outer**2 / radius)


def lame_ring_moment(inner: float, outer: float, pressure: float) -> float:
    """Moment of the hoop stress over a radial cut about the centre, per thickness [N].

    The integral of r p a^2 / (b^2 - a^2) (1 + b^2 / r^2) from a to b.
    """
    a, b = inner, outer
    return float(pressure * a**2 * (0.5 + b**2 / (b**2 - a**2) * np.log(b / a)))


@lru_cache(maxsize=16)
def _principal(law: str) -> Callable[..., Any]:
    """Numpy function (mu, lmbda, a, b) -> P_a, P_b, d2Psi/da2, d2Psi/dadb at the stretches a and b."""
    import sympy

    mu, lmbda, a, b = sympy.symbols("mu lmbda a b", positive=True)
    energy = symbolic_energy(law, sympy.diag(a, b), a + b, mu, lmbda)
    wanted = [sympy.diff(energy, *by) for by in ((a,), (b,), (a, a), (a, b))]
    function: Callable[..., Any] = sympy.lambdify((mu, lmbda, a, b), wanted, "numpy", cse=True)
    return function


def inflated_ring(
    law: str, youngs_modulus: float, poisson_ratio: float, inner: float, outer: float, pressure: float
) -> Callable[[FloatArray], FloatArray]:
    """Deformed radius over reference radius [m] of a ring in plane strain under inner pressure, for any law.

    Parameters
    ----------
    law : str
        Word of the law in a scene.
    youngs_modulus, poisson_ratio, inner, outer, pressure : float
        See `lame_ring_displacement`.

    Returns
    -------
    callable
        r(R) [m].

    Raises
    ------
    InputError
        If the ring bursts below this pressure: no equilibrium is found.
    """
    from scipy.integrate import solve_bvp

    mu, lmbda = lame_parameters(youngs_modulus, poisson_ratio)
    of_stretches = _principal(law)

    def rates(R: FloatArray, y: FloatArray) -> FloatArray:
        hoop = y[0] / R
        P_r, P_t, stiffness, coupling = of_stretches(mu, lmbda, y[1], hoop)
        return np.vstack([y[1], ((P_t - P_r) / R - coupling * (y[1] - hoop) / R) / stiffness])

    R = np.linspace(inner, outer, 41)
    y = np.vstack([R, np.ones_like(R)])
    solution: Any = None
    for fraction in np.linspace(0.1, 1.0, 10):

        def ends(at_inner: FloatArray, at_outer: FloatArray, load: float = fraction * pressure) -> FloatArray:
            hoop = at_inner[0] / inner
            stress = of_stretches(mu, lmbda, at_inner[1], hoop)[0]
            free = of_stretches(mu, lmbda, at_outer[1], at_outer[0] / outer)[0]
            return np.array([stress + load * hoop, free]) / mu

        solution = solve_bvp(rates, ends, R, y, tol=_TOLERANCE, max_nodes=20000)
        if not solution.success or not np.all(solution.y[1] > 0.0):
            raise InputError(f"a ring of {law} has no equilibrium under {fraction * pressure:g} Pa that can be found")
        R, y = solution.x, solution.y
    shape: Callable[[FloatArray], FloatArray] = solution.sol
    return lambda radius: np.asarray(shape(radius)[0])


# ------------------------------------------------------------------------------------------------------ of scenes


def _ring(scene: schema.DeformableScene) -> tuple[float, float, float]:
    """Inner radius, outer radius [m], pressure on the inner side at the end [Pa]."""
    mesh, load = only_body(scene).mesh, only_condition(scene, "pressure")
    if not isinstance(mesh, RingMesh) or load.amplitude is not None:
        raise InputError("bodies: this formula needs the recipe `ring` under a pressure without amplitude")
    return mesh.inner_radius, mesh.outer_radius, load.value


def lame_displacement(scene: schema.DeformableScene, radius: float) -> float:
    """Radial displacement at a radius, at small strain [m]."""
    material = only_material(scene)
    return lame_ring_displacement(material.youngs_modulus, material.poisson_ratio, *_ring(scene), radius)


def lame_hoop_moment(scene: schema.DeformableScene) -> float:
    """Moment about the centre of the forces that hold the cut on the x axis, downward, at small strain [N]."""
    return -lame_ring_moment(*_ring(scene))


@lru_cache(maxsize=64)
def _inflated(*arguments: Any) -> Callable[[FloatArray], FloatArray]:
    return inflated_ring(*arguments)


def ring_displacement(scene: schema.DeformableScene, radius: float) -> float:
    """Radial displacement at a radius, at finite strain [m]."""
    material = only_material(scene)
    shape = _inflated(material.law, material.youngs_modulus, material.poisson_ratio, *_ring(scene))
    return float(shape(np.array([radius]))[0]) - radius
