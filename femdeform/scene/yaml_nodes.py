"""YAML text to a tree of nodes with their lines, by the core schema of YAML 1.2."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from femdeform.scene.key_path import quoted

MAX_DEPTH = 32

_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_NULL = {"", "~", "null", "Null", "NULL"}
_BOOL = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_CORE_TAG = "tag:yaml.org,2002:"
_CORE_TYPES: dict[str, type | tuple[type, ...]] = {
    "null": type(None),
    "bool": bool,
    "int": int,
    "float": (int, float),
    "str": str,
}
# Characters that no scene needs and that would break a line or cannot be printed.
FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\u2028\u2029\ufffe\uffff]")


@dataclass
class Node:
    line: int


@dataclass
class Scalar(Node):
    value: Any
    problem: str = ""


@dataclass
class ListNode(Node):
    items: list[Node] = field(default_factory=list)
    is_open: bool = True
    problem: str = ""


@dataclass
class MappingNode(Node):
    # Keys with the line they stand in; a key that is not text stays a node and is reported later.
    items: list[tuple[Node, Node]] = field(default_factory=list)
    key: Node | None = None
    is_open: bool = True
    problem: str = ""


@dataclass
class Alias(Node):
    name: str
    target: Node | None
    problem: str = ""


class UnreadableError(Exception):
    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line


class Composer:
    """Builds the node tree from parser events, without recursion and with limited depth."""

    def __init__(self) -> None:
        self.root: Node | None = None
        self._stack: list[ListNode | MappingNode] = []
        self._anchors: dict[str, Node] = {}
        self._documents = 0

    def feed(self, event: Any) -> None:
        kind = type(event).__name__
        line = event.start_mark.line + 1
        if kind == "DocumentStartEvent":
            self._documents += 1
            if self._documents > 1:
                raise UnreadableError(line, "holds a second document (`---`); a scene is one document")
            if event.version and tuple(event.version) < (1, 2):
                raise UnreadableError(line, "asks for an older YAML; scenes are YAML 1.2")
        elif kind == "ScalarEvent":
            value, problem = _resolve(event)
            self._add(Scalar(line, value, problem), event.anchor)
        elif kind == "AliasEvent":
            self._add(_alias(line, event.anchor, self._anchors.get(event.anchor)), None)
        elif kind in ("SequenceStartEvent", "MappingStartEvent"):
            is_list = kind == "SequenceStartEvent"
            node: ListNode | MappingNode = ListNode(line) if is_list else MappingNode(line)
            expected = "seq" if is_list else "map"
            if event.tag not in (None, "!", _CORE_TAG + expected):
                node.problem = f"the tag {_shown_tag(event.tag)} is not allowed"
            self._add(node, event.anchor)
            self._stack.append(node)
            if len(self._stack) > MAX_DEPTH:
                raise UnreadableError(line, f"is nested more than {MAX_DEPTH} levels deep")
        elif kind in ("SequenceEndEvent", "MappingEndEvent"):
            self._stack.pop().is_open = False

    def _add(self, node: Node, anchor: str | None) -> None:
        if anchor is not None:
            self._anchors[anchor] = node
        if not self._stack:
            self.root = node
            return
        parent = self._stack[-1]
        if isinstance(parent, ListNode):
            parent.items.append(node)
        elif parent.key is None:
            parent.key = node
        else:
            parent.items.append((parent.key, node))
            parent.key = None


def _alias(line: int, name: str, target: Node | None) -> Alias:
    if target is None:
        return Alias(line, name, None, f"the alias *{one_line(name)} has no anchor &{one_line(name)} before it")
    if isinstance(target, (ListNode, MappingNode)) and target.is_open:
        return Alias(line, name, None, f"the alias *{one_line(name)} stands inside what it repeats")
    return Alias(line, name, target)


def _resolve(event: Any) -> tuple[Any, str]:
    """Value of a scalar by the core schema, and what is wrong with it (empty if nothing)."""
    text: str = event.value
    is_plain = event.style in (None, "") and event.tag in (None, "!")
    if event.tag is not None and event.tag != "!":
        return _resolve_tagged(str(event.tag), text)
    if event.tag == "!" or not is_plain:
        return (text, "") if not FORBIDDEN.search(text) else (None, "holds a character that is not allowed")
    return _resolve_plain(text)


def _resolve_plain(text: str) -> tuple[Any, str]:
    if text in _NULL:
        return None, ""
    if text in _BOOL:
        return _BOOL[text], ""
    if _INT.fullmatch(text):
        return _integer(text)
    if _FLOAT.fullmatch(text):
        number = float(text)
        return (
            (number, "") if math.isfinite(number) else (None, "is too large for a number; the limit is about 1.8e308")
        )
    if _NOT_FINITE.fullmatch(text):
        return None, f"must be a finite number, not {text}"
    return text, ""


def _integer(text: str) -> tuple[Any, str]:
    # 400 digits are beyond every float, and Python refuses to convert very long ones.
    if len(text) > 400:
        return None, "is too large for a number; the limit is about 1.8e308"
    number = int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))
    if abs(number) < 2**63:
        return number, ""
    try:
        return float(number), ""
    except OverflowError:
        return None, "is too large for a number; the limit is about 1.8e308"


def _shown_tag(tag: object) -> str:
    text = str(tag)
    return one_line("!!" + text.removeprefix(_CORE_TAG) if text.startswith(_CORE_TAG) else text)


def _resolve_tagged(tag: str, text: str) -> tuple[Any, str]:
    name = tag.removeprefix(_CORE_TAG)
    if name == tag or name not in _CORE_TYPES:
        return None, f"the tag {_shown_tag(tag)} is not allowed"
    if name == "str":
        return (text, "") if not FORBIDDEN.search(text) else (None, "holds a character that is not allowed")
    value, problem = _resolve_plain(text)
    if not problem and (not isinstance(value, _CORE_TYPES[name]) or (isinstance(value, bool) and name != "bool")):
        return None, f"{quoted(text)} does not fit its tag !!{name}"
    return (float(value) if name == "float" and not problem else value), problem


def events(text: str) -> Iterator[Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    lines = text.count("\n") + 1
    try:
        yield from YAML(typ="safe", pure=True).parse(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise UnreadableError(min(mark.line + 1, lines) if mark else 1, _syntax_message(error)) from None
    except YAMLError as error:
        raise UnreadableError(1, f"is not valid YAML: {one_line(str(error))}") from None
    except (
        ArithmeticError,
        AssertionError,
        AttributeError,
        LookupError,
        NotImplementedError,
        TypeError,
        ValueError,
    ):
        # The parser trips over some malformed directives and tags instead of reporting them.
        raise UnreadableError(1, "is not valid YAML: a directive, tag or escape in it is malformed") from None


def _syntax_message(error: Any) -> str:
    problem = one_line(error.problem or error.context or "syntax error")
    if "'\\t'" in problem:
        return "is not valid YAML: a tab cannot stand here; indent and separate with spaces"
    if problem == "mapping values are not allowed here":
        return "is not valid YAML: unexpected `:`; is the indentation right, or a text with `:` unquoted?"
    context = error.context_mark
    if context is not None and error.context and error.problem_mark and context.line != error.problem_mark.line:
        begin = f"{one_line(error.context)} that starts in line {context.line + 1}"
        return f"is not valid YAML: {problem} ({begin})"
    return f"is not valid YAML: {problem}"


def one_line(text: str) -> str:
    shortened = " ".join(text.split())[:160]
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in shortened)
