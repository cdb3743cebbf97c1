"""References that are numbers before anything is computed: published values and formulas."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any

from femdeform.errors import InputError
from femdeform.scene.key_path import KeyPath
from femdeform.scene.wording import did_you_mean, shown
from verification.expressions import ExpressionError, evaluate
from verification.study_schema import AnalyticReference, ValueReference

# Where the table of formulas is; imported when a study asks for one.
TABLE = "verification.analytic:ANALYTIC"


class ReferenceValueError(ValueError):
    """A reference cannot be evaluated.

    Attributes
    ----------
    key : KeyPath
        What is wrong, inside the reference.
    of_level : bool
        The argument may have been given by the level.
    """

    def __init__(self, key: KeyPath, message: str, of_level: bool = False) -> None:
        super().__init__(message)
        self.key = key
        self.of_level = of_level


def static_value(
    reference: ValueReference | AnalyticReference,
    more: Mapping[str, Any],
    scene: Any,
    constants: Mapping[str, float],
) -> float:
    """Value of a published number or a formula.

    Parameters
    ----------
    reference : ValueReference or AnalyticReference
        As in the study file.
    more : mapping of str to Any
        Arguments of the level, over those of the reference; a formula that does not know one ignores it.
    scene : DeformableScene
        The scene of the level.
    constants : mapping of str to float
        Of the study.

    Raises
    ------
    ReferenceValueError
        If there is no such formula, its arguments are wrong, or it has no value there.
    """
    if isinstance(reference, ValueReference):
        try:
            return evaluate(reference.value, constants)
        except ExpressionError as error:
            raise ReferenceValueError(("value",), str(error)) from None
    function = _find(reference.analytic)
    parameters = list(inspect.signature(function).parameters.values())[1:]
    known = {parameter.name: parameter for parameter in parameters}
    for name in reference.arguments:
        if name not in known:
            hint = did_you_mean(name, known) if known else "it takes none"
            raise ReferenceValueError(("arguments", name), f"`{reference.analytic}` has no such argument; {hint}")
    given = {**reference.arguments, **{name: value for name, value in more.items() if name in known}}
    for name, parameter in known.items():
        if name not in given and parameter.default is inspect.Parameter.empty:
            raise ReferenceValueError(("arguments",), f"`{reference.analytic}` needs the argument `{name}`")
    arguments = {name: _argument(name, value, known[name], constants) for name, value in given.items()}
    try:
        value = float(function(scene, **arguments))
    except InputError as error:  # the scene is none that the formula is about
        raise ReferenceValueError(("analytic",), f"`{reference.analytic}`: {error.faults[0]}") from None
    except (ValueError, TypeError, ArithmeticError, LookupError, AttributeError) as error:
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ReferenceValueError(("analytic",), f"`{reference.analytic}` has no value here: {text}") from None
    if not math.isfinite(value):
        raise ReferenceValueError(("analytic",), f"`{reference.analytic}` is not finite here")
    return value


def formulas() -> dict[str, Callable[..., float]]:
    """The table of formulas by name."""
    from femdeform import registry

    table: dict[str, Callable[..., float]] = registry.resolve(TABLE)
    return table


def _find(name: str) -> Callable[..., float]:
    table = formulas()
    if name not in table:
        raise ReferenceValueError(("analytic",), f"there is no formula `{name}`; {did_you_mean(name, table)}")
    return table[name]


def _argument(name: str, value: Any, parameter: inspect.Parameter, constants: Mapping[str, float]) -> Any:
    annotation = str(parameter.annotation)
    if isinstance(value, str) and (parameter.annotation is str or annotation.startswith(("str", "Literal"))):
        return value
    try:
        return _evaluated(value, constants)
    except ExpressionError as error:
        raise ReferenceValueError(("arguments", name), str(error), of_level=True) from None


def _evaluated(value: Any, constants: Mapping[str, float]) -> Any:
    if isinstance(value, list):
        return [_evaluated(item, constants) for item in value]
    if isinstance(value, bool):
        return value
    if isinstance(value, int | float | str):
        return evaluate(value, constants)
    raise ExpressionError(f"must be a number, an expression, or a list of them, not {shown(value)}")
