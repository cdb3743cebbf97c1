"""The JSON schema of scene files, for editors."""

from __future__ import annotations

from typing import Any

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
# For arrays the words differ; pydantic keeps those of text where a validator stands before the constraint.
_ARRAY_WORDS = {"minLength": "minItems", "maxLength": "maxItems"}


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a scene, every key with its description and unit."""
    from pydantic import TypeAdapter

    from femdeform.scene.kinds import Scene

    schema = TypeAdapter(Scene).json_schema(by_alias=True, mode="validation")
    return {"$schema": _DIALECT, "title": "femdeform scene", **_simplified(schema)}


def _simplified(node: Any) -> Any:
    """Leave out what repeats the key (titles) or is not JSON Schema, and say what pydantic leaves open."""
    if isinstance(node, list):
        return [_simplified(item) for item in node]
    if not isinstance(node, dict):
        return node
    result: dict[str, Any] = {}
    for word, value in node.items():
        if word in ("title", "discriminator") or (word == "default" and value is None):
            continue
        if word in ("properties", "$defs", "patternProperties"):
            # Here the words are keys of scenes, or names of definitions.
            result[word] = {name: _simplified(item) for name, item in value.items()}
        else:
            result[word] = _simplified(value)
    if result.get("type") == "array":
        result = {_ARRAY_WORDS.get(word, word): value for word, value in result.items()}
    if "patternProperties" in result:
        result["additionalProperties"] = False
    return result
