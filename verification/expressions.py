"""Expressions of study files, such as ``a*sin(pi*x)``: parsed without ever running text as code.

Python's parser gives the tree; only arithmetic, known functions and known names are taken from it, everything else is
refused with a sentence.
"""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from femdeform.scene.wording import did_you_mean
from femdeform.types import FloatArray

COORDINATES = ("x", "y", "z")
FUNCTIONS = (
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "abs"
)  # fmt: skip
NUMBERS = ("pi", "e")
RESERVED = frozenset({*COORDINATES, *FUNCTIONS, *NUMBERS})

_MAX_LENGTH = 500
# Whole numbers are exact in sympy: without a bound 9**9**9 would never end.
_MAX_EXPONENT = 64
_MAX_DIGITS = 20
_MAX_BITS = 4096
_SYMPY_NAMES = {"abs": "Abs"}


class ExpressionError(ValueError):
    """Text is not an expression; the message is a sentence about it."""


def parse_expression(given: float | str, constants: Mapping[str, float], coordinates: Iterable[str] = ()) -> Any:
    """Turn a number or text into a sympy expression.

    Parameters
    ----------
    given : float or str
        As a study file holds it.
    constants : mapping of str to float
        Names that stand for numbers.
    coordinates : iterable of str
        Names out of x, y, z that stay symbols.

    Returns
    -------
    sympy expression
        In the symbols of `verification.manufactured.coordinates`.

    Raises
    ------
    ExpressionError
        If the text is none, or holds anything but arithmetic of known names.
    """
    import sympy

    if not isinstance(given, str):
        return sympy.Float(given) if isinstance(given, float) else sympy.Integer(given)
    if len(given) > _MAX_LENGTH:
        raise ExpressionError(f"is longer than {_MAX_LENGTH} characters")
    names = {name: sympy.Symbol(name, real=True) for name in coordinates}
    names |= {name: sympy.Float(value) for name, value in constants.items()}
    names |= {"pi": sympy.pi, "e": sympy.E}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what Python finds odd about the text
            tree = ast.parse(given.strip(), mode="eval")
        value = _Translation(names).of(tree.body)
    except (SyntaxError, ValueError, MemoryError, RecursionError, OverflowError, ZeroDivisionError) as error:
        if isinstance(error, ExpressionError):
            raise
        raise ExpressionError(f"{_short(given)} is not an expression such as 2*a*sin(pi*x)") from None
    if value.has(sympy.zoo, sympy.nan, sympy.oo, -sympy.oo, sympy.I):
        raise ExpressionError(f"{_short(given)} is not a finite number")
    return value


def evaluate(given: float | str, constants: Mapping[str, float]) -> float:
    """Value of a number or of an expression of constants.

    Raises
    ------
    ExpressionError
        If it is none, or not finite.
    """
    if not isinstance(given, str):
        return float(given)
    try:
        value = float(parse_expression(given, constants))
    except (TypeError, OverflowError):
        value = np.nan
    if not np.isfinite(value):
        raise ExpressionError(f"{_short(given)} is not a finite number")
    return value


