"""Reports and plots of flows and of particles: what makes sense for them, and nothing else."""

from __future__ import annotations

import re
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from femdeform.post import report
from femdeform.post.plots import energy_figure, measured_figure
from femdeform.post.render import draw_frames
from femdeform.post.report import write_report
from femdeform.post.run_plots import further_figure, plots_of, write_plots
from femdeform.run.result import Result


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "draw_frames", partial(draw_frames, size=(320, 208)))


def headings(page: str) -> list[str]:
    return re.findall("<h2>(.*?)</h2>", page)


def test_a_report_of_smoke(flow_2d: Path, tmp_path: Path) -> None:
    page = write_report(flow_2d, tmp_path / "a.html").read_text()
    assert headings(page) == [
        "Pictures",
        "Run",
        "Settings",
        "Divergence",
        "Pressure solver",
        "Smoke and energy",
        "Measured",
        "Scene",
    ]
    assert "view3d" not in page.split("</style>")[1]
    assert "boundaries.<wbr>top" in page
    assert "largest divergence" in page


def test_a_report_of_particles(drops_3d: Path, tmp_path: Path) -> None:
    page = write_report(drops_3d, tmp_path / "a.html").read_text()
    assert headings(page) == [
        "Pictures",
        "Run",
        "Settings",
        "Energy",
        "Residual",
        "Measured",
        "Further quantities",
        "Scene",
    ]


def test_sections_without_numbers(flow_2d: Path, drops_2d: Path, tmp_path: Path) -> None:
    for folder, rows in ((flow_2d, "step,time\n1,0.5\n"), (drops_2d, "step,time,relative_residual\n1,0.5,\n")):
        copy = shutil.copytree(folder, tmp_path / folder.name)
        (copy / "history.csv").write_text(rows)
        page = write_report(copy).read_text()
        assert "Measured" not in headings(page)
        assert "Further quantities" not in headings(page)
        assert "left no numbers to plot" in page
        (copy / "history.csv").unlink()
        assert "history.csv: no such file" in write_report(copy).read_text()


def test_files_of_plots(flow_2d: Path, drops_2d: Path, tmp_path: Path) -> None:
    flow, drops = (shutil.copytree(folder, tmp_path / folder.name) for folder in (flow_2d, drops_2d))
    assert [path.stem for path in write_plots(flow)] == ["divergence", "pressure", "smoke", "measured"]
    assert [path.stem for path in write_plots(drops)] == ["energy", "residual", "measured", "further"]
    assert all(path.stat().st_size > 5000 for path in (flow / "plots").iterdir())


def test_the_curves_are_the_columns(flow_2d: Path, drops_2d: Path) -> None:
    result = Result.open(flow_2d)
    divergence = plots_of(result)[0].make(result.history)
    curves = {line.get_label(): line.get_ydata() for line in divergence.axes[0].lines}
    assert list(curves) == ["before the projections", "after them"]  # an imbalance of zero has no logarithm
    np.testing.assert_allclose(curves["after them"], result.history["divergence"])
    assert divergence.axes[0].get_yscale() == "log"
    (height,) = measured_figure(result.history).axes
    np.testing.assert_allclose(height.lines[0].get_ydata(), result.history["measure.height"])
    assert height.get_ylabel() == "height"

    history = Result.open(drops_2d).history
    energies = {line.get_label(): line.get_ydata() for line in energy_figure(history).axes[0].lines}
    assert list(energies) == ["kinetic", "elastic", "surface", "total"]
    np.testing.assert_allclose(energies["total"], history["time"] + history["time"] ** 2 + 0.3)
    known = energy_figure({**history, "total_energy": 7.0 * np.ones(2)}).axes[0].lines[-1]
    np.testing.assert_array_equal(known.get_ydata(), [7.0, 7.0])
    assert [ax.get_ylabel() for ax in further_figure(history).axes] == ["n particles"]
    assert further_figure({"step": np.arange(2), "time": np.arange(2.0)}) is None
