"""Manufactured solutions: from a displacement and a law to the body force that keeps it in equilibrium.

The energy density is written down here once more, in sympy, and differentiated by it: stress and tangent share
nothing with the compiled laws they are to judge. With u(X) given, F = I + grad u and

    b_i = -dP_iJ/dX_J = -(d2Psi / dF_iJ dF_kL) d2u_k / dX_L dX_J.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from femdeform.materials import lame_parameters
from femdeform.types import FloatArray

# Laws of the polar decomposition have an energy in closed form in two dimensions only, where tr S = sqrt(|F|^2 + 2 J).
_POLAR = frozenset({"arap", "corotated", "fixed_corotated"})


def coordinates(dim: int) -> tuple[Any, ...]:
    """Symbols x, y (and z) in which a displacement is to be written [m]."""
    import sympy

    return tuple(sympy.symbols("x y z", real=True)[:dim])


def symbolic_energy(law: str, F: Any, mu: Any, lmbda: Any) -> Any:
    """Energy density of a law, up to a constant.

    Parameters
    ----------
    law : str
        Word of the law in a scene.
    F : sympy Matrix
        Deformation gradient, 2x2 (plane strain) or 3x3.
    mu, lmbda : sympy expression or float
        Lame parameters at rest [Pa].

    Returns
    -------
    sympy expression
        [J/m^3]

    Raises
    ------
    ValueError
        If the law has no closed form in this dimension.
    """
    import sympy

    d = F.rows
    J, square = F.det(), sum(entry**2 for entry in F)
    if law == "linear":
        strain = (F + F.T) / 2 - sympy.eye(d)
        return mu * sum(entry**2 for entry in strain) + lmbda / 2 * strain.trace() ** 2
    if law == "saint_venant_kirchhoff":
        strain = (F.T * F - sympy.eye(d)) / 2
        return mu * sum(entry**2 for entry in strain) + lmbda / 2 * strain.trace() ** 2
    if law == "neo_hookean":
        stiff = lmbda + mu
        return mu / 2 * square + stiff / 2 * (J - 1 - mu / stiff) ** 2
    if law == "logarithmic_neo_hookean":
        return mu / 2 * square - mu * sympy.log(J) + lmbda / 2 * sympy.log(J) ** 2
    if law == "stable_neo_hookean":
        # Lame correction of methods.md, section 1; the rest state is free of stress for this alpha.
        shear = mu * sympy.Rational(d + 1, d)
        volume = lmbda + (sympy.Rational(5, 6) if d == 3 else sympy.Rational(2, 3)) * mu
        alpha = 1 + shear * sympy.Rational(d, d + 1) / volume
        return shear / 2 * (square - sympy.log(square + 1)) + volume / 2 * (J - alpha) ** 2
    if law in _POLAR and d == 2:
        trace = sympy.sqrt(square + 2 * J)  # tr S = |s1 + s2|
        distance = square - 2 * trace + 2  # |F - R|^2
        volumetric = {"arap": 0, "corotated": (trace - 2) ** 2, "fixed_corotated": (J - 1) ** 2}[law]
        return mu * distance + lmbda / 2 * volumetric
    raise ValueError(f"no closed form of {law} in {d} dimensions")


@lru_cache(maxsize=32)
def _derivatives(law: str, dim: int) -> Callable[..., Any]:
    """Numpy function (mu, lmbda, F_00, F_01, ...) -> list of stresses, then of tangents, row-major."""
    import sympy

    symbols = sympy.symbols(f"F:{dim * dim}", real=True)
    mu, lmbda = sympy.symbols("mu lmbda", positive=True)
    energy = symbolic_energy(law, sympy.Matrix(dim, dim, symbols), mu, lmbda)
    stress = [sympy.diff(energy, f) for f in symbols]
    upper = {(i, j): sympy.diff(stress[i], symbols[j]) for i in range(dim * dim) for j in range(i, dim * dim)}
    tangent = [upper[min(i, j), max(i, j)] for i in range(dim * dim) for j in range(dim * dim)]
    function: Callable[..., Any] = sympy.lambdify((mu, lmbda, *symbols), stress + tangent, "numpy", cse=True)
    return function


def _stack(values: Sequence[Any], n: int, shape: tuple[int, ...]) -> FloatArray:
    """Columns, some of them constants, to an array (n, *shape)."""
    columns = [np.broadcast_to(np.asarray(value, dtype=np.float64), (n,)) for value in values]
    return np.stack(columns, axis=1).reshape(n, *shape)


class ManufacturedSolution:
    """A displacement that a body with a given law and body force takes on.

    Parameters
    ----------
    law : str
        Word of the law in a scene.
    youngs_modulus : float
        [Pa]
    poisson_ratio : float
        [-]
    displacement : sequence of sympy expression
        One for each component, in the symbols of `coordinates` [m].

    Raises
    ------
    ValueError
        If the law has no closed form in this dimension.

    References
    ----------
    P. J. Roache, Code verification by the method of manufactured solutions, Journal of Fluids Engineering 124 (2002).

    Limitations
    -----------
    ARAP and the corotated laws in two dimensions only.
    """

    def __init__(
        self, law: str, youngs_modulus: float, poisson_ratio: float, displacement: Sequence[Any]
    ) -> None:
        import sympy

        self.law = law
        self.dim = len(displacement)
        self.mu, self.lmbda = lame_parameters(youngs_modulus, poisson_ratio)
        X = coordinates(self.dim)
        gradient = [sympy.diff(u, x) for u in displacement for x in X]
        second = [sympy.diff(g, x) for g in gradient for x in X]
        self._u = sympy.lambdify(X, list(displacement), "numpy")
        self._gradient = sympy.lambdify(X, gradient, "numpy", cse=True)
        self._second = sympy.lambdify(X, second, "numpy", cse=True)
        self._law = _derivatives(law, self.dim)

    def displacement(self, points: FloatArray) -> FloatArray:
        """Displacement (n, dim) at points (n, dim) [m]."""
        return _stack(self._u(*points.T), len(points), (self.dim,))

    def gradient(self, points: FloatArray) -> FloatArray:
        """Displacement gradient ``du_i/dX_j`` at points, (n, dim, dim) [-]."""
        return _stack(self._gradient(*points.T), len(points), (self.dim, self.dim))

    def pk1(self, points: FloatArray) -> FloatArray:
        """First Piola-Kirchhoff stress at points, (n, dim, dim) [Pa]."""
        return self._evaluate(points)[0]

    def body_force(self, points: FloatArray) -> FloatArray:
        """Force per reference volume that balances the stress, (n, dim) [N/m^3]."""
        d = self.dim
        tangent = self._evaluate(points)[1]
        second = _stack(self._second(*points.T), len(points), (d, d, d))
        return -np.asarray(np.einsum("niJkL,nkLJ->ni", tangent, second, optimize=True))

    def traction(self, points: FloatArray, normal: FloatArray) -> FloatArray:
        """Force per reference area P N on a surface with unit normals (n, dim), (n, dim) [Pa]."""
        return np.asarray(np.einsum("nij,nj->ni", self.pk1(points), normal))

    def _evaluate(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        d, n = self.dim, len(points)
        F = self.gradient(points) + np.eye(d)
        values = self._law(self.mu, self.lmbda, *F.reshape(n, d * d).T)
        return _stack(values[: d * d], n, (d, d)), _stack(values[d * d :], n, (d, d, d, d))
