"""What a comparison leaves to look at: plots, pictures, and one HTML page that needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from femdeform.errors import MissingDependencyError
from femdeform.post.compare_pictures import picture_figure
from femdeform.post.compare_plots import all_figures
from femdeform.post.page import data_address, figure_image, html_page, section
from femdeform.post.plots import figure_bytes
from femdeform.post.report_tables import settings_table, versions_table
from femdeform.run import atomic
from femdeform.run.compare import Comparison
from femdeform.run.compare_output import budget_text, summary
from femdeform.run.compare_trial import DIVERGED
from femdeform.run.compare_variants import REFERENCE

PAGE, PICTURES = "index.html", "pictures.png"

_TITLES = {
    "residual-iterations.png": "Residual against iterations",
    "residual-time.png": "Residual against time",
    "distance-iterations.png": "Distance to the reference",
    "energy.png": "Energy",
    "residual-parts.png": "Primary and secondary residual",
    "steps.png": "End of each step",
}
_SUMMARY = (
    ("variant", "variant", ""),
    ("iterations", "iterations", "d"),
    ("seconds", "seconds", ".3g"),
    ("relative_residual", "largest r/R0", ".2e"),
    ("distance", "distance, RMS [m]", ".2e"),
    ("distance_max", "distance, largest [m]", ".2e"),
    ("total_energy", "energy [J]", ".6g"),
    ("status", "status", ""),
)
_STATE = (
    ("variant", "variant", ""),
    ("kinetic_energy", "kinetic [J]", ".4g"),
    ("elastic_energy", "elastic [J]", ".4g"),
    ("load_potential", "loads [J]", ".4g"),
    ("contact_energy", "contact [J]", ".4g"),
    ("linear_momentum", "linear momentum [kg m/s]", ".4g"),
    ("angular_momentum", "angular momentum [kg m²/s]", ".4g"),
    ("volume_ratio", "volume ratio", ".6f"),
    ("min_jacobian", "smallest det F", ".4g"),
    ("inverted_cells", "inverted cells", ".0f"),
)
_STEPS = (
    ("variant", "variant", ""),
    ("step", "step", "d"),
    ("time", "time [s]", ".6g"),
    ("iterations", "iterations", "d"),
    ("seconds", "seconds", ".3g"),
    ("residual_norm", "|r| [N]", ".2e"),
    ("relative_residual", "r/R0", ".2e"),
    ("residual_max", "largest component [N]", ".2e"),
    ("distance", "distance [m]", ".2e"),
    ("stopped_by", "stopped by", ""),
)


def drawn_files(steps: int, *, is_split: bool = False) -> list[str]:
    """Names of the files that `write_drawings` leaves; `is_split`: a variant reports its residual in parts."""
    left_out = {name for name, is_there in (("steps.png", steps > 1), ("residual-parts.png", is_split)) if not is_there}
    return [*(name for name in _TITLES if name not in left_out), PICTURES, PAGE]


def write_drawings(comparison: Comparison, folder: Path) -> list[str]:
    """Write plots, pictures and page beside the tables of a comparison.

    Parameters
    ----------
    comparison : Comparison
        What was written to the folder.
    folder : Path
        From `write_comparison`.

    Returns
    -------
    list of str
        What could not be drawn on this machine; the page says so in its place.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    notes: list[str] = []
    images: dict[str, str] = {}
    for name, draw in all_figures(comparison).items():
        try:
            figure = draw()
            atomic.write_bytes(folder / name, figure_bytes(figure, "png"))
            images[name] = figure_image(figure, _TITLES[name])
        except MissingDependencyError as error:
            notes.append(str(error))
            images[name] = f'<p class="note">{escape(str(error))}</p>'
    try:
        data = figure_bytes(picture_figure(comparison, folder), "png")
        atomic.write_bytes(folder / PICTURES, data)
        pictures = f'<img alt="last states side by side" src="{data_address("image/png", data)}">'
    except MissingDependencyError as error:
        notes.append(str(error))
        pictures = f'<p class="note">{escape(str(error))}</p>'
    atomic.write_text(folder / PAGE, _page(comparison, images, pictures))
    return list(dict.fromkeys(notes))


def _page(comparison: Comparison, images: Mapping[str, str], pictures: str) -> str:
    facts = comparison.facts
    statuses = [comparison.of(label)[-1]["status"] for label in comparison.labels]
    n_diverged = statuses.count(DIVERGED)
    badge = ("compared", "good") if n_diverged == 0 else (f"{n_diverged} of {len(statuses)} diverged", "bad")
    rows = [comparison.of(label)[-1] for label in [*comparison.labels, REFERENCE]]
    body = [
        "".join(f'<p class="reason">{escape(text)}</p>' for text in comparison.notices),
        section("Result", _table(_summary_rows(comparison), _SUMMARY)),
        section("Last states", pictures),
        '<div class="columns">',
        *(section(_title(name, facts["steps"]), image) for name, image in images.items() if name != "steps.png"),
        "</div>",
        section(_TITLES["steps.png"], images.get("steps.png", "")),
        section("State after the last step", _table([_with_norms(row) for row in rows], _STATE)),
        '<div class="columns">',
        section("What was compared", _facts(comparison)),
        section("How to read this", _explanation(facts["steps"], bool(comparison.split_labels))),
        "</div>",
        section("Variants", _variants(facts)),
        section("Every step", f"<details><summary>table</summary>{_table(comparison.steps, _STEPS)}</details>"),
    ]
    return html_page(f"{facts['title'] or facts['scene_file']}: comparison", *badge, body)


