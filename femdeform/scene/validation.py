"""Judges plain data against the schema and says in plain words, key by key, what is wrong.

pydantic validates; what it reports for a nested union names types and union members that mean nothing to the
author of a scene. So the models are walked key by key here: this module judges unknown and missing keys and
union tags, pydantic judges single values, one at a time. A finding is a key path and one sentence.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from femdeform.scene.annotations import (
    Expected,
    alternatives,
    fields_of,
    grouped_by_tag,
    holds_models,
    is_model,
    known_keys,
    take_apart,
    telling_keys,
    union_members,
)
from femdeform.scene.key_path import KeyPath, quoted
from femdeform.scene.wording import did_you_mean, explain, in_words, one_of, shown, suggestion


class Finding(NamedTuple):
    """Something wrong at a key path."""

    path: KeyPath
    message: str


class PlaceFinding(NamedTuple):
    """Something about places at the start, at a key path; odd rather than wrong if it is a notice."""

    path: KeyPath
    message: str
    is_notice: bool


def find_faults(model: Any, data: Any) -> list[Finding]:
    """Return everything about `data` that keeps it from being a `model`; an empty list means that it is one.

    Parameters
    ----------
    model : type of BaseModel or a union of such
        The schema.
    data : Any
        Plain data: lists, dicts with text keys, text, numbers, booleans, None.
    """
    return _judge(take_apart(model), data, ())


def _judge(expected: Expected, value: Any, path: KeyPath) -> list[Finding]:
    if value is None and expected.optional:
        return []
    if not holds_models(expected.base) and get_origin(expected.base) is not dict:
        return _judge_leaf(expected, value, path)
    for convert in reversed(expected.before):
        with contextlib.suppress(ValueError):  # what it refuses is found below, key by key
            value = convert(value)
    if is_model(expected.base):
        return _judge_model(expected.base, value, path)
    if union_members(expected.base):
        return _judge_union(expected, value, path)
    return _judge_collection(expected, value, path)


def _judge_collection(expected: Expected, value: Any, path: KeyPath) -> list[Finding]:
    origin, arguments = get_origin(expected.base), get_args(expected.base)
    findings: list[Finding] = []
    if origin is dict:
        if not isinstance(value, dict):
            return [Finding(path, f"must be a mapping (`name: ...`), not {shown(value)}")]
        name_type, item_type = take_apart(arguments[0]), take_apart(arguments[1])
        for key, item in value.items():
            findings += [
                Finding((*path, key), f"the name {found.message}") for found in _judge_leaf(name_type, key, ())
            ]
            findings += _judge(item_type, item, (*path, key))
    else:
        if not isinstance(value, (list, tuple)):
            return [Finding(path, f"must be a list (`- ...`), not {shown(value)}")]
        item_type = take_apart(arguments[0])
        for index, item in enumerate(value):
            findings += _judge(item_type, item, (*path, index))
    return findings or _by_pydantic(expected, value, path)


def _judge_union(expected: Expected, value: Any, path: KeyPath) -> list[Finding]:
    if expected.discriminator:
        return _judge_tagged(expected, value, path)
    members = grouped_by_tag(expected)
    with_keys = [member for member in members if holds_models(member.base)]
    if not isinstance(value, dict):
        for leaf in members:
            if leaf not in with_keys and _looks_like(leaf, value):
                return _judge_leaf(leaf, value, path)
        return [Finding(path, f"must be {in_words(expected.base)}, not {shown(value)}")]
    # The keys that tell one member from the others: those it requires and no other one knows.
    own = {key: member for member in with_keys for key in telling_keys(member, with_keys)}
    given = [key for key in value if key in own]
    if not given:
        unknown = [key for key in value if all(key not in keys for keys in map(known_keys, with_keys))]
        findings = [Finding((*path, key), f"unknown key; {did_you_mean(key, own)}") for key in unknown]
        return findings or [Finding(path, f"needs {one_of(own, 'one of the keys')}")]
    chosen = own[given[0]]
    findings = [
        Finding((*path, key), f"cannot be combined with `{given[0]}`")
        for key in given
        if own[key] is not chosen and key not in known_keys(chosen)
    ]
    handled = {finding.path[-1] for finding in findings}
    return findings + _judge(chosen, {key: item for key, item in value.items() if key not in handled}, path)


def _judge_tagged(expected: Expected, value: Any, path: KeyPath) -> list[Finding]:
    tag = expected.discriminator
    assert tag is not None
    models = alternatives(expected)
    by_tag = {word: model for model in models for word in get_args(model.model_fields[tag].annotation)}
    if not isinstance(value, dict):
        return [Finding(path, f"must be a mapping with the key `{tag}`, not {shown(value)}")]
    if tag not in value:
        finding = Finding((*path, tag), f"missing; {one_of(by_tag)}")
    elif not isinstance(value[tag], str):
        finding = Finding((*path, tag), f"must be {one_of(by_tag)}, not {shown(value[tag])}")
    elif value[tag] not in by_tag:
        finding = Finding(
            (*path, tag), f"{quoted(value[tag])} is not a known {tag}; {did_you_mean(value[tag], by_tag)}"
        )
    else:
        return _judge_model(by_tag[value[tag]], value, path, models, tag)
    # Which member is meant is open; what all of them share can still be judged.
    shared = _judge_shared(models, tag, value, path)
    misspelt = [found for found in shared if found.message.endswith(f"did you mean `{tag}`?")]
    if not path:
        # A whole scene is judged as the kind that knows most of its keys.
        likely = max(models, key=lambda model: len(fields_of(model).keys() & value.keys()))
        word = get_args(likely.model_fields[tag].annotation)[0]
        known = {key: item for key, item in value.items() if all(key != found.path[-1] for found in misspelt)}
        shared = [*misspelt, *_judge_model(likely, {**known, tag: word}, path)]
    return shared if tag not in value and misspelt else [finding, *shared]


def _judge_shared(models: Sequence[type[BaseModel]], tag: str, value: dict[str, Any], path: KeyPath) -> list[Finding]:
    findings: list[Finding] = []
    known = {key for model in models for key in fields_of(model)}
    first, *others = map(fields_of, models)
    for key, info in first.items():
        same = all(
            key in other and (other[key].annotation, other[key].metadata) == (info.annotation, info.metadata)
            for other in others
        )
        if key == tag or not same:
            continue
        if key in value:
            findings += _judge(take_apart(info), value[key], (*path, key))
        elif info.is_required() and all(other[key].is_required() for other in others):
            findings.append(_missing(info, (*path, key)))
    unknown = [key for key in value if key not in known]
    return findings + [Finding((*path, key), f"unknown key; {did_you_mean(key, known)}") for key in unknown]


def _judge_model(
    model: type[BaseModel], value: Any, path: KeyPath, siblings: Sequence[type[BaseModel]] = (), tag: str = ""
) -> list[Finding]:
    if not isinstance(value, dict):
        return [Finding(path, f"must be a mapping (`key: value`), not {shown(value)}")]
    fields = fields_of(model)
    findings: list[Finding] = []
    misspelt: set[str] = set()
    for key, item in value.items():
        if key in fields:
            findings += _judge(take_apart(fields[key]), item, (*path, key))
        else:
            message = _unknown(key, value, fields, siblings, tag)
            findings.append(Finding((*path, key), message))
            # A key that was meant by a misspelt one is not reported as missing as well.
            misspelt.update(name for name in fields if message.endswith(f"did you mean `{name}`?"))
    findings += [
        _missing(info, (*path, key))
        for key, info in fields.items()
        if info.is_required() and key not in value and key not in misspelt
    ]
    # What only the model as a whole can judge (keys against each other) needs its keys to be sound.
    return findings or _by_pydantic(Expected(model), value, path)


def _unknown(
    key: str,
    value: dict[str, Any],
    fields: dict[str, FieldInfo],
    siblings: Sequence[type[BaseModel]],
    tag: str,
) -> str:
    owners = [
        word for model in siblings if key in fields_of(model) for word in get_args(model.model_fields[tag].annotation)
    ]
    if owners:
        return f"not a key of {tag} `{value[tag]}`; it belongs to {', '.join(f'`{word}`' for word in owners)}"
    # A key that is not there yet is what was meant more likely than one that is.
    hint = suggestion(key, [name for name in fields if name not in value])
    return f"unknown key{hint or '; ' + did_you_mean(key, fields)}"


def _missing(info: FieldInfo, path: KeyPath) -> Finding:
    return Finding(path, "missing" + (f"; {info.description}" if info.description else ""))


# ------------------------------------------------------------------------------------------- single values


def _judge_leaf(expected: Expected, value: Any, path: KeyPath) -> list[Finding]:
    members = union_members(expected.base)
    if members:
        # Of several types the one that the value looks like is judged, so that one fault gives one sentence.
        fitting = [member for member in members if _looks_like(take_apart(member), value)]
        if len(fitting) != 1 and not any(take_apart(member).base is type(value) for member in fitting):
            return [Finding(path, f"must be {in_words(expected.base)}, not {shown(value)}")]
        exact = [member for member in fitting if take_apart(member).base is type(value)]
        chosen = take_apart((exact or fitting)[0])
        return _judge_leaf(replace(chosen, description=expected.description), value, path)
    if get_origin(expected.base) is Literal:
        return _judge_literal(expected, value, path)
    return _by_pydantic(expected, value, path)


def _looks_like(expected: Expected, value: Any) -> bool:
    base = get_origin(expected.base) or expected.base
    if base in (list, tuple):
        return isinstance(value, (list, tuple))
    if base is Literal:
        return any(type(choice) is type(value) for choice in get_args(expected.base))
    if base is float:
        return isinstance(value, (int, float)) and not isinstance(value, bool)
    return type(value) is base


def _judge_literal(expected: Expected, value: Any, path: KeyPath) -> list[Finding]:
    choices = get_args(expected.base)
    if any(type(choice) is type(value) and choice == value for choice in choices):
        return []
    if isinstance(value, str) and all(isinstance(choice, str) for choice in choices):
        return [Finding(path, f"must be {one_of(choices)}, not {quoted(value)}{suggestion(value, choices)}")]
    return [Finding(path, f"must be {one_of(choices)}, not {shown(value)}")]


def _by_pydantic(expected: Expected, value: Any, path: KeyPath) -> list[Finding]:
    try:
        if is_model(expected.base):
            expected.base.model_validate(value)
        else:
            annotation: Any = expected.base | None if expected.optional else expected.base
            validators = [BeforeValidator(function) for function in expected.before]
            _adapter(annotation, (*expected.constraints, *validators)).validate_python(value)
    except ValidationError as error:
        findings = []
        for detail in error.errors(include_url=False):
            if _counts_only_sound_entries(detail):
                continue
            inner = _locate(value, detail["loc"])
            sentence = explain(detail, expected, inner)
            # A validator of a whole model names the key it is about: `raise ValueError("dt: ...")`.
            key, colon, rest = sentence.partition(": ")
            if is_model(expected.base) and colon and key in fields_of(expected.base):
                inner, sentence = (*inner, key), rest
            findings.append(Finding(path + inner, sentence))
        return list(dict.fromkeys(findings))
    return []


def _counts_only_sound_entries(detail: Any) -> bool:
    """Whether a list is called too short only because pydantic leaves out the entries that have faults."""
    if detail["type"] != "too_short" or not isinstance(detail["input"], (list, tuple)):
        return False
    return len(detail["input"]) >= int(detail["ctx"]["min_length"])


@cache
def _cached_adapter(annotation: Any) -> TypeAdapter[Any]:
    return TypeAdapter(annotation, config=None if holds_models(annotation) else ConfigDict(strict=True))


def _adapter(annotation: Any, metadata: tuple[Any, ...]) -> TypeAdapter[Any]:
    whole: Any = Annotated[annotation, *metadata] if metadata else annotation
    try:
        return _cached_adapter(whole)
    except TypeError:  # some metadata cannot be hashed
        return TypeAdapter(whole, config=None if holds_models(annotation) else ConfigDict(strict=True))


def _locate(value: Any, loc: tuple[int | str, ...]) -> KeyPath:
    """Return the part of pydantic's location that is a path in the data; it also names union members."""
    path: list[int | str] = []
    for part in loc:
        if isinstance(value, (list, tuple)):
            is_there = isinstance(part, int) and part < len(value)
        else:
            is_there = isinstance(value, dict) and part in value
        if is_there:
            path.append(part)
            value = value[part]
    return tuple(path)
