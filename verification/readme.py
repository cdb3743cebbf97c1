"""The README of a case as HTML: headings, paragraphs, lists, tables and blocks of text; formulas stay as they are."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from html import escape

_HEADING = re.compile(r"(#{1,6})\s+(.*?)\s*#*$")
_ITEM = re.compile(r"\s{0,3}(?:[-*+]|\d+[.)])\s+(.*)")
_RULE = re.compile(r"\|?\s*:?-+:?\s*(\|\s*:?-+:?\s*)*\|?")


def render_readme(text: str) -> str:
    """Turn Markdown into HTML.

    Parameters
    ----------
    text : str
        Of it, only what the READMEs of cases use is understood; anything else stays as it was written.

    Returns
    -------
    str
        HTML; headings start at level 3.
    """
    return "\n".join(_blocks(text.expandtabs(4).splitlines()))


def _blocks(lines: list[str]) -> Iterator[str]:
    k = 0
    while k < len(lines):
        begin = k
        line = lines[k]
        if not line.strip():
            k += 1
            continue
        heading = _HEADING.match(line)
        if line.lstrip().startswith("```"):
            k = _end(lines, k + 1, lambda text: not text.lstrip().startswith("```"))
            yield _block(lines[begin + 1 : k])
            k += 1
        elif line.startswith("    "):
            k = _end(lines, k, lambda text: text.startswith("    ") or not text.strip())
            yield _block([text[4:] for text in lines[begin:k]])
        elif heading is not None:
            level = min(len(heading[1]) + 2, 6)
            yield f"<h{level}>{_inline(heading[2])}</h{level}>"
            k += 1
        elif line.lstrip().startswith("|"):
            k = _end(lines, k, lambda text: text.lstrip().startswith("|"))
            yield _table(lines[begin:k])
        elif _ITEM.match(line):
            k = _end(lines, k, lambda text: bool(text.strip()))
            yield _list(lines[begin:k])
        else:
            k = _end(lines, k + 1, lambda text: bool(text.strip()) and not text.lstrip().startswith(("|", "#", "```")))
            yield f"<p>{_inline(' '.join(text.strip() for text in lines[begin:k]))}</p>"


def _end(lines: list[str], start: int, inside: Callable[[str], bool]) -> int:
    """First line from a start that does not belong to the block any more."""
    k = start
    while k < len(lines) and inside(lines[k]):
        k += 1
    return k


def _block(lines: list[str]) -> str:
    return f"<pre>{escape(chr(10).join(lines).strip(chr(10)))}</pre>"


def _list(lines: list[str]) -> str:
    items: list[str] = []
    for line in lines:
        item = _ITEM.match(line)
        if item is not None:
            items.append(item[1])
        else:
            items[-1] += " " + line.strip()
    return "<ul>" + "".join(f"<li>{_inline(item)}</li>" for item in items) + "</ul>"


def _table(lines: list[str]) -> str:
    rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
    has_head = len(lines) > 1 and _RULE.fullmatch(lines[1].strip()) is not None
    html = []
    for number, row in enumerate(rows):
        if has_head and number == 1:
            continue
        tag = "th" if has_head and number == 0 else "td"
        html.append("<tr>" + "".join(f"<{tag}>{_inline(cell)}</{tag}>" for cell in row) + "</tr>")
    return "<table>" + "".join(html) + "</table>"


def _inline(text: str) -> str:
    """Code, emphasis and links; nothing in a README can become any other HTML."""
    parts = re.split(r"(`[^`]+`)", text)
    return "".join(
        f"<code>{escape(part[1:-1])}</code>" if part.startswith("`") and len(part) > 2 else _emphasis(escape(part))
        for part in parts
    )


def _emphasis(text: str) -> str:
    text = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", text)
    # Addresses that lead out of the page are shown as text: the page asks for nothing.
    return re.sub(r"\[([^\]]+)\]\(([^)\s]+)\)", r"\1 (\2)", text)
