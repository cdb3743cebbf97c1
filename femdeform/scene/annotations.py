"""What the schema expects somewhere: the type annotations of its models, taken apart."""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, BeforeValidator
from pydantic.fields import FieldInfo


@dataclass(frozen=True)
class Expected:
    """A type annotation, taken apart."""

    base: Any
    before: tuple[Callable[[Any], Any], ...] = ()
    constraints: tuple[Any, ...] = ()
    discriminator: str | None = None
    description: str = ""
    optional: bool = False

    @property
    def unit(self) -> str:
        """The description's unit, ready to follow a number; empty if there is none."""
        found = re.search(r"\[([^\[\]]+)\]", self.description)
        return f" [{found[1]}]" if found and found[1] != "-" else ""


def take_apart(annotation: Any, metadata: Sequence[Any] = ()) -> Expected:
    """Take an annotation apart: `Annotated` and `None` go, constraints, validators, discriminator stay."""
    if get_origin(annotation) is Annotated:
        inner, *own = get_args(annotation)
        return take_apart(inner, [*own, *metadata])
    if isinstance(annotation, FieldInfo):
        result = take_apart(annotation.annotation, annotation.metadata)
        return replace(
            result,
            description=annotation.description or result.description,
            discriminator=_tag_name(annotation.discriminator) or result.discriminator,
        )
    members = union_members(annotation)
    if members and len(members) < len(get_args(annotation)):
        rest = members[0] if len(members) == 1 else Union[tuple(members)]  # noqa: UP007
        return replace(take_apart(rest, metadata), optional=True)
    result = Expected(annotation)
    for item in metadata:
        if isinstance(item, FieldInfo):
            inner = take_apart(item)
            result = replace(
                result,
                constraints=(*result.constraints, *inner.constraints),
                before=(*result.before, *inner.before),
                description=inner.description or result.description,
                discriminator=inner.discriminator or result.discriminator,
            )
        elif isinstance(item, BeforeValidator):
            result = replace(result, before=(*result.before, item.func))  # type: ignore[arg-type]
        else:
            result = replace(result, constraints=(*result.constraints, item))
    return result


def _tag_name(discriminator: Any) -> str | None:
    name = getattr(discriminator, "discriminator", discriminator)
    return name if isinstance(name, str) else None


def union_members(annotation: Any) -> list[Any]:
    """Members of a union without None; empty if it is not a union."""
    if get_origin(annotation) not in (Union, types.UnionType):
        return []
    return [member for member in get_args(annotation) if member is not type(None)]


def is_model(annotation: Any) -> bool:
    """Whether an annotation is a model."""
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def holds_models(annotation: Any) -> bool:
    """Whether an annotation is a model or has one somewhere inside."""
    if is_model(annotation):
        return True
    if get_origin(annotation) is Annotated:
        return holds_models(get_args(annotation)[0])
    return get_origin(annotation) is not Literal and any(holds_models(part) for part in get_args(annotation))


def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Fields of a model by their key in a file."""
    return {info.alias or name: info for name, info in model.model_fields.items()}


def grouped_by_tag(expected: Expected) -> list[Expected]:
    """Members of a union; those told apart by a common key (`recipe: ...`) become one tagged union."""
    members = [take_apart(member) for member in union_members(expected.base)]
    groups: dict[str, list[Expected]] = {}
    for member in members:
        if is_model(member.base):
            for key, info in fields_of(member.base).items():
                if info.is_required() and get_origin(info.annotation) is Literal:
                    groups.setdefault(key, []).append(member)
    tag, group = max(groups.items(), key=lambda item: len(item[1]), default=("", []))
    if len(group) < 2:
        return members
    whole = Expected(Union[tuple(member.base for member in group)], discriminator=tag)  # noqa: UP007
    return [whole, *(member for member in members if member not in group)]


def alternatives(member: Expected) -> list[type[BaseModel]]:
    """Models that a union member stands for: itself, or the members of a nested union."""
    if is_model(member.base):
        return [member.base]
    return [model for inner in union_members(member.base) for model in alternatives(take_apart(inner))]


def known_keys(member: Expected) -> set[str]:
    """Every key that a union member knows."""
    return {key for model in alternatives(member) for key in fields_of(model)}


def telling_keys(member: Expected, members: Sequence[Expected]) -> set[str]:
    """Keys that a union member requires and no other member knows."""
    if member.discriminator:
        required = {member.discriminator}
    else:
        required = {
            key for model in alternatives(member) for key, info in fields_of(model).items() if info.is_required()
        }
    others = {key for other in members if other is not member for key in known_keys(other)}
    return required - others