class VectorField:
    """A vector of expressions in the coordinates, as a function of points.

    Parameters
    ----------
    components : sequence of float or str
        One for each dimension.
    constants : mapping of str to float
        Names that stand for numbers.

    Attributes
    ----------
    components : list of sympy expression
    dim : int

    Raises
    ------
    ExpressionError
        See `parse_expression`.
    """

    def __init__(self, components: Sequence[float | str], constants: Mapping[str, float]) -> None:
        self.dim = len(components)
        names = COORDINATES[: self.dim]
        self.components = [parse_expression(component, constants, names) for component in components]

    @cached_property
    def _functions(self) -> tuple[Any, Any]:
        """Values and gradients as functions of the coordinates; made when first asked for, which takes its time."""
        import sympy

        X = [sympy.Symbol(name, real=True) for name in COORDINATES[: self.dim]]
        gradient = [sympy.diff(u, x) for u in self.components for x in X]
        value = sympy.lambdify(X, self.components, "numpy", cse=True)
        return value, sympy.lambdify(X, gradient, "numpy", cse=True)

    def __call__(self, points: FloatArray) -> FloatArray:
        """Values (n, dim) at points (n, dim)."""
        return self._columns(self._functions[0], points).T.copy()

    def gradient(self, points: FloatArray) -> FloatArray:
        """Derivatives ``du_i/dX_j`` at points (n, dim), (n, dim, dim)."""
        columns = self._columns(self._functions[1], points)
        return columns.T.reshape(len(points), self.dim, self.dim).copy()

    def _columns(self, function: Any, points: FloatArray) -> FloatArray:
        with np.errstate(all="ignore"):  # the caller judges what is not finite
            values = function(*points.T)
        return np.stack([np.broadcast_to(np.asarray(value, dtype=np.float64), (len(points),)) for value in values])


class _Translation:
    """Walks Python's syntax tree and builds the sympy expression."""

    def __init__(self, names: Mapping[str, Any]) -> None:
        self._names = names

    def of(self, node: ast.AST) -> Any:
        if isinstance(node, ast.Constant):
            return self._number(node.value)
        if isinstance(node, ast.Name):
            return self._name(node.id)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.UAdd | ast.USub):
            value = self.of(node.operand)
            return -value if isinstance(node.op, ast.USub) else value
        if isinstance(node, ast.BinOp):
            return self._operation(node)
        if isinstance(node, ast.Call):
            return self._call(node)
        raise ExpressionError("may hold only numbers, names, + - * / **, parentheses and functions")

    def _number(self, value: Any) -> Any:
        import sympy

        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ExpressionError("may hold only numbers and names")
        if isinstance(value, float):
            return sympy.Float(value)
        if abs(value) >= 10**_MAX_DIGITS:
            raise ExpressionError(f"holds a number of more than {_MAX_DIGITS} digits")
        return sympy.Integer(value)

    def _name(self, name: str) -> Any:
        if name in self._names:
            return self._names[name]
        if name in FUNCTIONS:
            raise ExpressionError(f"the function `{name}` needs its argument in parentheses")
        raise ExpressionError(f"`{name[:40]}` is not known here; {did_you_mean(name, self._names)}")

    def _operation(self, node: ast.BinOp) -> Any:
        left, right = self.of(node.left), self.of(node.right)
        if isinstance(node.op, ast.Add):
            return left + right
        if isinstance(node.op, ast.Sub):
            return left - right
        if isinstance(node.op, ast.Mult):
            return left * right
        if isinstance(node.op, ast.Div):
            return left / right
        if isinstance(node.op, ast.Pow):
            if right.is_number and not abs(float(right)) <= _MAX_EXPONENT:
                raise ExpressionError(f"holds an exponent beyond {_MAX_EXPONENT}")
            if left.is_Rational and right.is_number:
                bits = math.log2(max(abs(int(left.p)), abs(int(left.q)), 1)) * abs(float(right))
                if bits > _MAX_BITS:
                    raise ExpressionError("holds a power that is too large")
            return left**right
        raise ExpressionError("a power is written **, not ^" if isinstance(node.op, ast.BitXor) else "knows + - * / **")

    def _call(self, node: ast.Call) -> Any:
        import sympy

        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name not in FUNCTIONS:
            raise ExpressionError(f"`{name[:40] or '...'}` is not a known function; {did_you_mean(name, FUNCTIONS)}")
        n_arguments = 2 if name == "atan2" else 1
        if len(node.args) != n_arguments or node.keywords or any(isinstance(a, ast.Starred) for a in node.args):
            raise ExpressionError(f"`{name}` takes {n_arguments} argument{'s' if n_arguments > 1 else ''}")
        return getattr(sympy, _SYMPY_NAMES.get(name, name))(*map(self.of, node.args))


def _short(text: str) -> str:
    from femdeform.scene.key_path import quoted

    return quoted(text)
