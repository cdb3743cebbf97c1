"""Text of a scene file to plain data, with the line of every key and every fault of the text itself.

The scalars follow the core schema of YAML 1.2: `yes`, `no`, `on`, `off` are text, `1e6` is a number. Of
YAML's rarer features, anchors and aliases work (a material can be shared), within limits; tags other than the
core ones, merge keys and several documents in one file are refused. Nothing but lists, mappings with text
keys, text, finite numbers, booleans and null ever leaves this module.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from femdeform.scene.key_path import KeyPath
from femdeform.scene.yaml_nodes import (
    FORBIDDEN,
    MAX_DEPTH,
    Alias,
    Composer,
    ListNode,
    MappingNode,
    Node,
    Scalar,
    UnreadableError,
    events,
)

MAX_BYTES = 16 * 1024 * 1024
# Values that aliases may add by repetition; what is written out in the file is not limited.
MAX_ALIASED_VALUES = 10_000


@dataclass(frozen=True)
class TextFault:
    """A fault of the text, before anything is known about what the keys mean.

    `hides` says that the value at `path` is only a placeholder, about which nothing further can be said.
    """

    path: KeyPath
    line: int
    message: str
    hides: bool = False


@dataclass(frozen=True)
class Document:
    """Plain data of one YAML document.

    Attributes
    ----------
    data : Any
        Lists, dicts with text keys, text, finite numbers, booleans and None; None if unreadable.
    lines : dict of path to int
        1-based line of every key and list item.
    faults : tuple of TextFault
        Everything wrong with the text.
    readable : bool
        False if nothing can be said about the content (a syntax error, an empty file).
    """

    data: Any
    lines: dict[KeyPath, int]
    faults: tuple[TextFault, ...]
    readable: bool = True


def read_document(path: Path, kind: str = "scene") -> Document:
    """Read a file; whatever is wrong with it is in the `faults` of the result, nothing is raised.

    Parameters
    ----------
    path : Path
        The file.
    kind : str
        What it is a file of, for messages.
    """
    try:
        if path.is_dir():
            return _unreadable(0, f"is a folder, not a {kind} file")
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return _unreadable(0, "there is no such file")
    except (OSError, ValueError) as error:
        return _unreadable(0, f"cannot be read: {getattr(error, 'strerror', None) or error}")
    if len(raw) > MAX_BYTES:
        return _unreadable(
            0, f"is larger than {MAX_BYTES // 2**20} MiB; a scene names its meshes, it does not hold them"
        )
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return _unreadable(1, "is UTF-16 text; save it as UTF-8")
    if b"\x00" in raw:
        return _unreadable(raw[: raw.index(b"\x00")].count(b"\n") + 1, "is not a text file (it holds a zero byte)")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        return _unreadable(line, f"is not UTF-8 text (byte 0x{raw[error.start]:02x})")
    return parse_document(text, kind)


def parse_document(text: str, kind: str = "scene") -> Document:
    """Parse YAML text; whatever is wrong with it is in the `faults` of the result, nothing is raised."""
    document = parse_value(text)
    if document.readable and document.data is None and not document.faults:
        return _unreadable(1, f"is empty; a {kind} is a mapping that starts with `schema_version: 1`")
    return document


def parse_value(text: str) -> Document:
    """Parse one value, as in ``--set key=value``; empty text is null."""
    for number, content in enumerate(text.split("\n"), start=1):
        forbidden = FORBIDDEN.search(content)
        if forbidden:
            return _unreadable(number, f"the character U+{ord(forbidden[0]):04X} is not allowed")
    composer = Composer()
    try:
        for event in events(text):
            composer.feed(event)
    except UnreadableError as error:
        faults = [TextFault((), error.line, str(error))]
        if composer.root is not None:
            # What was read before the syntax error may hold faults of its own; its content is not judged.
            faults = [*_Extraction().of(composer.root).faults, *faults]
        return Document(None, {}, tuple(faults), readable=False)
    if composer.root is None:
        return Document(None, {}, ())
    return _Extraction().of(composer.root)


def _unreadable(line: int, message: str) -> Document:
    return Document(None, {}, (TextFault((), line, message),), readable=False)


class _Extraction:
    """Turns the node tree into plain data, lines and faults; aliases are repeated in full, within limits."""

    def __init__(self) -> None:
        self._lines: dict[KeyPath, int] = {}
        self._faults: list[TextFault] = []
        self._aliased = 0
        self._alias_depth = 0

    def of(self, root: Node) -> Document:
        data = self._plain(root, ())
        return Document(data, self._lines, tuple(self._faults), readable=True)

    def _fault(self, path: KeyPath, line: int, message: str, hides: bool = False) -> None:
        self._faults.append(TextFault(path, line, message, hides))

    def _plain(self, node: Node, path: KeyPath) -> Any:
        problem = getattr(node, "problem", "")
        if problem:
            self._fault(path, node.line, problem, hides=True)
            return None
        if isinstance(node, Alias):
            assert node.target is not None
            self._alias_depth += 1
            value = self._plain(node.target, path)
            self._alias_depth -= 1
            return value
        if self._alias_depth:
            self._aliased += 1
            if self._aliased > MAX_ALIASED_VALUES:
                if self._aliased == MAX_ALIASED_VALUES + 1:
                    # Everything after this is cut short, so nothing else of the file can be judged.
                    self._fault((), node.line, f"aliases repeat more than {MAX_ALIASED_VALUES} values", hides=True)
                return None
        if len(path) > MAX_DEPTH:
            self._fault(path[:1], node.line, f"aliases nest more than {MAX_DEPTH} levels deep", hides=True)
            return None
        if isinstance(node, Scalar):
            return node.value
        if isinstance(node, ListNode):
            items = []
            for index, item in enumerate(node.items):
                self._lines[(*path, index)] = item.line
                items.append(self._plain(item, (*path, index)))
            return items
        assert isinstance(node, MappingNode)
        return self._plain_mapping(node, path)

    def _plain_mapping(self, node: MappingNode, path: KeyPath) -> dict[str, Any]:
        result: dict[str, Any] = {}
        first_line: dict[str, int] = {}
        for key_node, value_node in node.items:
            key = self._key(key_node, path)
            if key is None:
                continue
            if key in result:
                self._fault((*path, key), key_node.line, f"is given twice; first in line {first_line[key]}")
                continue
            first_line[key] = key_node.line
            self._lines[(*path, key)] = key_node.line
            result[key] = self._plain(value_node, (*path, key))
        return result

    def _key(self, node: Node, path: KeyPath) -> str | None:
        if not isinstance(node, Scalar):
            self._fault(path, node.line, "a key must be plain text, not a list, mapping or alias")
        elif node.problem:
            self._fault(path, node.line, f"a key {node.problem}")
        elif not isinstance(node.value, str):
            word = json.dumps(node.value)
            self._fault(path, node.line, f'the key {word} is not text; names are text, in quotes if need be: "{word}"')
        elif node.value == "<<":
            message = "merge keys (`<<`) are not part of YAML 1.2; write the keys out"
            self._fault(path, node.line, message, hides=True)
        else:
            return node.value
        return None
