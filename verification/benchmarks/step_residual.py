"""How far positions are from solving a step of backward Euler; NumPy only, because the peers' scripts use it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

_GRAVITY = 9.81  # [m/s^2]


def first_piola(law: str, mu: float, lmbda: float, f: Any) -> Any:
    """Return the first Piola-Kirchhoff stress (n, 3, 3) [Pa].

    Parameters
    ----------
    law : str
        ``neo_hookean``: mu/2 |F|^2 - mu J + (lambda + mu)/2 (J - 1)^2; ``saint_venant_kirchhoff``: mu |E|^2 +
        lambda/2 (tr E)^2; ``trace_and_determinant``: mu/2 (|F|^2 - 3)^2 + lambda/2 (J - 1)^2, which has no stiffness
        in shear at rest.
    mu, lmbda : float
        Constants of these formulas [Pa].
    f : (n, 3, 3) array
        Deformation gradients [-].
    """
    if law == "saint_venant_kirchhoff":
        strain = 0.5 * (np.swapaxes(f, 1, 2) @ f - np.eye(3))
        trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
        return f @ (2.0 * mu * strain + lmbda * trace * np.eye(3))
    cofactor = np.cross(f[:, :, [1, 2, 0]], f[:, :, [2, 0, 1]], axis=1)
    growth = (np.linalg.det(f) - 1.0)[:, None, None]
    if law == "neo_hookean":
        return mu * f + ((lmbda + mu) * growth - mu) * cofactor
    excess = (f**2).sum(axis=(1, 2))[:, None, None] - 3.0
    return 2.0 * mu * excess * f + lmbda * growth * cofactor


class StepResidual:
    """Residuals of a step of the benchmark's block from rest at given positions, with lumped mass.

    Parameters
    ----------
    block : mapping
        As written by `verification.benchmarks.xpbd_case.dump`.
    law : str
        What the positions are meant to solve, see `first_piola`.
    """

    def __init__(self, block: Any, law: str) -> None:
        self._law = (law, float(block["mu"]), float(block["lmbda"]))
        self._cells, self._start = block["cells"], block["positions"]
        points = block["points"]
        edges = np.swapaxes(points[self._cells[:, 1:]] - points[self._cells[:, :1]], 1, 2)
        self._inverse = np.linalg.inv(edges)
        self._volume = np.abs(np.linalg.det(edges)) / 6.0
        share = np.repeat(float(block["density"]) * self._volume / 4.0, 4)
        self._mass = np.bincount(self._cells.ravel(), share, minlength=len(points))[:, None]
        self._is_free = points[:, 0] != 0.0

    def norm(self, x: Any, dt: float) -> float:
        """Return |M (x - flight)/h^2 + f(x)| over the free nodes [N]."""
        edges = np.swapaxes(x[self._cells[:, 1:]] - x[self._cells[:, :1]], 1, 2)
        stress = first_piola(*self._law, edges @ self._inverse)
        # Columns: forces on nodes 1 to 3 of a cell; node 0 has what they leave.
        forces = self._volume[:, None, None] * stress @ np.swapaxes(self._inverse, 1, 2)
        residual = self._mass * (x - self.flight(dt)) / dt**2
        for corner in range(3):
            np.add.at(residual, self._cells[:, corner + 1], forces[:, :, corner])
        np.add.at(residual, self._cells[:, 0], -forces.sum(axis=2))
        return float(np.linalg.norm(residual[self._is_free]))

    def flight(self, dt: float) -> Any:
        """Return positions after a step of free flight, clamped nodes at rest (n, 3) [m]."""
        flight = self._start.copy()
        flight[self._is_free, 1] -= dt**2 * _GRAVITY
        return flight


def follow(block: Any, law: str, advance: Callable[[float, int], Any]) -> list[list[float | None]]:
    """Residual that steps of each stiffness number leave after given numbers of iterations, over that of free flight.

    Parameters
    ----------
    block : mapping
        As written by `verification.benchmarks.xpbd_case.dump`: also ``time_steps`` [s] and ``looks``.
    law : str
        See `first_piola`.
    advance : callable
        Takes a time step [s] and a number of iterations; returns positions (n, 3) [m].

    Returns
    -------
    list of list
        A row for each time step; None where something is not finite.
    """
    residual, rows = StepResidual(block, law), []
    for dt in block["time_steps"].tolist():
        first = residual.norm(residual.flight(dt), dt)
        with np.errstate(all="ignore"):  # of what is not finite
            found = [residual.norm(np.asarray(advance(dt, int(n)), float), dt) / first for n in block["looks"]]
        rows.append([value if math.isfinite(value) else None for value in found])
    return rows
