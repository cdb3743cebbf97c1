"""The last states of a comparison side by side: one camera, one range of colours."""

from __future__ import annotations

import contextlib
import importlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.post.backend import load_pyvista
from femdeform.post.plots import new_figure
from femdeform.post.stage import Stage
from femdeform.post.survey import survey
from femdeform.run.compare import Comparison
from femdeform.run.compare_output import state_files
from femdeform.run.compare_variants import REFERENCE
from femdeform.run.result import FrameEntry, Result

_PANEL = (720, 540)
_MAX_COLUMNS = 3
_PANEL_INCHES = 3.6
# A state that reaches this many times as far as the reference would leave of all others a dot.
_TOO_FAR = 4.0
# Distances below this part of the bodies' size are rounding; the displacement then says more.
_VISIBLE = 1e-9


@dataclass(frozen=True)
class _States(Result):
    """Files of states as the frames of a result, so that they are drawn like one."""

    entries: tuple[FrameEntry, ...] = ()
    scene: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def frames(self) -> list[FrameEntry]:
        return list(self.entries)

    @cached_property
    def resolved(self) -> dict[str, Any]:
        return dict(self.scene)


def picture_figure(comparison: Comparison, folder: Path) -> Any:
    """A panel for every variant and the reference, coloured by the distance to the reference.

    Where all distances are rounding, or there is none, the colours show the displacement.

    Parameters
    ----------
    comparison : Comparison
        What to draw.
    folder : Path
        Where `write_comparison` wrote the states.

    Raises
    ------
    InputError
        If a state cannot be read.
    MissingDependencyError
        If nothing can be drawn on this machine.
    """
    new_figure(1)  # without matplotlib nothing needs to be drawn
    shown = [label for label in comparison.states if not _is_too_far(comparison, label)]
    files = state_files(comparison)
    time = comparison.reference[-1]["time"]
    states = _States(
        folder,
        {"title": "", "obstacles": comparison.facts["obstacles"]},
        entries=tuple(FrameEntry(i, time, folder / files[label]) for i, label in enumerate(shown)),
        scene={"gravity": comparison.facts["gravity"]},
    )
    name, label_of_bar = _field(comparison, shown)
    pyvista = load_pyvista()
    setting = survey(states, range(len(shown)), name)
    pictures = {}
    with contextlib.closing(Stage(pyvista, states, setting, name, size=_PANEL, bare=True)) as stage:
        for index, label in enumerate(shown):
            stage.show(index)
            pictures[label] = stage.picture()
    return _compose(comparison, _trimmed(pictures), setting.colours, label_of_bar)


def _is_too_far(comparison: Comparison, label: str) -> bool:
    displacement = comparison.states[label]["displacement"]
    positions = comparison.mesh.points + displacement
    reference = comparison.mesh.points + comparison.states[REFERENCE]["displacement"]
    size = np.linalg.norm(np.ptp(np.concatenate([comparison.mesh.points, reference]), axis=0))
    return bool(np.linalg.norm(np.ptp(np.concatenate([positions, reference]), axis=0)) > _TOO_FAR * size)


def _field(comparison: Comparison, shown: list[str]) -> tuple[str, str]:
    largest = max(float(np.linalg.norm(comparison.states[label]["deviation"], axis=1).max()) for label in shown)
    size = float(np.linalg.norm(np.ptp(comparison.mesh.points, axis=0)))
    if largest > _VISIBLE * size:
        return "deviation", "distance to the reference [m]"
    return "displacement", "displacement [m]"


def _trimmed(pictures: Mapping[str, NDArray[np.uint8]]) -> dict[str, NDArray[np.uint8]]:
    """The pictures without the margin that is empty in all of them."""
    used = np.any([np.any(picture < 250, axis=2) for picture in pictures.values()], axis=0)
    rows, columns = np.flatnonzero(used.any(axis=1)), np.flatnonzero(used.any(axis=0))
    if not rows.size:
        return dict(pictures)
    margin = 12
    top, bottom = max(rows[0] - margin, 0), rows[-1] + margin
    left, right = max(columns[0] - margin, 0), columns[-1] + margin
    return {label: picture[top:bottom, left:right] for label, picture in pictures.items()}


def _compose(
    comparison: Comparison, pictures: Mapping[str, NDArray[np.uint8]], colours: tuple[float, float], label_of_bar: str
) -> Any:
    labels = [*comparison.labels, REFERENCE]
    n_columns = min(len(labels), _MAX_COLUMNS) if len(labels) != 4 else 2
    n_rows = math.ceil(len(labels) / n_columns)
    height, width = next(iter(pictures.values())).shape[:2]
    figure = importlib.import_module("matplotlib.figure").Figure(
        figsize=(_PANEL_INCHES * n_columns + 1.0, (_PANEL_INCHES * height / width + 0.55) * n_rows),
        layout="constrained",
    )
    axes = figure.subplots(n_rows, n_columns, squeeze=False).ravel().tolist()
    for ax in axes:
        ax.set_axis_off()
    for ax, label in zip(axes, labels, strict=False):
        ax.set_title(f"{label}\n{_caption(comparison, label)}", fontsize=9)
        if label in pictures:
            ax.imshow(pictures[label], interpolation="antialiased")
            continue
        # A white panel of the same size keeps the others in their places.
        ax.imshow(np.full((height, width, 3), 255, dtype=np.uint8))
        why = "too far off to be shown" if label in comparison.states else "not finite"
        ax.text(0.5, 0.5, why, transform=ax.transAxes, ha="center", va="center", color="#b3362b")
    bar = figure.colorbar(_scale(colours), ax=axes, label=label_of_bar, shrink=0.8)
    bar.formatter.set_powerlimits((-2, 3))
    return figure


def _scale(colours: tuple[float, float]) -> Any:
    cm, normal = importlib.import_module("matplotlib.cm"), importlib.import_module("matplotlib.colors")
    return cm.ScalarMappable(normal.Normalize(*colours), "viridis")


def _caption(comparison: Comparison, label: str) -> str:
    last = comparison.of(label)[-1]
    if label == REFERENCE:
        return f"t = {last['time']:.4g} s"
    if label not in comparison.states:
        return f"diverged in step {last['step']}"
    return f"{last['iterations']} iterations, {last['seconds']:.3g} s, r/R0 {last['relative_residual']:.1e}"
