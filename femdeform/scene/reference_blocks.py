"""The blocks that a schema is made of: models and unions of models, where they are used, and the page of each."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from femdeform.scene.annotations import (
    Expected,
    alternatives,
    fields_of,
    grouped_by_tag,
    holds_models,
    is_model,
    take_apart,
    telling_keys,
    union_members,
)

# A union inside another block that has so many forms fills a page of its own.
_MANY = 6


@dataclass(frozen=True)
class Form:
    """One of the models that a block may be.

    Attributes
    ----------
    tag : str
        The key that chooses it, such as ``kind``; empty if the presence of a key does.
    words : tuple of str
        What the tag says, or the key that has to be there.
    model : type of BaseModel
        The model.
    about : str
        What it is.
    """

    tag: str
    words: tuple[str, ...]
    model: type[BaseModel]
    about: str

    @property
    def title(self) -> str:
        """The tag with its words, or the word alone, in Markdown: ``kind: rotate``."""
        first, *others = self.words
        return ", ".join([f"`{self.tag}: {first}`" if self.tag else f"`{first}`", *(f"`{word}`" for word in others)])

    @property
    def may_be_left_out(self) -> bool:
        """Whether this form is meant where the tag is left out."""
        return bool(self.tag) and not fields_of(self.model)[self.tag].is_required()


@dataclass
class Block:
    """A model or a union of models, and where it is used.

    Attributes
    ----------
    expected : Expected
        The annotation.
    holder : str
        ``list`` or ``dict`` if the first key that takes it takes several, else empty.
    about : str
        Description of that key.
    owners : list of (model, key)
        Who takes it, under which key.
    prefix : str
        Begins the names of pages of its root; empty for the first one.
    is_top : bool
        A root takes it.
    tops : set of str
        Keys of the scene from which it can be reached.
    page, anchor : str
        Its place in the reference.
    """

    expected: Expected
    holder: str
    about: str
    owners: list[tuple[type[BaseModel], str]] = field(default_factory=list)
    prefix: str = ""
    is_top: bool = False
    tops: set[str] = field(default_factory=set)
    page: str = ""
    anchor: str = ""

    @property
    def key(self) -> str:
        """The key that takes it most often, the first of those."""
        keys = [key for _, key in self.owners]
        return max(keys, key=keys.count)

    @property
    def has_several_keys(self) -> bool:
        """Whether keys of different names take it."""
        return len({key for _, key in self.owners}) > 1

    @property
    def is_page(self) -> bool:
        """Whether a page begins with it."""
        return self.page == self.prefix + self.key

    @property
    def forms(self) -> list[Form]:
        """The models it may be; empty if there is only one."""
        return list(_forms(self.expected)) if union_members(self.expected.base) else []

    @property
    def models(self) -> list[type[BaseModel]]:
        """The models it may be, also if there is only one."""
        return [form.model for form in self.forms] or [self.expected.base]

    @property
    def name(self) -> str:
        """Its key, or the name of its class in words if several keys take it."""
        if self.has_several_keys and is_model(self.expected.base):
            return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", self.expected.base.__name__).lower()
        return self.key

    @property
    def only_owner(self) -> type[BaseModel] | None:
        """The model that alone takes it, if there is one that is no root."""
        owners = {owner for owner, _ in self.owners}
        if self.is_top:
            return None
        return next(iter(owners)) if len(owners) == 1 else None

    def form_anchor(self, form: Form) -> str:
        """Anchor of the section of a form."""
        return joined_anchor(self.anchor, form.words[0])


def joined_anchor(*parts: str) -> str:
    """Anchor of a heading within another one."""
    return "-".join(re.sub("[_ ]", "-", part) for part in parts)


def prose(model: type[BaseModel]) -> str:
    """A model's own docstring on one line; an inherited one speaks of something else."""
    text = model.__dict__.get("__doc__") or ""
    return " ".join(text.replace("``", "`").split())


def find_blocks(roots: list[type[BaseModel]]) -> dict[Any, Block]:
    """Return the blocks below some models, by their annotation, each with its page and anchor.

    Every block of a top-level key has a page. So has a union inside another block that has many forms, or that can be
    reached from several top-level keys; other blocks are on the page of the one that takes them first.
    """
    blocks: dict[Any, Block] = {}
    for number, model in enumerate(roots):
        prefix = f"{get_args(model.model_fields['simulation'].annotation)[0]}_" if number else ""
        for key, info in fields_of(model).items():
            _collect(blocks, take_apart(info), model, key, prefix + key, prefix)
    for block in blocks.values():
        block.is_top = block.owners[0][0] in roots
    page_of: dict[type[BaseModel], str] = {}
    anchor_of: dict[type[BaseModel], str] = {}
    for block in blocks.values():  # owners come before what they hold
        owner = block.owners[0][0]
        is_shared = len(block.tops) > 1 or len(block.forms) >= _MANY
        is_page = block.is_top or (block.forms and is_shared)
        block.page = block.prefix + block.key if is_page else page_of[owner]
        if block.is_page:
            block.anchor = joined_anchor(block.page)
        else:
            only = block.only_owner
            block.anchor = joined_anchor(block.page if only is None else anchor_of[only], block.name)
        for model in block.models:
            page_of.setdefault(model, block.page)
            anchor_of.setdefault(model, block.anchor)
        for form in block.forms:
            anchor_of[form.model] = block.form_anchor(form)
    return blocks


def _collect(
    blocks: dict[Any, Block], expected: Expected, owner: type[BaseModel], key: str, top: str, prefix: str
) -> None:
    inner, holder = _unwrapped(expected)
    if not holds_models(inner.base):
        return
    block = blocks.setdefault(inner.base, Block(inner, holder, expected.description, prefix=prefix))
    if (owner, key) not in block.owners:
        block.owners.append((owner, key))
    if top in block.tops:
        return
    block.tops.add(top)
    for model in block.models:
        for inner_key, info in fields_of(model).items():
            _collect(blocks, take_apart(info), model, inner_key, top, prefix)


def _unwrapped(expected: Expected) -> tuple[Expected, str]:
    """What a list or a mapping holds, and which of them it is."""
    origin, arguments = get_origin(expected.base), get_args(expected.base)
    if origin in (list, tuple) and holds_models(expected.base):
        return take_apart(arguments[0]), "list"
    if origin is dict and holds_models(expected.base):
        return take_apart(arguments[1]), "dict"
    return expected, ""


def _forms(expected: Expected) -> Iterator[Form]:
    if expected.discriminator:
        members = [expected]
    else:
        members = [member for member in grouped_by_tag(expected) if holds_models(member.base)]
    for member in members:
        for model in alternatives(member):
            tag = member.discriminator or ""
            if tag:
                info: FieldInfo = fields_of(model)[tag]
                yield Form(tag, tuple(map(str, get_args(info.annotation))), model, info.description or "")
            else:
                key = min(telling_keys(member, members))
                yield Form("", (key,), model, prose(model) or fields_of(model)[key].description or "")
