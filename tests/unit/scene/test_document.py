"""Text to plain data: scalars of YAML 1.2, lines, aliases, and files that are no text at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from femdeform.scene.document import parse_document, parse_value, read_document
from femdeform.scene.key_path import format_key, quoted


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("-12", -12),
        ("+3", 3),
        ("0o17", 15),
        ("0xfF", 255),
        ("017", 17),
        ("1.5", 1.5),
        ("1.", 1.0),
        (".5", 0.5),
        ("1e6", 1.0e6),
        ("-1.25E-3", -1.25e-3),
        ("99999999999999999999", 1.0e20),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("yes", "yes"),
        ("off", "off"),
        ("1_000", "1_000"),
        ("1:30", "1:30"),
        ("2024-01-01", "2024-01-01"),
        ("'1'", "1"),
        ('"true"', "true"),
        ("!!str 1", "1"),
        ("!!float 1", 1.0),
        ("!!int 2", 2),
        ("! 3", "3"),
        ("[1, two, [3.0]]", [1, "two", [3.0]]),
        ("{a: 1, b: {c: []}}", {"a": 1, "b": {"c": []}}),
    ],
)
def test_scalars_follow_the_core_schema(text: str, value: object) -> None:
    document = parse_value(text)
    assert document.faults == ()
    assert document.data == value
    assert type(document.data) is type(value)


def test_lines_of_keys_and_items() -> None:
    text = "a: 1\nb:\n  - x\n  - {c: 2,\n     d: 3}\n\ne: >\n  long\n  text\nf: 4\n"
    lines = parse_document(text).lines
    assert lines[("a",)] == 1
    assert lines[("b",)] == 2
    assert lines[("b", 0)] == 3
    assert lines[("b", 1)] == 4
    assert lines[("b", 1, "c")] == 4
    assert lines[("b", 1, "d")] == 5
    assert lines[("f",)] == 10


def test_an_alias_is_a_copy_with_the_lines_of_its_anchor() -> None:
    document = parse_document("a: &x\n  p: 1\nb: *x\nc: [*x, *x]\n")
    assert document.faults == ()
    assert document.data == {"a": {"p": 1}, "b": {"p": 1}, "c": [{"p": 1}, {"p": 1}]}
    assert document.data["b"] is not document.data["a"]
    assert document.lines[("b",)] == 3
    assert document.lines[("b", "p")] == 2


def test_many_values_written_out_are_no_bomb() -> None:
    document = parse_document("nodes: [" + "1, " * 11_000 + "1]\n")
    assert document.faults == ()
    assert len(document.data["nodes"]) == 11_001


def test_aliases_may_repeat_a_list_only_so_often() -> None:
    items = ", ".join(["1"] * 1000)
    assert parse_document(f"a: &a [{items}]\nb: [*a, *a, *a]\n").faults == ()
    bomb = parse_document(f"a: &a [{items}]\nb: [{', '.join(['*a'] * 20)}]\n")
    assert [fault.message for fault in bomb.faults] == ["aliases repeat more than 10000 values"]


def test_a_chain_of_aliases_cannot_nest_without_end() -> None:
    chain = "a0: &a0 [x]\n" + "".join(f"a{i + 1}: &a{i + 1} [*a{i}]\n" for i in range(60))
    messages = {fault.message for fault in parse_document(chain).faults}
    assert messages == {"aliases nest more than 32 levels deep"}


@pytest.mark.parametrize(
    ("raw", "line", "message"),
    [
        (b"", 1, "is empty; a scene is a mapping that starts with `schema_version: 1`"),
        (b"\n# nothing\n", 1, "is empty; a scene is a mapping that starts with `schema_version: 1`"),
        (b"a: 1\nb: \xff\n", 2, "is not UTF-8 text (byte 0xff)"),
        (b"a: 1\n\nb: \xc3\x28\n", 3, "is not UTF-8 text (byte 0xc3)"),
        ("a: 1\n".encode("utf-16"), 1, "is UTF-16 text; save it as UTF-8"),
        (b"a: 1\nb: \x00\n", 2, "is not a text file (it holds a zero byte)"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", 3, "is not a text file (it holds a zero byte)"),
        (b"a: \x1b[31m\n", 1, "the character U+001B is not allowed"),
        ("a: b\u2028c\n".encode(), 1, "the character U+2028 is not allowed"),
        (b"%TAG ! x\n---\na: !b 1\n", 3, "a: the tag xb is not allowed"),
        (b"%YAML 3.0\n---\na: 1\n", 1, "is not valid YAML: found incompatible YAML document (version 1.* is required)"),
    ],
)
def test_what_is_not_a_document(tmp_path: Path, raw: bytes, line: int, message: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_bytes(raw)
    (fault,) = read_document(path).faults
    text = ": ".join(part for part in (format_key(fault.path), fault.message) if part)
    assert (fault.line, text) == (line, message)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    def message(path: Path) -> str:
        (fault,) = read_document(path).faults
        assert fault.line == 0
        return fault.message

    assert message(tmp_path / "none.yaml") == "there is no such file"
    assert message(tmp_path) == "is a folder, not a scene file"
    assert message(tmp_path / "a\0b").startswith("cannot be read: ")
    assert message(tmp_path / ("x" * 300)).startswith("cannot be read: ")
    large = tmp_path / "large.yaml"
    with large.open("wb") as stream:
        stream.truncate(17 * 2**20)
    assert message(large) == "is larger than 16 MiB; a scene names its meshes, it does not hold them"


def test_byte_order_mark_and_line_ends_of_windows(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\r\nb:\r\n  c: 2\r\n")
    document = read_document(path)
    assert document.faults == ()
    assert document.data == {"a": 1, "b": {"c": 2}}
    assert document.lines[("b", "c")] == 3


def test_quoted_text_is_short_and_on_one_line() -> None:
    assert quoted("a") == '"a"'
    assert quoted('say "x"\n') == r'"say \"x\"\n"'
    assert quoted("\u200b\ud800") == r'"\u200b\ud800"'
    assert len(quoted("x" * 1000)) == 42


def test_formatted_keys() -> None:
    assert format_key(("bodies", "beam", "mesh")) == "bodies.beam.mesh"
    assert format_key(("conditions", 1, "on")) == "conditions[1].on"
    assert format_key(("a b", 0, 1, "é")) == '"a b"[0][1].é'
    assert format_key(()) == ""
