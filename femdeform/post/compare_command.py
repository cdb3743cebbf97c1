"""`femdeform compare`: from the arguments to the folder, the page and the table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from femdeform.errors import NotConvergedError
from femdeform.post.compare_page import PAGE, drawn_files, write_drawings
from femdeform.run.compare import Plan, compare_prepared, require_one_rank
from femdeform.run.compare_output import abandon_folder, claim_folder, table_text, write_comparison
from femdeform.run.compare_variants import parse_variants, prepare
from femdeform.run.status_line import StatusLine


def compare_command(
    path: Path,
    plan: Plan,
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
        Scene file.
    plan : Plan
        Budget, steps and runs.
    methods : str, optional
        ``a,b,c``, words of methods.
    option_sets : sequence of str
        ``LABEL: key=value key=value`` each.
    overrides : sequence of str
        ``key=value`` for all variants.
    out : Path, optional
        Folder; default ``results/compare-<name of the scene>``.
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
    prepared = prepare(path, parse_variants(methods, option_sets), overrides)
    plan.check(prepared.base.scene)
    folder = out if out is not None else Path("results") / f"compare-{path.stem}"
    claim_folder(folder)
    try:
        with StatusLine(not quiet) as status:
            comparison = compare_prepared(prepared, plan, status)
            for text in comparison.notices:
                status.notice(f"note: {text}")
            status.show("writing tables and pictures")
            write_comparison(comparison, folder, drawn_files(plan.steps))
            for text in write_drawings(comparison, folder):
                status.notice(f"note: {text}")
    except BaseException:
        abandon_folder(folder)
        raise
    print(f"{table_text(comparison)}\n\n{folder / PAGE}")
    return NotConvergedError.exit_code if comparison.all_diverged else 0
