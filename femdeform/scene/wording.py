"""What is wrong with a value, in the words of somebody who has never heard of types or validators."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import Annotated, Any, Literal, get_args, get_origin

from femdeform.scene.annotations import (
    Expected,
    grouped_by_tag,
    holds_models,
    take_apart,
    telling_keys,
    union_members,
)
from femdeform.scene.key_path import KeyPath, quoted


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``did you mean `x`?`` for the closest known word, or the list of the known words."""
    words = sorted(set(known))
    lower = {candidate.lower(): candidate for candidate in reversed(words)}
    close = difflib.get_close_matches(word[:60].lower().replace("-", "_"), lower, n=1)
    if close:
        return f"did you mean `{lower[close[0]]}`?"
    return f"known: {', '.join(words)}" if words else "none are known here"


def shown(value: Any) -> str:
    """A value as a sentence about it names it, on one line and short."""
    if value is None:
        return "an empty value"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return f"the text {quoted(value)}"
    if isinstance(value, dict):
        return "a mapping"
    return "a list" if isinstance(value, (list, tuple)) else type(value).__name__


def one_of(words: Iterable[Any], start: str = "one of") -> str:
    """``one of `a`, `b` ``, or the only word."""
    listed = [f"`{word}`" for word in words]
    if len(listed) == 1:
        return listed[0]
    return f"{start} {', '.join(listed)}"


def suggestion(word: str, known: Iterable[str]) -> str:
    """``; did you mean `x`?`` if a known word is close, else nothing."""
    hint = did_you_mean(word, known)
    return f"; {hint}" if hint.startswith("did") else ""


def in_words(annotation: Any) -> str:
    """What a type accepts, for a sentence that starts with "must be"."""
    if get_origin(annotation) is Annotated:
        return in_words(get_args(annotation)[0])
    if union_members(annotation):
        members = grouped_by_tag(Expected(annotation))
        with_keys = [member for member in members if holds_models(member.base)]
        words = [in_words(member.base) for member in members if member not in with_keys]
        keys = sorted(key for member in with_keys for key in telling_keys(member, with_keys))
        if "a number" in words and "a whole number" in words:
            words.remove("a whole number")
        if with_keys:
            words.append(f"a mapping with {one_of(keys)}" if keys else "a mapping (`key: value`)")
        return ", or ".join(words)
    origin, arguments = get_origin(annotation) or annotation, get_args(annotation)
    if origin is Literal:
        return one_of(arguments)
    if origin in (list, tuple):
        plain = {float: "numbers", int: "whole numbers", str: "texts"}
        inner = take_apart(arguments[0]).base if arguments else None
        if inner in plain:
            return f"a list of {plain[inner]}"
        return "a list of lists" if get_origin(inner) in (list, tuple) else "a list"
    names = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}
    return names.get(origin, "a mapping (`key: value`)")


def explain(detail: Any, expected: Expected, inner: KeyPath) -> str:
    """One of pydantic's errors as a sentence.

    Parameters
    ----------
    detail : dict
        An entry of ``ValidationError.errors()``.
    expected : Expected
        What was expected where validation began.
    inner : tuple of str or int
        Path from there to the value with the error.
    """
    kind, context, value = detail["type"], detail.get("ctx", {}), detail["input"]
    is_item = bool(inner) and isinstance(inner[-1], int)
    if kind == "value_error":
        return str(detail["msg"]).removeprefix("Value error, ")
    bounds = {"greater_than": "gt", "greater_than_equal": "ge", "less_than": "lt", "less_than_equal": "le"}
    if kind in bounds:
        limit = context[bounds[kind]]
        words = {"gt": "greater than", "ge": "at least", "lt": "less than", "le": "at most"}[bounds[kind]]
        return f"must be {words} {limit:g}{expected.unit}, not {shown(value)}"
    if kind == "finite_number":
        return "must be a finite number"
    if kind in ("too_short", "too_long"):
        return _count(expected, context, inner, len(value))
    if kind == "missing":
        # The only place where pydantic itself can miss something: an entry of a list of fixed length.
        return f"needs {len(get_args(expected.base))} entries, not {len(value)}"
    if kind == "literal_error":
        choices = [word.strip("'") for word in re.split(", | or ", context["expected"])]
        if isinstance(value, str):
            return f"must be {one_of(choices)}, not {quoted(value)}{suggestion(value, choices)}"
        return f"must be {one_of(choices)}, not {shown(value)}"
    if kind == "string_pattern_mismatch":
        return f"{quoted(value)} must start with a letter and hold only letters, digits, `_` and `-`"
    scalar = {
        "float_type": "a number",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "string_type": "text",
        "bool_type": "true or false",
    }
    if kind in scalar:
        return f"must be {scalar[kind]}, not {shown(value)}{_remark(kind, value, expected)}"
    if kind in ("list_type", "tuple_type", "dict_type", "model_type") and not is_item:
        return f"must be {in_words(expected.base)}, not {shown(value)}"
    if kind in ("list_type", "tuple_type"):
        return f"must be a list, not {shown(value)}"
    text = re.sub(r"^(Input|List|Tuple|String|Value|Dictionary) should ", "must ", str(detail["msg"]))
    return " ".join(text.split())[:160]


def _count(expected: Expected, context: Any, inner: KeyPath, actual: int) -> str:
    low, high = context.get("min_length"), context.get("max_length")
    for constraint in expected.constraints if not inner else ():
        low = getattr(constraint, "min_length", low)
        high = getattr(constraint, "max_length", high)
    if low == 1 and actual == 0:
        return "must not be empty"
    if high is None:
        return f"needs at least {low} entries, not {actual}"
    if low is None or low == high:
        return f"{'takes at most' if low is None else 'needs'} {high} entries, not {actual}"
    return f"needs {low} {'or' if high == low + 1 else 'to'} {high} entries, not {actual}"


def _remark(kind: str, value: Any, expected: Expected) -> str:
    if not isinstance(value, str):
        return ""
    if kind == "bool_type" and value.lower() in ("yes", "no", "on", "off", "y", "n"):
        return " (YAML 1.2 has no yes and no)"
    if kind != "bool_type" and kind != "string_type":
        if re.fullmatch(r"\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*", value):
            return " (remove the quotes)"
        if re.match(r"\s*[-+]?[0-9]", value):
            return f" (write the number alone{', in' + expected.unit if expected.unit else ''})"
    return ""
