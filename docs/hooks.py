"""Pages that MkDocs makes while it builds: the references, the map of the code and the verification cases.

They are written from the schema, the parser of the command line, the presets, the docstrings and the READMEs of the
cases, so that they cannot fall behind them.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGES = ("femdeform", "solvers", "meshes", "verification")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the generated pages in the place of the entries of the navigation that end in a slash."""
    config.nav = _filled(config.nav, generated_pages())
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages to those of docs/."""
    for path, text in generated_pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def _filled(entry: Any, pages: dict[str, str]) -> Any:
    if isinstance(entry, list):
        return [_filled(item, pages) for item in entry]
    if isinstance(entry, dict):
        return {title: _filled(item, pages) for title, item in entry.items()}
    if isinstance(entry, str) and entry.endswith("/"):
        return [path for path in pages if path.startswith(entry)]
    return entry


def generated_pages() -> dict[str, str]:
    """Markdown of every generated page by its path below docs/."""
    from femdeform.scene.batch_schema import Study
    from femdeform.scene.comparison_schema import ComparisonFile
    from femdeform.scene.reference import scene_pages, schema_markdown
    from verification.study_schema import StudyFile

    return {
        **{f"reference/scene/{name}.md": text for name, text in scene_pages().items()},
        "reference/batch.md": schema_markdown(Study, "The keys of a batch"),
        "reference/comparison.md": schema_markdown(ComparisonFile, "The keys of a comparison"),
        "reference/study.md": schema_markdown(StudyFile, "The keys of a study"),
        "reference/commands.md": commands_page(),
        "reference/presets.md": presets_page(),
        "reference/code.md": code_page(),
        **{f"cases/{name}.md": text for name, text in case_pages().items()},
    }


# ------------------------------------------------------------------------------------------------ command line


def commands_page() -> str:
    """Reference of the command line, from its parser."""
    from femdeform.cli import build_parser

    return "\n".join(["# Command line\n", *_command(build_parser(), 1)])


def _command(parser: argparse.ArgumentParser, level: int) -> Iterator[str]:
    parser.formatter_class = lambda prog: argparse.RawDescriptionHelpFormatter(prog, width=100)
    if level > 1:
        yield f"{'#' * level} `{parser.prog}`\n"
    yield f"{parser.description}\n"
    yield f"```text\n{parser.format_usage().removeprefix('usage: ').rstrip()}\n```\n"
    inner: dict[str, argparse.ArgumentParser] = {}
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            inner = action.choices
        elif not isinstance(action, argparse._HelpAction):
            rows.append(f"| `{_name(action)}` | {_cell(action.help or '')} |")
    if rows:
        yield "\n".join(["| argument | |", "|---|---|", *rows]) + "\n"
    yield _epilog(parser.epilog or "")
    for command in inner.values():
        yield from _command(command, level + 1)


def _name(action: argparse.Action) -> str:
    metavar = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
    if not action.option_strings:
        return metavar + (" ..." if action.nargs in ("+", "*") else "")
    names = ", ".join(action.option_strings)
    return names if action.nargs == 0 else f"{names} {metavar}"


def _epilog(text: str) -> str:
    """Plain text of a help page as Markdown: what is indented is code, what ends in a colon announces it."""
    parts = []
    for is_code, lines in _runs(text.splitlines()):
        body = "\n".join(lines).strip("\n")
        if body:
            parts.append(f"```text\n{_dedented(body)}\n```" if is_code else _sentences(body))
    return "\n\n".join(parts) + "\n"


def _runs(lines: list[str]) -> Iterator[tuple[bool, list[str]]]:
    run: list[str] = []
    is_code = False
    for line in lines:
        if line.strip() and line.startswith(" ") != is_code:
            yield is_code, run
            run, is_code = [], line.startswith(" ")
        run.append(line)
    yield is_code, run


def _sentences(text: str) -> str:
    return "\n\n".join(part[0].upper() + part[1:] for part in re.split(r"\n\n+", text))


def _dedented(text: str) -> str:
    return "\n".join(line.removeprefix("  ") for line in text.splitlines())


# ------------------------------------------------------------------------------------------------ presets


def presets_page() -> str:
    """Reference of the presets: their files, the comment at the top as text."""
    parts = [
        "# Linear solver presets\n",
        "`linear_solver: {preset: NAME}` takes one of these files of `solvers/presets`; `options` beside it adds or "
        "replaces single PETSc options. Which one to take is on the page about "
        "[linear solvers](../methods/linear-solvers.md).\n",
    ]
    for path in sorted((REPOSITORY / "solvers" / "presets").glob("*.yaml")):
        lines = path.read_text(encoding="utf-8").splitlines()
        n_comments = next(i for i, line in enumerate(lines) if not line.startswith("#"))
        about = " ".join(line.removeprefix("#").strip() for line in lines[:n_comments])
        about = re.sub(r"docs/([\w/-]+)\.md", r"[\1](../\1.md)", about)
        code = "\n".join(lines[n_comments:]).strip()
        parts.append(f"## {path.stem}\n\n{about}\n\n```yaml\n{code}\n```\n")
    return "\n".join(parts)


# ------------------------------------------------------------------------------------------------ the code


def code_page() -> str:
    """Map of the code: every module with the first sentence of its docstring and its public names."""
    parts = [
        "# Map of the code\n",
        "Every module with what it is for and the names that others use. The docstrings in the code say which "
        "arguments they take, in which shapes and units.\n",
    ]
    for folder in (folder for name in PACKAGES for folder in _folders(REPOSITORY / name)):
        rows = []
        for path in sorted(folder.glob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            names = ", ".join(f"`{name}`" for name in _public_names(tree))
            if path.name == "__init__.py":
                parts.append(f"## {folder.relative_to(REPOSITORY)}\n\n{_cell(_first_sentence(tree))}\n")
            if path.name != "__init__.py" or names:
                rows.append(f"| `{path.stem}` | {_cell(_first_sentence(tree))} | {names} |")
        if rows:
            parts.append("\n".join(["| module | what it is for | public names |", "|---|---|---|", *rows, ""]))
    return "\n".join(parts)


def _folders(package: Path) -> list[Path]:
    return sorted(path.parent for path in package.rglob("__init__.py"))


def _first_sentence(tree: ast.Module) -> str:
    text = " ".join((ast.get_docstring(tree) or "").replace("``", "`").split())
    return re.split(r"(?<=\.)\s", text, maxsplit=1)[0].removesuffix(".")


def _public_names(tree: ast.Module) -> list[str]:
    kinds = (ast.ClassDef, ast.FunctionDef)
    names = [node.name for node in tree.body if isinstance(node, kinds) and not node.name.startswith("_")]
    return list(dict.fromkeys(names))  # an overloaded function has its name several times


# ------------------------------------------------------------------------------------------------ cases


def case_pages() -> dict[str, str]:
    """The READMEs of the verification cases; links to other cases stay, those to files become their text."""
    pages = {}
    for path in sorted((REPOSITORY / "verification" / "cases").glob("*/README.md")):

        def target(found: re.Match[str], folder: Path = path.parent) -> str:
            text, link = found[1], found[2]
            if "://" in link or link.startswith("#"):
                return found[0]
            other = (folder / link).resolve()
            if other.name == "README.md" and other.parent.parent == folder.parent:
                return f"[{text}]({other.parent.name}.md)"
            return text

        pages[path.parent.name] = re.sub(r"(?<!!)\[([^\]\n]+)\]\(([^)\s]+)\)", target, path.read_text(encoding="utf-8"))
    return pages


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")
