"""Plots of a run of smoke."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.post.plots import MARKED, Columns, new_figure, numbers_of, panels_figure, positive, residual_figure

_DIVERGENCES = (
    ("divergence_before", "before the projections", "#ee6677"),
    ("divergence", "after them", "#4477aa"),
    ("imbalance", "mean of closed parts", "#888888"),
)


def divergence_figure(history: Columns) -> Any | None:
    """Largest divergence before and after the projections of each step, and what no pressure can take away; None
    where there are no such numbers."""
    time = numbers_of(history, "time")
    curves = [(positive(numbers_of(history, name)), label, colour) for name, label, colour in _DIVERGENCES]
    present = [curve for curve in curves if np.any(np.isfinite(curve[0]))]
    if not present or not np.any(np.isfinite(time)):
        return None
    figure, axes = new_figure(1)
    marker = "." if len(time) <= MARKED else ""
    for values, label, colour in present:
        axes[0].plot(time, values, color=colour, label=label, marker=marker, linewidth=1.4)
    axes[0].set_yscale("log")
    axes[0].set_xlabel("time [s]")
    axes[0].set_ylabel("largest divergence [1/s]")
    axes[0].legend(frameon=False, fontsize=9)
    return figure


def pressure_figure(history: Columns) -> Any | None:
    """Residual and iterations of the pressure solver in each step; None where there are no such numbers."""
    return residual_figure(history, "residual of pressure")


def smoke_figure(history: Columns) -> Any | None:
    """Kinetic energy and amount of smoke over time; None where there are no such numbers."""
    return panels_figure(history, {"kinetic_energy": "kinetic energy [J, in 2D J/m]", "smoke": "smoke [m³, in 2D m²]"})