def _title(name: str, steps: int) -> str:
    if name == "energy.png" and steps == 1:
        return "Objective above the minimum"
    return _TITLES[name]


def _table(rows: Sequence[Mapping[str, Any]], columns: Sequence[tuple[str, str, str]]) -> str:
    lines = ['<table class="wide"><tr>', *(f"<th>{escape(title)}</th>" for _, title, _ in columns), "</tr>"]
    for row in rows:
        cells = (f"<td>{escape(_text(row[name], form))}</td>" for name, _, form in columns)
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return "\n".join([*lines, "</table>"])


def _text(value: Any, form: str) -> str:
    if not form:
        return str(value)
    return "-" if isinstance(value, float) and math.isnan(value) else format(value, form)


def _summary_rows(comparison: Comparison) -> list[dict[str, Any]]:
    rows = summary(comparison)
    # The reference's distance to itself is no result.
    rows[-1] |= {"distance": math.nan, "distance_max": math.nan}
    return rows


def _with_norms(row: Mapping[str, Any]) -> dict[str, Any]:
    norms = {
        name: float(np.linalg.norm([value for key, value in row.items() if key.startswith(f"{name}_")]))
        for name in ("linear_momentum", "angular_momentum")
    }
    return {**row, **norms}


def _facts(comparison: Comparison) -> str:
    facts = comparison.facts
    kappa = comparison.stiffness_number
    edges = ", ".join(f"{name} {length:.4g} m" for name, length in facts["mean_edge_length"].items())
    reference = facts["reference"]
    start = f"step {facts['start_step']} of the reference" if facts["start_step"] else "initial state of the scene"
    rows = [
        ("scene", facts["scene_file"]),
        ("degrees of freedom, cells", f"{facts['n_dofs']:,}, {facts['n_cells']:,}"),
        ("start", f"{start}, t = {facts['start_time']:.6g} s"),
        ("steps", f"{facts['steps']} of {facts['dt']:g} s ({facts['scheme'].replace('_', ' ')})"),
        ("budget", budget_text(facts)),
        ("runs of each variant", facts["repeat"]),
        ("stiffness number kappa", f"{kappa:.4g}" if math.isfinite(kappa) else "infinite (no inertia)"),
        ("mean edge length", edges),
        ("R0 of the first step", f"{comparison.reference[0]['force_scale']:.6g} N"),
        ("reference", f"projected_newton to {reference['solver']['tolerance']:g} of R0, {reference['linear_solver']}"),
        ("its residual, largest", f"{reference['largest_relative_residual']:.2e} of R0"),
        ("threads", facts["threads"]),
    ]
    lines = [f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows]
    return '<table class="facts">\n' + "\n".join(lines) + "\n</table>" + versions_table(facts)


def _explanation(steps: int, is_split: bool) -> str:
    texts = [
        "All variants start from the same positions and velocities and solve the same equations.",
        "The residual r is the gradient of the incremental potential at the free degrees of freedom [N]. It is "
        "evaluated from the positions, in the same way for every variant, never taken from a solver. The clock stands "
        "still meanwhile.",
        "R0 is the size of the forces of the step: of inertia, inside the body, and of the loads, at its start.",
        "The distance to the reference is the root mean square over the nodes, weighted by their masses.",
        "kappa = h² E / (ρ dx²) says how far stiffness outweighs inertia over a cell in a step; dx is the mean edge "
        "length. Position-based methods need the more sweeps the larger it is.",
        "An iteration that has begun is finished, so a step may take longer than its seconds.",
    ]
    if is_split:
        texts.append(
            "The primary residual is how far multipliers are from carrying inertia and loads, the secondary one how "
            "far they are from the stress at the positions. A solver with multipliers reports both, as norms [N]. "
            "Their vectors add up to the residual of what it solves; for XPBD-QS that is a pseudo-time step."
        )
    if steps > 1:
        texts.append(
            "In the first step R0 and the start are the same for all. After it each variant goes on from where it "
            "arrived, and R0 is that of its own step; the reference goes its own way too."
        )
    return "<ul>" + "".join(f"<li>{escape(text)}</li>" for text in texts) + "</ul>"


def _variants(facts: Mapping[str, Any]) -> str:
    parts = []
    for label, options in facts["variants"].items():
        given = " ".join(options["overrides"])
        remark = f" <code>{escape(given)}</code>" if given else ""
        parts.append(
            f"<details><summary>{escape(label)}: {escape(options['solver']['method'])}</summary>{remark}"
            f"{settings_table(options)}</details>"
        )
    return "\n".join(parts)
