"""The schema as Markdown: every block of a scene with its keys, types, units, bounds, defaults and an example.

Everything is read from the models, so a block, a key or a word that is added to them is in the reference without
further ado. Examples come from `examples.yaml` beside this module; a block that has none there gets one made from
its required keys.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from femdeform.scene.annotations import alternatives, fields_of, holds_models, take_apart, union_members
from femdeform.scene.reference_blocks import Block, find_blocks, joined_anchor, prose
from femdeform.scene.reference_examples import example_of, given_examples
from femdeform.scene.reference_words import block_in_yaml, cell, default_in_words, type_in_words

_INDEX = "index"


@dataclass(frozen=True)
class Section:
    """A heading with its text; links inside are ``[text](#anchor)`` whatever page the anchor is on.

    Attributes
    ----------
    page : str
        Name of the page.
    anchor : str
        Anchor of the heading, unique over all pages.
    level : int
        Level of the heading, from 1 for the title of a page.
    title, text : str
        Markdown.
    block : Block or None
        What is described, if it is a single model with an example.
    model : type of BaseModel or None
        What the example has to be.
    example : Any
        Plain data; None if there is none.
    """

    page: str
    anchor: str
    level: int
    title: str
    text: str
    block: Block | None = None
    model: type[BaseModel] | None = None
    example: Any = None

    def markdown(self, shift: int = 0) -> str:
        """The section as Markdown, its heading `shift` levels lower."""
        return f"{'#' * (self.level + shift)} {self.title} {{#{self.anchor}}}\n\n{self.text}\n"


def scene_sections() -> list[Section]:
    """Sections of the reference of everything a scene may say, page after page."""
    from femdeform.scene.kinds import Scene

    return sections(Scene, "The keys of a scene", given_examples())


def scene_markdown() -> str:
    """The reference of scenes as one Markdown document."""
    return "\n".join(["# Scene reference\n", *(section.markdown(shift=1) for section in scene_sections())])


def scene_pages() -> dict[str, str]:
    """The reference of scenes as Markdown pages by name, linked to one another; the first one is ``index``."""
    written = scene_sections()
    page_of = {section.anchor: section.page for section in written}
    pages: dict[str, str] = {}
    for section in written:

        def target(found: re.Match[str], page: str = section.page) -> str:
            other = page_of[found[1]]
            return f"](#{found[1]})" if other == page else f"]({other}.md#{found[1]})"

        text = re.sub(r"\]\(#([\w-]+)\)", target, section.markdown())
        pages[section.page] = f"{pages[section.page]}\n{text}" if section.page in pages else text
    return pages


def schema_markdown(root: type[BaseModel], title: str) -> str:
    """The reference of any other schema as one Markdown document, without examples."""
    first, *rest = sections(root, title)
    # The blocks of top-level keys begin pages of their own in a larger reference; here they are sections.
    return "\n".join([first.markdown(), *(section.markdown(shift=1) for section in rest)])


def sections(root: Any, title: str, examples: dict[str, Any] | None = None) -> list[Section]:
    """Return the sections of a schema, page after page, the page ``index`` first.

    Parameters
    ----------
    root : type of BaseModel or a union of such
        The schema.
    title : str
        Title of the first page.
    examples : dict of str to Any, optional
        Plain data by the anchor of the section, over those made up from required keys. Without it no section has an
        example.
    """
    return list(_Writer(alternatives(take_apart(root)), title, examples).write())


class _Writer:
    """Writes the sections of a schema."""

    def __init__(self, roots: list[type[BaseModel]], title: str, examples: dict[str, Any] | None) -> None:
        self.roots = roots
        self.title = title
        self.has_examples = examples is not None
        self.examples = examples or {}
        self.blocks = find_blocks(roots)

    def write(self) -> Iterator[Section]:
        """Yield all sections, page after page."""
        for model in self.roots:
            text = f"{_sentence(prose(model))}\n\n{self._table(model, '')}"
            title, anchor = self.title, "keys"
            if len(self.roots) > 1:
                word = str(get_args(model.model_fields["simulation"].annotation)[0])
                title, anchor = f"`simulation: {word}`", joined_anchor("keys", word)
            yield Section(_INDEX, anchor, 1, title, text.strip())
        for page in dict.fromkeys(block.page for block in self.blocks.values()):
            here = [block for block in self.blocks.values() if block.page == page]
            for block in here:
                if block.is_page:
                    yield from self._block(block, 1)
            for block in here:
                if not block.is_page and block.only_owner is None:
                    yield from self._block(block, 2)

    def _block(self, block: Block, level: int) -> Iterator[Section]:
        title = f"`{block.key}`" if block.name == block.key else block.name.capitalize()
        if block.prefix and block.is_page:
            title += f" of `{block.prefix[:-1]}`"
        if not block.forms:
            model = block.expected.base
            about = prose(model) or ("" if block.has_several_keys else block.about)
            text = [_sentence(about), self._table(model, "")]
            yield self._with_example(block, block.anchor, level, title, text, model, "")
            yield from self._nested(model, level + 1)
            return
        yield Section(block.page, block.anchor, level, title, self._overview(block))
        for form in block.forms:
            text = [_sentence(form.about), _sentence(prose(form.model)) if form.tag else ""]
            text.append(self._table(form.model, form.tag))
            anchor = block.form_anchor(form)
            yield self._with_example(block, anchor, level + 1, form.title, text, form.model, form.tag)
            yield from self._nested(form.model, level + 2)

    def _nested(self, model: type[BaseModel], level: int) -> Iterator[Section]:
        for block in self.blocks.values():
            if block.only_owner is model and not block.is_page:
                yield from self._block(block, level)

    def _overview(self, block: Block) -> str:
        forms = block.forms
        about = _sentence(block.about)
        for tag in sorted({form.tag for form in forms if form.tag}):
            left_out = [
                f"; left out, it is `{form.words[0]}`" for form in forms if form.tag == tag and form.may_be_left_out
            ]
            about += f" The key `{tag}` says which form is meant{''.join(left_out)}."
        texts = [
            member for member in map(take_apart, union_members(block.expected.base)) if not holds_models(member.base)
        ]
        rows = [f"| {type_in_words(member, self._link)} | as it stands |" for member in texts]
        rows += [f"| [{form.title}](#{block.form_anchor(form)}) | {cell(form.about)} |" for form in forms]
        return "\n".join([about, "", "| form | what it is |", "|---|---|", *rows])

    def _with_example(
        self, block: Block, anchor: str, level: int, title: str, text: list[str], model: type[BaseModel], tag: str
    ) -> Section:
        if not self.has_examples:
            return Section(block.page, anchor, level, title, "\n\n".join(filter(None, text)), block, model)
        data = self.examples.get(anchor)
        if data is None:
            data = example_of(model, tag, self._neighbours(block))
        text = [*text, f"```yaml\n{block_in_yaml(block.key, block.holder, data)}\n```"]
        return Section(block.page, anchor, level, title, "\n\n".join(filter(None, text)), block, model, data)

    def _neighbours(self, block: Block) -> dict[str, Any]:
        """Values that the examples of a block's forms give to keys; of several, the first one's."""
        found: dict[str, Any] = {}
        for form in block.forms:
            for key, value in self.examples.get(block.form_anchor(form), {}).items():
                found.setdefault(key, value)
        return found

    def _table(self, model: type[BaseModel], tag: str) -> str:
        fields = sorted(fields_of(model).items(), key=lambda field: _rank(model, *field))
        rows = [
            f"| `{key}` | {type_in_words(take_apart(info), self._link)} | {default_in_words(info)} "
            f"| {cell(info.description or '')} |"
            for key, info in fields
            if key != tag
        ]
        if not rows:
            return "It has no further keys."
        return "\n".join(["| key | value | default | |", "|---|---|---|---|", *rows])

    def _link(self, base: Any) -> str:
        block = self.blocks[base]
        return f"[`{block.name}`](#{block.anchor})"


def _sentence(text: str) -> str:
    """A description as a sentence of its own; empty stays empty."""
    return f"{cell(text[:1].upper() + text[1:]).removesuffix('.')}." if text else ""


def _rank(model: type[BaseModel], key: str, info: FieldInfo) -> tuple[bool, bool]:
    """Keys that have to be given come first, those that a model shares with others last; else as they are written."""
    return not info.is_required(), key not in inspect.get_annotations(model)
