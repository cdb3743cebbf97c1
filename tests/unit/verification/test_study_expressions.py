"""Expressions of study files: what they mean, and that nothing else gets through."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from verification.expressions import ExpressionError, VectorField, evaluate, parse_expression


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1/3", 1.0 / 3.0),
        ("2*a + 1", 1.2),
        ("-a**2", -0.01),
        ("sqrt(2)*cos(pi)", -math.sqrt(2.0)),
        ("atan2(1, -1)", 0.75 * math.pi),
        ("log(e)", 1.0),
        ("abs(-3) + exp(0)", 4.0),
        (7, 7.0),
        (2.5, 2.5),
        ("1.0e-3", 1e-3),
    ],
)
def test_values(text: float | str, value: float) -> None:
    assert evaluate(text, {"a": 0.1}) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not an expression"),
        ("2 a", "is not an expression"),
        ("((((" * 60, "is not an expression"),
        ("b", "`b` is not known here"),
        ("x", "`x` is not known here"),
        ("sine(1)", "did you mean `sin`"),
        ("sin", "needs its argument"),
        ("sin(1, 2)", "takes 1 argument"),
        ("atan2(1)", "takes 2 arguments"),
        ("a^2", r"written \*\*"),
        ("a // 2", r"knows \+ - \* /"),
        ("1/0", "not a finite number"),
        ("log(0)", "not a finite number"),
        ("sqrt(-1)", "not a finite number"),
        ("1e999", "not a finite number"),
        ("exp(exp(exp(10)))", "not a finite number"),
        ("9**9**9", "exponent beyond"),
        ("((9**64)**64)**64", "too large"),
        ("1" * 40, "more than 20 digits"),
        ("1+" * 400 + "1", "longer than"),
        ("'a'", "numbers and names"),
        ("True", "numbers and names"),
        ("1j", "numbers and names"),
        ("[1]", "may hold only"),
        ("a if a else 1", "may hold only"),
        ("a.real", "may hold only"),
        ("(lambda: 1)()", "not a known function"),
        ("__import__('os').system('true')", "not a known function"),
        ("exec('1')", "not a known function"),
        ("sin(*[1])", "takes 1 argument"),
        ("\x00", "is not an expression"),
    ],
)
def test_what_is_no_expression_is_refused_with_a_sentence(text: str, message: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ExpressionError, match=message):
            evaluate(text, {"a": 0.1})


def test_coordinates_are_those_of_the_dimension() -> None:
    parse_expression("x*y", {}, ("x", "y"))
    with pytest.raises(ExpressionError, match="`z` is not known"):
        parse_expression("z", {}, ("x", "y"))


def test_a_field_and_its_gradient() -> None:
    field = VectorField(["a*x**2*y", 3], {"a": 0.5})
    points = np.array([[1.0, 2.0], [0.5, -1.0], [0.0, 3.0]])
    x, y = points.T
    np.testing.assert_allclose(field(points), np.stack([0.5 * x**2 * y, np.full(3, 3.0)], axis=1), rtol=1e-15)
    gradient = field.gradient(points)
    assert gradient.shape == (3, 2, 2)
    np.testing.assert_allclose(gradient[:, 0], np.stack([x * y, 0.5 * x**2], axis=1), rtol=1e-15)
    np.testing.assert_array_equal(gradient[:, 1], 0.0)


def test_a_singular_field_is_evaluated_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not np.isfinite(VectorField(["1/x", "0"], {})(np.zeros((1, 2)))).all()
