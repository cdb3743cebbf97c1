"""`femdeform compare`: from the arguments to the folder, the page and the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from femdeform.errors import NotConvergedError
from femdeform.post.compare_page import PAGE, drawn_files, write_drawings
from femdeform.run.compare import Plan, compare_prepared, require_one_rank
from femdeform.run.compare_output import abandon_folder, claim_folder, table_text, write_comparison
from femdeform.run.compare_variants import Variant, parse_variants, prepare
from femdeform.run.status_line import StatusLine
from femdeform.scene.comparison_schema import is_comparison, load_comparison


def compare_command(
    path: Path,
    asked: Mapping[str, Any],
    *,
    methods: str | None = None,
    option_sets: Sequence[str] = (),
    overrides: Sequence[str] = (),
    out: Path | None = None,
    quiet: bool = False,
) -> int:
    """Compare, write the folder, print the table.

    Parameters
    ----------
    path : Path
        Scene file, or comparison file.
    asked : mapping
        Fields of `Plan`, over those of a comparison file; None is not asked.
    methods : str, optional
        ``a,b,c``, words of methods.
    option_sets : sequence of str
        ``LABEL: key=value key=value`` each; they come after the variants of a comparison file.
    overrides : sequence of str
        ``key=value`` for all variants.
    out : Path, optional
        Folder; default ``results/compare-<name of the file>``.
    quiet : bool
        No progress and no notices.

    Returns
    -------
    int
        0, or 3 if every variant diverged.

    Raises
    ------
    FemdeformError
        On bad input, a reference that does not converge, or a folder that cannot be written.
    """
    require_one_rank()
    wanted = {name: value for name, value in asked.items() if value is not None}
    variants = parse_variants(methods, option_sets)
    folder = out if out is not None else Path("results") / f"compare-{path.stem}"
    title = ""
    if is_comparison(path):
        loaded = load_comparison(path)
        file, title = loaded.file, loaded.file.title
        path, overrides = loaded.scene_path, [*loaded.overrides, *overrides]
        variants = [*(Variant(label, options) for label, options in loaded.variants()), *variants]
        own = {name: getattr(file, name) for name in ("steps", "start_step", "repeat")}
        if "iterations" not in wanted and "seconds" not in wanted:
            own |= {"iterations": file.iterations, "seconds": file.seconds}
        wanted = own | wanted
    plan = Plan(**wanted)
    prepared = prepare(path, variants, overrides)
    plan.check(prepared.base.deformable)
    claim_folder(folder)
    try:
        with StatusLine(not quiet) as status:
            comparison = compare_prepared(prepared, plan, status)
            if title:
                comparison = replace(comparison, facts=comparison.facts | {"title": title})
            for text in comparison.notices:
                status.notice(f"note: {text}")
            status.show("writing tables and pictures")
            write_comparison(comparison, folder, drawn_files(plan.steps, is_split=bool(comparison.split_labels)))
            for text in write_drawings(comparison, folder):
                status.notice(f"note: {text}")
    except BaseException:
        abandon_folder(folder)
        raise
    print(f"{table_text(comparison)}\n\n{folder / PAGE}")
    return NotConvergedError.exit_code if comparison.all_diverged else 0
