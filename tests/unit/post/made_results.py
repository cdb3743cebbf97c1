"""Small results, made by hand, to draw and report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from femdeform.run.deformable import COLUMNS
from femdeform.run.recorder import Recorder
from femdeform.run.vtu import FrameMesh, VTUWriter

N_FRAMES = 5

# Six tetrahedra around the diagonal of a cube whose corner (a, b, c) is number 4 a + 2 b + c, all positive.
_CUBE = [(0, 4, 6, 7), (0, 6, 2, 7), (0, 2, 3, 7), (0, 3, 1, 7), (0, 1, 5, 7), (0, 5, 4, 7)]
TETRA_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))


def block(n: tuple[int, int, int], size: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Points and tetrahedra of a block."""
    axes = [np.linspace(0.0, s, k + 1) for s, k in zip(size, n, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape([k + 1 for k in n])
    corners = [number[a : n[0] + a, b : n[1] + b, c : n[2] + c].ravel() for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    return points, np.concatenate([np.stack([corners[k] for k in cell], axis=1) for cell in _CUBE])


def quadratic(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same tetrahedra with nodes on the middle of their edges, in VTK's order."""
    edges = np.sort(np.concatenate([cells[:, list(edge)] for edge in TETRA_EDGES]), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    middle = len(points) + inverse.reshape(6, -1).T
    return np.concatenate([points, points[unique].mean(axis=1)]), np.concatenate([cells, middle], axis=1)


def record(
    folder: Path,
    mesh: FrameMesh,
    move: Callable[[float], np.ndarray],
    *,
    title: str = "A test",
    status: str = "done",
    reason: str = "",
    facts: dict[str, Any] | None = None,
    gravity: list[float] | None = None,
    cell_data: Callable[[float], dict[str, list[np.ndarray]]] | None = None,
) -> Path:
    """Record `N_FRAMES` frames of a motion given over the time 0 to 1 s."""
    recorder = Recorder(folder, VTUWriter(mesh), COLUMNS, trace=True)
    resolved = {
        "title": title,
        "simulation": "deformable",
        "gravity": gravity or [0.0, -9.81, 0.0],
        "time": {"scheme": "backward_euler", "dt": 0.25, "end": 1.0},
        "solver": {"method": "projected_newton", "line_search": {"armijo": 1e-4}},
        "linear_solver": {"method": "ksp", "preset": "newton-mumps"},
    }
    known = {"title": title, "n_dofs": 12345, "ranks": 1, "versions": {"numpy": "2.0"}}
    recorder.start(resolved, {**known, **(facts or {})})
    for step in range(N_FRAMES):
        time = step / (N_FRAMES - 1)
        displacement = move(time)
        if step:
            for iteration in range(4):
                recorder.iteration(
                    {"step": step, "iteration": iteration, "relative_residual": 10.0 ** (-2 * iteration - step)}
                )
            numbers = {"dt": 0.25, "iterations": 4, "linear_iterations": 4, "residual_norm": 1e-7, "seconds": 0.1}
            energies = {"kinetic_energy": time, "elastic_energy": time**2}
            energies |= {"potential_energy": -time, "contact_energy": 0.0}
            recorder.step({"step": step, "time": time, "relative_residual": 10.0**-step, **numbers, **energies})
        fields = cell_data(time) if cell_data is not None else {}
        recorder.frame(step, time, {"displacement": displacement, "velocity": 2.0 * displacement}, fields)
    verdict = {"quantity": "volume_ratio", "computed": 1.01, "expected": 1.0, "rtol": 0.02, "passed": True}
    recorder.finish(status, reason, {"wall_seconds": 12.5, "expect": [verdict]}, {"displacement": move(1.0)})
    return folder
