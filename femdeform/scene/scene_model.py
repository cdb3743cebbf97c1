"""The base of every block of a scene, and the kinds of numbers and vectors that its keys take."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field


class SceneModel(BaseModel):
    """Base of every block of a scene: unknown keys are errors, types are not coerced, objects are frozen."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


def as_tuple(value: Any) -> Any:
    # YAML knows lists only; strict tuples would refuse them.
    return tuple(value) if isinstance(value, list) else value


def _not_zero(value: tuple[float, ...]) -> tuple[float, ...]:
    if not any(value):
        raise ValueError("a zero vector has no direction")
    return value


def default_tag(key: str, word: str) -> Callable[[Any], Any]:
    """Validator that fills in the word which chooses the member of a union, so that it may be left out."""

    def fill(value: Any) -> Any:
        return {**value, key: word} if isinstance(value, dict) and key not in value else value

    return fill


Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = Annotated[tuple[Finite, ...], BeforeValidator(as_tuple), Field(min_length=2, max_length=3)]
Direction = Annotated[
    tuple[Finite, ...],
    BeforeValidator(as_tuple),
    Field(min_length=2, max_length=3),
    AfterValidator(_not_zero),
]
# Names of bodies stand before the dot of `on: body.group`, and in the names of result fields.
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")]


def distinct(value: Any) -> Any:
    if len(set(value)) < len(value):
        raise ValueError("an entry is given twice")
    return value


class LineSearch(SceneModel):
    armijo: float = Field(default=1e-4, gt=0.0, lt=0.5, description="sufficient decrease [-]")
    shrink: float = Field(default=0.5, gt=0.0, lt=1.0, description="factor of a backtrack [-]")
    max_backtracks: int = Field(default=40, ge=1, description="backtracks before the step counts as failed")
