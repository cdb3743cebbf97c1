"""Plots of the steps and iterations of a run."""

from __future__ import annotations

import shutil
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from femdeform.errors import InputError
from femdeform.post import plots, run_plots
from femdeform.run.result import Result


def test_files_of_a_run(beam: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(beam, tmp_path / "copy")
    written = run_plots.write_plots(copy)
    assert written == [copy / "plots" / f"{name}.png" for name in ("energy", "residual", "iterations")]
    for path in written:
        picture = iio.imread(path)
        assert picture.shape[1] == 1050
        assert (picture[..., :3].min(axis=2) < 128).mean() > 0.003


def test_energy_curves_are_the_columns_and_their_sum(beam: Path) -> None:
    history = Result.open(beam).history
    figure = plots.energy_figure(history)
    curves = {line.get_label(): line.get_ydata() for line in figure.axes[0].lines}
    assert list(curves) == ["kinetic", "elastic", "potential of the loads", "total"]
    np.testing.assert_allclose(curves["elastic"], history["elastic_energy"])
    np.testing.assert_allclose(curves["total"], history["time"] ** 2)
    np.testing.assert_allclose(figure.axes[0].lines[0].get_xdata(), history["time"])
    still = plots.energy_figure({**history, "kinetic_energy": 0.0 * history["time"]})
    assert [line.get_label() for line in still.axes[0].lines] == ["elastic", "potential of the loads", "total"]


def test_residuals_are_on_a_logarithmic_axis_without_zeros() -> None:
    history = {"step": np.arange(3), "relative_residual": np.array([1e-3, 0.0, 1e-9]), "iterations": np.arange(3)}
    figure = plots.residual_figure(history)
    assert figure.axes[0].get_yscale() == "log"
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), [1e-3, np.nan, 1e-9])


def test_attempts_of_a_step_are_curves_of_their_own() -> None:
    iterations = {
        "step": np.array([1, 1, 2, 2, 2, 2, 3]),
        "iteration": np.array([0, 1, 0, 1, 0, 1, 0]),
        "relative_residual": 10.0 ** -np.arange(7.0),
    }
    figure = plots.iterations_figure(iterations)
    assert [(line.get_label(), len(line.get_xdata())) for line in figure.axes[0].lines] == [
        ("step 1", 2),
        ("step 2", 2),
        ("step 2", 2),
        ("step 3", 1),
    ]


def test_of_many_steps_a_few_are_shown_first_and_last_among_them() -> None:
    step = np.arange(1, 101)
    figure = plots.iterations_figure({"step": step, "iteration": 0 * step, "relative_residual": 1.0 / step})
    labels = [line.get_label() for line in figure.axes[0].lines]
    assert len(labels) == 12
    assert (labels[0], labels[-1]) == ("step 1", "step 100")


@pytest.mark.parametrize(
    "history",
    [
        {},
        {"step": np.zeros(0, np.int64), "time": np.zeros(0)},
        {"step": np.arange(2), "time": np.arange(2.0), "elastic_energy": np.full(2, np.nan)},
        {"step": np.arange(2), "time": np.array(["a", "b"]), "relative_residual": np.array(["x", "y"])},
    ],
)
def test_no_numbers_no_plot(history: dict[str, np.ndarray]) -> None:
    assert plots.energy_figure(history) is None
    assert plots.residual_figure(history) is None
    assert plots.iterations_figure(history) is None


def test_a_thousand_steps_and_a_single_one() -> None:
    for n in (1, 1000):
        step = np.arange(1, n + 1)
        history = {"step": step, "time": 0.1 * step, "elastic_energy": 1.0 * step, "relative_residual": 1.0 / step}
        history["iterations"] = step % 7
        for figure in (plots.energy_figure(history), plots.residual_figure(history)):
            assert len(plots.figure_bytes(figure, "svg")) > 1000


def test_the_same_figure_gives_the_same_file(beam: Path) -> None:
    first, second = (plots.figure_bytes(plots.energy_figure(Result.open(beam).history), "svg") for _ in range(2))
    assert first == second


def test_a_run_without_history(beam: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(beam, tmp_path / "copy")
    (copy / "history.csv").unlink()
    with pytest.raises(InputError, match=r"history\.csv: no such file"):
        run_plots.write_plots(copy)
