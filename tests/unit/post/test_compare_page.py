"""What `femdeform compare` leaves to look at, and the command as a whole."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from compared import MISBEHAVIOUR, let_misbehave, write_bar

from femdeform import cli
from femdeform.errors import MissingDependencyError
from femdeform.post import compare_pictures, compare_plots
from femdeform.post.compare_command import compare_command
from femdeform.post.compare_page import drawn_files
from femdeform.post.plots import new_figure

OPTION_SETS = ["exact: solver.hessian=exact", "<b>rough</b>: solver.hessian=projected"]


class Page(HTMLParser):
    """Text by tag, attributes, and whether every tag that was opened is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: dict[str, list[str]] = {}
        self.attributes: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "wbr", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open:
            self.texts.setdefault(self.open[-1], []).append(data.strip())


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare_pictures, "_PANEL", (240, 180))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two variants over three steps, drawn."""
    base = tmp_path_factory.mktemp("compare")
    path = write_bar(base, title="A bar & more")
    plan = {"iterations": 2, "steps": 3}
    assert compare_command(path, plan, option_sets=OPTION_SETS, out=base / "out", quiet=True) == 0
    return base / "out"


def test_everything_is_there(folder: Path) -> None:
    states = ["exact.vtu", "b-rough-b.vtu", "reference.vtu"]
    expected = {"compare.csv", "compare.json", "iterations.csv", *states, *drawn_files(3)}
    assert {path.name for path in folder.iterdir()} == expected
    assert set(json.loads((folder / "compare.json").read_text())["files"]) == expected
    assert {"residual-iterations.png", "residual-time.png", "distance-iterations.png", "energy.png"} <= expected
    assert {"pictures.png", "index.html", "steps.png"} <= expected
    assert not {"steps.png", "residual-parts.png"} & set(drawn_files(1))
    for path in folder.glob("*.png"):
        picture = imageio.imread(path)
        assert min(picture.shape[:2]) > 200
        assert picture[..., :3].std() > 5.0  # something is on it


def test_the_page_needs_nothing_else_and_says_what_the_tables_say(folder: Path) -> None:
    text = (folder / "index.html").read_text(encoding="utf-8")
    page = Page(text)
    for tag, attributes in page.attributes:
        for name in ("src", "href"):
            assert name not in attributes or str(attributes[name]).startswith("data:"), (tag, attributes)
    assert "://" not in re.sub(r'"data:[^"]*"', "", text)
    assert page.texts["h1"] == ["A bar & more: comparison"]
    images = [attributes for tag, attributes in page.attributes if tag == "img"]
    assert len(images) == 6
    assert all(attributes["alt"] for attributes in images)
    cells = page.texts["td"]
    facts = json.loads((folder / "compare.json").read_text())
    for row in facts["summary"]:
        assert row["variant"] in cells  # a label is text, whatever it looks like
        assert f"{row['relative_residual']:.2e}" in cells
        assert f"{row['total_energy']:.6g}" in cells
    assert "<b>rough" not in text
    everything = " ".join(text for texts in page.texts.values() for text in texts)
    assert "2 iterations a step" in everything
    assert "infinite (no inertia)" in everything
    assert "R0 is that of its own step" in everything
    assert "solver.hessian=projected" in page.texts["code"]


def test_residuals_in_parts(tmp_path: Path) -> None:
    """What XPBD reports of its residual is carried into the table and drawn; the other variant has none of it."""
    path = write_bar(tmp_path, time={"scheme": "backward_euler", "dt": 0.005, "end": 0.5})
    command = ["newton: solver.tolerance=1e-9", "xpbd: 'solver={method: xpbd, iterations: 60, check_every: 20}'"]
    out = tmp_path / "o"
    assert compare_command(path, {"iterations": 60}, option_sets=command, out=out, quiet=True) == 0
    assert {file.name for file in out.iterdir()} >= set(drawn_files(1, is_split=True))
    assert "residual-parts.png" in drawn_files(1, is_split=True)
    assert imageio.imread(out / "residual-parts.png")[..., :3].std() > 5.0
    with (out / "iterations.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert not any(row["primary_residual"] for row in rows if row["variant"] == "newton" or row["iteration"] == "0")
    last = next(row for row in reversed(rows) if row["variant"] == "xpbd")
    primary, secondary, whole = (float(last[f"{name}_residual"]) for name in ("primary", "secondary", "relative"))
    # Sweeps meet the constraints; the residual that stays is the primary one.
    assert secondary < 1e-3 * primary
    assert primary == pytest.approx(whole * float(last["force_scale"]), rel=1e-3)
    assert "The primary residual is" in (out / "index.html").read_text(encoding="utf-8")


def test_pictures_show_who_is_off(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One scale of colours: the reference is dark all over, a variant that is off is not."""
    panels: dict[str, Any] = {}
    compose = compare_pictures._compose

    def keep(comparison: Any, pictures: Any, *rest: Any) -> Any:
        panels.update(pictures)
        return compose(comparison, pictures, *rest)

    monkeypatch.setattr(compare_pictures, "_compose", keep)
    plan = {"iterations": 1}
    command = ["good: solver.tolerance=1e-9", "off: solver.hessian=projected"]
    path = write_bar(tmp_path, time={"scheme": "backward_euler", "dt": 0.05, "end": 0.5})
    assert compare_command(path, plan, option_sets=command, out=tmp_path / "o", quiet=True) == 0
    assert list(panels) == ["reference", "good", "off"]
    assert len({panel.shape for panel in panels.values()}) == 1
    coloured = {label: np.ptp(panel.astype(int), axis=2) > 60 for label, panel in panels.items()}
    bright = {label: (coloured[label] & (panel[..., 1] > 120)).sum() for label, panel in panels.items()}
    assert bright["reference"] == 0
    assert bright["off"] > 50


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Compare solvers that misbehave as named, from the command line."""

    def go(*names: str, steps: int = 2) -> int:
        let_misbehave(monkeypatch)
        path = write_bar(tmp_path)
        sets = [part for name in names for part in ("--variant", f"{name}: {MISBEHAVIOUR[name]}")]
        out = ["--out", str(tmp_path / "out"), "--quiet"]
        return cli.main(["compare", str(path), *sets, "--iterations", "50", "--steps", str(steps), *out])

    return go


def test_a_curve_that_diverged_does_not_flatten_the_others() -> None:
    figure, (ax,) = new_figure(1)
    ax.plot([0, 1, 2], [1.0, 1e-3, 1e-6])
    ax.plot([0, 1, 2], [2.0, 1e40, np.nan])
    compare_plots._set_log(ax)
    compare_plots._cut_off(ax)
    bottom, top = ax.get_ylim()
    assert 2.0 < top < 1e5
    assert bottom < 1e-6
    figure.clear()


def test_a_diverged_variant_has_its_place(
    run: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("nan", "far off", "stubborn") == 0
    page = Page((tmp_path / "out" / "index.html").read_text())
    assert "1 of 3 diverged" in page.texts["span"]
    assert "diverged in step 2: iterate 3 is not finite" in page.texts["td"]
    assert "diverged in step 2" in capsys.readouterr().out
    assert (tmp_path / "out" / "pictures.png").exists()


def test_if_all_diverge_the_exit_code_says_so(
    run: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("nan", "nan at the end") == 3
    assert "2 of 2 diverged" in Page((tmp_path / "out" / "index.html").read_text()).texts["span"]
    assert capsys.readouterr().err == ""


def test_a_machine_that_cannot_draw_still_compares(
    run: Callable[..., int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        raise MissingDependencyError("no graphics here")

    monkeypatch.setattr(compare_pictures, "load_pyvista", refuse)
    assert run("stubborn", steps=1) == 0
    page = Page((tmp_path / "out" / "index.html").read_text())
    assert "no graphics here" in page.texts["p"]
    assert not (tmp_path / "out" / "pictures.png").exists()
    assert (tmp_path / "out" / "compare.csv").exists()


# ------------------------------------------------------------------------------------------ command line


def test_the_command_says_what_it_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = write_bar(tmp_path), tmp_path / "out"
    words = ["compare", str(path), "--methods", "projected_newton", "--variant", "exact: solver.hessian=exact"]
    assert cli.main([*words, "--iterations", "3", "--repeat", "2", "--out", str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "bar.yaml: 1 step from t = 0 s, 3 iterations a step, kappa = inf, 42 degrees of freedom"
    assert [line.split()[0] for line in lines[4:7]] == ["projected_newton", "exact", "reference"]
    assert lines[-1] == str(out / "index.html")


def test_the_default_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bar(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["compare", str(path), "--methods", "projected_newton", "--seconds", "9", "--quiet"]) == 0
    assert (tmp_path / "results" / "compare-bar" / "index.html").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--methods", "newton", "--iterations", "1"], "--methods: there is no method `newton`"),
        (["--iterations", "1"], "there is nothing to compare: give --methods or --variant"),
        (["--methods", "projected_newton"], "give a budget of either iterations or seconds"),
        (["--methods", "projected_newton", "--iterations", "1", "--seconds", "1"], "not allowed with argument"),
        (["--methods", "projected_newton", "--iterations", "0"], "must be a positive whole number, not 0"),
        (["--methods", "projected_newton", "--seconds", "-1"], "the budget of seconds must be positive, not -1"),
        (["--methods", "projected_newton", "--seconds", "soon"], "invalid float value: 'soon'"),
        (["--variant", "v: solver.hessian=exakt", "--iterations", "1"], "--variant v: solver.hessian: "),
        (["--variant", "v: time.dt=1", "--iterations", "1"], "changes solver or linear_solver only"),
        (["--methods", "projected_newton", "--iterations", "1", "--start-step", "4"], "go beyond the scene's end"),
        (["--methods", "projected_newton", "--iterations", "1", "--out", "bar.yaml"], "bar.yaml: is a file"),
        (["--methods", "projected_newton", "--iterations", "1", "--out", "."], ".: holds files that are not of"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    message: str,
) -> None:
    path = write_bar(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["compare", path.name, *words]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert message in output.err.splitlines()[-1]
    assert [found.name for found in tmp_path.iterdir()] == ["bar.yaml"]


def test_a_reference_that_fails_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_bar(tmp_path, {"kind": "point_load", "on": "b.right", "force": [0.0, -1.0]})
    text = path.read_text().replace('"b.left"', '"b.left", "components": ["x"]')
    path.write_text(text)  # free to fall, without inertia
    monkeypatch.chdir(tmp_path)
    assert cli.main(["compare", "bar.yaml", "--methods", "projected_newton", "--iterations", "1", "--quiet"]) == 3
    assert "the reference does not converge in step 1" in capsys.readouterr().err
    assert not (tmp_path / "results" / "compare-bar").exists()


def test_one_process_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    monkeypatch.setenv("OMPI_COMM_WORLD_RANK", "0")
    assert cli.main(["compare", str(write_bar(tmp_path)), "--methods", "projected_newton", "--iterations", "1"]) == 2
    assert capsys.readouterr().err == "femdeform: compare is serial: run it without mpiexec\n"
