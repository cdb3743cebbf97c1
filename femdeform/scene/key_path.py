"""Paths of keys inside a scene, and text as messages show it."""

from __future__ import annotations

import json
import re

KeyPath = tuple[str | int, ...]

_PLAIN_KEY = re.compile(r"[^\W\d][\w-]*")


def quoted(text: str, limit: int = 40) -> str:
    """Text in double quotes on one line, shortened, with every unprintable character escaped."""
    if len(text) > limit:
        text = text[: limit - 3] + "..."
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in json.dumps(text, ensure_ascii=False))


def format_key(path: KeyPath) -> str:
    """Dotted form of a path, for example ``conditions[1].on``; unusual keys are put in quotes."""
    result = ""
    for part in path:
        if isinstance(part, int):
            result += f"[{part}]"
        else:
            result += "." * bool(result) + (part if _PLAIN_KEY.fullmatch(part) and len(part) <= 40 else quoted(part))
    return result
