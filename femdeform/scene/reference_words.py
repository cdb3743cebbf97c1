"""Types, bounds, defaults and values of the schema as the cells of a Markdown table say them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from femdeform.scene.annotations import Expected, holds_models, take_apart, union_members
from femdeform.scene.scene_model import Name

# Text of a link to the block that an annotation stands for.
Link = Callable[[Any], str]

# Bounds that only keep nonsense out of the arithmetic; no scene comes near them.
_BEYOND = 1e12
_NAME_PATTERN = next(item.pattern for item in take_apart(Name).constraints if hasattr(item, "pattern"))
_SCALARS = {float: "number", int: "whole number", str: "text", bool: "true or false"}
_BOUNDS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))


def type_in_words(expected: Expected, link: Link) -> str:
    """What a key takes, with its bounds, in Markdown: ``list of 2 or 3 numbers``, ``number > 0``."""
    return _in_words(expected, link)


def _in_words(expected: Expected, link: Link, plural: bool = False) -> str:
    base = expected.base
    origin, arguments = get_origin(base), get_args(base)
    if origin is dict:
        return f"mapping, name to {_in_words(take_apart(arguments[1]), link)}"
    if origin is list or (origin is tuple and arguments[-1:] == (Ellipsis,)):
        item = take_apart(arguments[0])
        kind = f"{'non-empty ' if _lengths(expected) == (1, None) else ''}{'lists' if plural else 'list'}"
        return f"{kind} of {_count(expected)}{_in_words(item, link, plural=True)}"
    if origin is tuple:
        item = take_apart(arguments[0])
        return f"{'lists' if plural else 'list'} of {len(arguments)} {_in_words(item, link, plural=True)}"
    if holds_models(base):
        if not all(holds_models(member) for member in union_members(base)):
            return link(base)  # a text or a block
        return f"{link(base)} {'blocks' if plural else 'block'}"
    if origin is Literal:
        return joined([f"`{_plain(word)}`" for word in arguments])
    if union_members(base):
        words = [_in_words(take_apart(member), link, plural) for member in union_members(base)]
        if "number" in words:
            words = [word for word in words if word != "whole number"]
        return joined(list(dict.fromkeys(words)))
    if any(getattr(item, "pattern", None) == _NAME_PATTERN for item in expected.constraints):
        word = "name"
    else:
        word = _SCALARS.get(base, "value")
    many = f"{word}s" if plural and word != "true or false" else word
    bounds = _bounds(expected)
    return f"{many} {bounds}" if bounds else many


def joined(words: list[str]) -> str:
    """``a, b or c``."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _bounds(expected: Expected) -> str:
    found = {}
    for item in expected.constraints:
        for name, sign in _BOUNDS:
            limit = getattr(item, name, None)
            if limit is not None and abs(limit) < _BEYOND:
                found[sign] = str(limit) if isinstance(limit, int) else f"{limit:g}"
    return " and ".join(f"{sign} {limit}" for sign, limit in found.items())


def _lengths(expected: Expected) -> tuple[int | None, int | None]:
    low = high = None
    for item in expected.constraints:
        low = getattr(item, "min_length", low)
        high = getattr(item, "max_length", high)
    return low, high


def _count(expected: Expected) -> str:
    low, high = _lengths(expected)
    if high is None:
        return f"at least {low} " if low and low > 1 else ""
    if low == high:
        return f"{high} "
    return f"{low or 0} {'or' if high - (low or 0) == 1 else 'to'} {high} "


def default_in_words(info: FieldInfo) -> str:
    """What holds where a key is left out, in Markdown."""
    if info.is_required():
        return "**required**"
    value = info.get_default(call_default_factory=True)
    if value is None or value in ("", [], {}):
        return "none"
    if isinstance(value, BaseModel):
        return "its defaults"
    return f"`{value_in_yaml(value)}`"


def cell(text: str) -> str:
    """Plain text, made safe for a cell of a table; what stands in backticks is kept."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    return "".join(part if part.startswith("`") else _escaped(part) for part in parts)


def _escaped(text: str) -> str:
    for sign, safe in (("\\", "\\\\"), ("|", "\\|"), ("<", "&lt;"), ("*", "\\*")):
        text = text.replace(sign, safe)
    return text


# -------------------------------------------------------------------------------------------------- values


def value_in_yaml(value: Any) -> str:
    """A value in YAML's flow style, on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {value_in_yaml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(value_in_yaml, value)) + "]"
    return _plain(value)


def _plain(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, str) and not re.fullmatch(r"[A-Za-z][\w./ -]*", value):
        return json.dumps(value)
    return str(value)


def _number(value: float) -> str:
    """The shortest form that YAML 1.2 and most other readers take for the same number."""
    mantissa, _, exponent = repr(value).partition("e")
    if not exponent and abs(value) >= 1e5:
        short, _, power = f"{value:.12e}".partition("e")
        mantissa, exponent = short.rstrip("0"), power
    if not exponent:
        return mantissa
    if mantissa.endswith("."):
        mantissa += "0"
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(exponent):+d}"


def block_in_yaml(key: str, holder: str, value: Any, width: int = 100) -> str:
    """A key with its value: in flow style if it fits into a line, else a key a line.

    Parameters
    ----------
    key : str
        The key.
    holder : str
        ``list`` or ``dict`` if the key takes a list or a mapping of such values, else empty.
    value : Any
        Plain data.
    width : int
        Longest line.
    """
    start = {"list": f"{key}:\n  - ", "dict": f"{key}:\n  NAME: "}.get(holder, f"{key}: ")
    flow = start + value_in_yaml(value)
    if not isinstance(value, dict) or len(flow.splitlines()[-1]) <= width:
        return flow
    indent = "    " if holder else "  "
    lines = [f"{name}: {value_in_yaml(item)}" for name, item in value.items()]
    if holder == "list":
        return start + f"\n{indent}".join(lines)
    return start.rstrip() + "".join(f"\n{indent}{line}" for line in lines)
