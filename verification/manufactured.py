"""Manufactured solutions: from a displacement and a law to the body force that keeps it in equilibrium.

The energy density is written down here once more, in sympy, and differentiated by it: stress and tangent share
nothing with the compiled laws they are to judge. With u(X) given, F = I + grad u and

    b_i = -dP_iJ/dX_J = -(d2Psi / dF_iJ dF_kL) d2u_k / dX_L dX_J.

ARAP and the corotated laws depend on t = tr S = s1 + s2 (+ s3), S of the polar decomposition F = R S. No singular
value is computed: t is the largest root of a polynomial whose coefficients are those of F,

    2D:  t^2 = |F|^2 + 2 J
    3D:  (t^2 - |F|^2)^2 = 4 (|cof F|^2 + 2 J t)

(in 3D, t^2 - |F|^2 = 2 (s1 s2 + s2 s3 + s3 s1), the square of that sum is |cof F|^2 + 2 J t, and |cof F|^2, the sum
of the squared minors, is (|F|^4 - |F^T F|^2) / 2). Derivatives of t follow from the implicit function theorem.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from femdeform.materials import lame_parameters
from femdeform.types import FloatArray


def coordinates(dim: int) -> tuple[Any, ...]:
    """Symbols x, y (and z) in which a displacement is to be written [m]."""
    import sympy

    return tuple(sympy.symbols("x y z", real=True)[:dim])


def symbolic_energy(law: str, F: Any, trace: Any, mu: Any, lmbda: Any) -> Any:
    """Energy density of a law, up to a constant.

    Parameters
    ----------
    law : str
        Word of the law in a scene.
    F : sympy Matrix
        Deformation gradient, 2x2 (plane strain) or 3x3.
    trace : sympy expression
        tr S of the polar decomposition F = R S, see `trace_equation`.
    mu, lmbda : sympy expression or float
        Lame parameters at rest [Pa].

    Returns
    -------
    sympy expression
        [J/m^3]

    Raises
    ------
    ValueError
        If there is no such law.
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
        # Lame correction of docs/methods/materials.md; the rest state is free of stress for this alpha.
        shear = mu * sympy.Rational(d + 1, d)
        volume = lmbda + (sympy.Rational(5, 6) if d == 3 else sympy.Rational(2, 3)) * mu
        alpha = 1 + shear * sympy.Rational(d, d + 1) / volume
        return shear / 2 * (square - sympy.log(square + 1)) + volume / 2 * (J - alpha) ** 2
    distance = square - 2 * trace + d  # |F - R|^2 = |S - I|^2
    if law == "arap":
        return mu * distance
    if law == "corotated":
        return mu * distance + lmbda / 2 * (trace - d) ** 2
    if law == "fixed_corotated":
        return mu * distance + lmbda / 2 * (J - 1) ** 2
    raise ValueError(f"no manufactured solution for the law {law}")


def trace_equation(F: Any, trace: Any) -> Any:
    """Polynomial in `trace` whose largest root is tr S, see the text at the top of this module."""
    square, J = sum(entry**2 for entry in F), F.det()
    if F.rows == 2:
        return trace**2 - square - 2 * J
    minors = (square**2 - sum(entry**2 for entry in F.T * F)) / 2
    return (trace**2 - square) ** 2 - 4 * (minors + 2 * J * trace)


@lru_cache(maxsize=32)
def _derivatives(law: str, dim: int) -> tuple[Callable[..., Any], bool]:
    """Numpy function (mu, lmbda, tr S, F_00, F_01, ...) -> list of stresses, then of tangents, row-major.

    The second value tells whether they depend on tr S.
    """
    import sympy

    n = dim * dim
    symbols = sympy.symbols(f"F:{n}", real=True)
    trace, mu, lmbda = sympy.symbols("t mu lmbda", positive=True)
    F = sympy.Matrix(dim, dim, symbols)
    energy = symbolic_energy(law, F, trace, mu, lmbda)
    equation = trace_equation(F, trace)
    slope = sympy.diff(equation, trace)
    of_trace = [-sympy.diff(equation, f) / slope for f in symbols]

    def total(expression: Any, k: int) -> Any:
        return sympy.diff(expression, symbols[k]) + sympy.diff(expression, trace) * of_trace[k]

    stress = [total(energy, k) for k in range(n)]
    upper = {(i, j): total(stress[i], j) for i in range(n) for j in range(i, n)}
    tangent = [upper[min(i, j), max(i, j)] for i in range(n) for j in range(n)]
    function: Callable[..., Any] = sympy.lambdify((mu, lmbda, trace, *symbols), stress + tangent, "numpy", cse=True)
    return function, bool(energy.has(trace))


def polar_trace(F: FloatArray) -> FloatArray:
    """Trace of the stretch S of F = R S, by Newton's method for the largest root of `trace_equation`.

    Parameters
    ----------
    F : (n, dim, dim) float64
        Deformation gradients [-].

    Returns
    -------
    (n,) float64
        s1 + s2 (+ s3), the last one with the sign of det F [-].

    Raises
    ------
    ValueError
        Where the rotation is not unique: two singular values that cancel, after an inversion.
    """
    d = F.shape[1]
    square, J = np.einsum("nij,nij->n", F, F), np.linalg.det(F)
    # All roots are real (s1 + s2 + s3 with an even number of signs changed): from their upper bound Newton falls
    # to the largest one without passing it.
    t = np.sqrt(d * square)
    C = np.einsum("nki,nkj->nij", F, F)
    minors = 0.5 * (square**2 - np.einsum("nij,nij->n", C, C))
    for _ in range(100):
        if d == 2:
            value, slope = t**2 - square - 2.0 * J, 2.0 * t
        else:
            excess = t**2 - square
            value, slope = excess**2 - 4.0 * (minors + 2.0 * J * t), 4.0 * t * excess - 8.0 * J
        if np.any(slope <= 1e-6 * np.sqrt(square) ** (2 * d - 3)):  # a double root, as far as rounding can tell
            break
        step = value / slope
        t = t - step
        if np.all(np.abs(step) <= 1e-14 * t):
            return np.asarray(t)
    raise ValueError("the polar decomposition is not unique at some point: the displacement inverts the body")


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
        If there is no such law.

    References
    ----------
    P. J. Roache, Code verification by the method of manufactured solutions, Journal of Fluids Engineering 124 (2002).

    Limitations
    -----------
    For ARAP and the corotated laws the displacement may not invert the body so far that its rotation is not unique.
    """

    def __init__(self, law: str, youngs_modulus: float, poisson_ratio: float, displacement: Sequence[Any]) -> None:
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
        self._law, self._polar = _derivatives(law, self.dim)

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
        trace = polar_trace(F) if self._polar else 0.0
        values = self._law(self.mu, self.lmbda, trace, *F.reshape(n, d * d).T)
        return _stack(values[: d * d], n, (d, d)), _stack(values[d * d :], n, (d, d, d, d))
