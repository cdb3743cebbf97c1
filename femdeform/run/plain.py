"""Facts and scenes as text: JSON and YAML of values that may hold numpy numbers, tuples and paths."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from io import StringIO
from typing import Any

import numpy as np


def to_json(facts: Mapping[str, Any]) -> str:
    """Strict JSON of facts that may hold numpy values, paths and tuples; NaN and infinity become null."""
    return json.dumps(_plain(facts, finite=True), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def to_yaml(resolved: Mapping[str, Any]) -> str:
    """YAML 1.2 of a resolved scene, in the order of its keys.

    Parameters
    ----------
    resolved : mapping
        The scene; tuples and numpy values become lists and numbers.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.comments import CommentedSeq

    def arranged(value: Any) -> Any:
        # Vectors on one line, as people write them; everything else one key a line.
        if isinstance(value, dict):
            return {key: arranged(item) for key, item in value.items()}
        if isinstance(value, list):
            sequence = CommentedSeq([arranged(item) for item in value])
            if not any(isinstance(item, dict | list) for item in value):
                sequence.fa.set_flow_style()
            return sequence
        return value

    yaml = YAML()
    yaml.width = 110
    yaml.indent(mapping=2, sequence=4, offset=2)
    stream = StringIO()
    yaml.dump(arranged(_plain(resolved, finite=False)), stream)
    return stream.getvalue()


def _plain(value: Any, *, finite: bool) -> Any:
    """Plain dicts, lists and numbers, as JSON and YAML writers want them."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item, finite=finite) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(item, finite=finite) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist(), finite=finite)
    if isinstance(value, float) and finite and not math.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
