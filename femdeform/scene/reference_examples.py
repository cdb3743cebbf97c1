"""Short examples for the blocks of a schema: those of `examples.yaml`, or made up from required keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

from femdeform.scene.annotations import Expected, fields_of, is_model, take_apart, union_members

_FILE = "examples.yaml"


def given_examples() -> dict[str, Any]:
    """Plain data by the anchor of the section it belongs to, from `examples.yaml`."""
    from ruamel.yaml import YAML

    text = (files("femdeform.scene") / _FILE).read_text(encoding="utf-8")
    data: dict[str, Any] = YAML(typ="safe", pure=True).load(text)
    return data


def example_of(model: type[BaseModel], tag: str = "", like: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Make up plain data with the required keys of a model.

    What a model demands of several keys together is not known here; such a model needs an example in the file.

    Parameters
    ----------
    model : type of BaseModel
        The model.
    tag : str
        The key that says which model is meant; it comes first.
    like : mapping of str to Any, optional
        Values of neighbouring models, taken for keys of the same name; other keys get the simplest value within
        their bounds.
    """
    wanted = {key: info for key, info in fields_of(model).items() if info.is_required() or key == tag}
    known = {} if like is None else {key: value for key, value in like.items() if key in wanted and key != tag}
    made = {key: known.get(key, _value(take_apart(info))) for key, info in wanted.items()}
    return {key: made[key] for key in sorted(made, key=lambda key: key != tag)}


def _value(expected: Expected) -> Any:
    base = expected.base
    origin, arguments = get_origin(base), get_args(base)
    if is_model(base):
        return example_of(base)
    if union_members(base):
        return _value(take_apart(union_members(base)[0]))
    if origin is Literal:
        return arguments[0]
    if origin is dict:
        return {"NAME": _value(take_apart(arguments[1]))}
    if origin is list or (origin is tuple and arguments[-1:] == (Ellipsis,)):
        count = max([1, *_limits(expected.constraints, "min_length")])
        # The last entry alone is not zero: a vector may have to be a direction.
        return [*[_zero(take_apart(arguments[0])) for _ in range(count - 1)], _value(take_apart(arguments[0]))]
    if origin is tuple:
        return [_value(take_apart(argument)) for argument in arguments]
    if base is bool:
        return True
    if base in (int, float):
        return _number(expected)
    return "NAME"


def _zero(item: Expected) -> Any:
    return 0 if item.base in (int, float) and not _limits(item.constraints, "gt", "ge") else _value(item)


def _number(expected: Expected) -> Any:
    low = max(_limits(expected.constraints, "gt", "ge"), default=None)
    high = min(_limits(expected.constraints, "lt", "le"), default=None)
    if (low is None or low < 1) and (high is None or high > 1):
        return 1 if expected.base is int else 1.0
    if low is not None and high is not None and expected.base is float:
        return 0.5 * (low + high)
    if low is not None:
        return low + 1 if _limits(expected.constraints, "gt") else low
    assert high is not None
    return high - 1


def _limits(constraints: Iterable[Any], *names: str) -> list[Any]:
    found = [getattr(item, name, None) for item in constraints for name in names]
    return [limit for limit in found if limit is not None]
