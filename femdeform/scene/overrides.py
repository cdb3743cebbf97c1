"""Changes to a scene from the command line: ``--set bodies.beam.material.density=900``."""

from __future__ import annotations

import copy
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from femdeform.errors import Fault
from femdeform.scene.document import Document, parse_value
from femdeform.scene.key_path import KeyPath, format_key, quoted
from femdeform.scene.yaml_nodes import MAX_DEPTH

_PART = re.compile(r"\.?(?:\[(?P<index>[0-9]{1,9})\]|\"(?P<quoted>[^\"]+)\"|(?P<name>[^.\[\]=\"]+))")


@dataclass(frozen=True)
class Override:
    """One parsed override.

    Attributes
    ----------
    text : str
        As the user gave it, ``key=value``.
    path : tuple of str or int
        The key; a number written between dots stays text until it meets a list.
    value : Any
        The value, parsed as YAML.
    """

    text: str
    path: KeyPath
    value: Any

    @property
    def source(self) -> str:
        """What stands in the place of ``file:line`` in a fault."""
        return f"--set {shortened(self.text)}"


def shortened(text: str) -> str:
    """An override on one line, not too long for a message."""
    return quoted(text, limit=80)[1:-1].replace('\\"', '"')


def parse_override(text: str) -> tuple[Override | None, list[Fault]]:
    """Split ``key=value``; the faults say why it cannot be read."""
    source = f"--set {shortened(text)}"
    key, equals, value = text.partition("=")
    key = key.strip()
    if not equals or not key:
        return None, [Fault(source, 0, "", "must be key=value, for example time.dt=0.01 or conditions[0].rate=2")]
    path = _parse_key(key)
    if path is None:
        return None, [Fault(source, 0, "", f"{quoted(key)} is not a key; keys look like bodies.beam.material.density")]
    document: Document = parse_value(value)
    faults = [Fault(source, 0, format_key(path + fault.path), fault.message) for fault in document.faults]
    return (None, faults) if faults else (Override(text, path, document.data), [])


def _parse_key(text: str) -> KeyPath | None:
    path: list[str | int] = []
    position = 0
    while position < len(text):
        match = _PART.match(text, position)
        if match is None or (position == 0 and text[0] == ".") or len(path) >= MAX_DEPTH:
            return None
        # After the first part a name needs its dot; an index needs none.
        if position > 0 and match["index"] is None and text[position] != ".":
            return None
        path.append(int(match["index"]) if match["index"] is not None else match["name"] or match["quoted"])
        position = match.end()
    return tuple(path) or None


def apply_overrides(data: Any, texts: Sequence[str]) -> tuple[Any, dict[KeyPath, Override], list[Fault]]:
    """Apply overrides in order to plain data.

    Parameters
    ----------
    data : Any
        Plain data of the file; it is not changed.
    texts : sequence of str
        Each ``key=value``.

    Returns
    -------
    data : Any
        A changed copy.
    origins : dict of path to Override
        What each changed or created value came from.
    faults : list of Fault
        Overrides that cannot be read or applied.
    """
    result = copy.deepcopy(data)
    origins: dict[KeyPath, Override] = {}
    faults: list[Fault] = []
    for text in texts:
        override, problems = parse_override(text)
        faults += problems
        if override is not None:
            problem = _apply(result, override, origins)
            if problem:
                faults.append(Fault(override.source, 0, format_key(override.path), problem))
    return result, origins, faults


def _apply(data: Any, override: Override, origins: dict[KeyPath, Override]) -> str:
    """Set one value in place; returns what is in the way, or an empty text."""
    here: KeyPath = ()
    target = data
    for part in override.path[:-1]:
        step, problem = _step(target, part, here)
        if problem:
            return problem
        here = (*here, step)
        if isinstance(target, dict) and target.get(step) is None:
            # A block that the file leaves out is created, so that time.dt=1 needs no `time:` there.
            target[step] = {}
            origins[here] = override
        target = target[step]
    last, problem = _step(target, override.path[-1], here)
    if problem:
        return problem
    target[last] = override.value
    here = (*here, last)
    for changed in [path for path in origins if path[: len(here)] == here]:
        del origins[changed]
    origins[here] = override
    return ""


def _step(target: Any, part: str | int, here: KeyPath) -> tuple[Any, str]:
    name = f"`{format_key(here)}`" if here else "the scene"
    if isinstance(target, dict):
        return (part, "") if isinstance(part, str) else (None, f"{name} is a mapping, not a list")
    if isinstance(target, list):
        index = int(part) if isinstance(part, str) and part.isascii() and part.isdigit() and len(part) < 10 else part
        if not isinstance(index, int):
            return None, f"{name} is a list; give an index, as in {format_key((*here, 0))}"
        if index >= len(target):
            count = f"{len(target)} entries" if len(target) != 1 else "1 entry"
            return None, f"{name} has {count}; the first is [0]"
        return index, ""
    return None, f"{name} is a single value, it has no key {format_key((part,))}"
