"""Small results, made by hand, to draw and report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from femdeform.run import flow_course
from femdeform.run.deformable import COLUMNS
from femdeform.run.recorder import Recorder
from femdeform.run.vti import VTIWriter
from femdeform.run.vtp import VTPWriter
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


def record_flow(folder: Path, shape: tuple[int, int, int], title: str = "Smoke", without: tuple[str, ...] = ()) -> Path:
    """Three frames of a ball of smoke that rises along y beside a solid block, in a grid 1 m wide; 2D if shape[2] is 1.

    The velocity turns like a wheel: (-y, x), vorticity 2. `without` names fields that are left out.
    """
    side = 1.0 / shape[0]
    recorder = Recorder(folder, VTIWriter(shape, side, (0.0, 0.0, 0.0)), flow_course.COLUMNS)
    boundaries = {name: "open" if name == "top" else "wall" for name in ("left", "right", "bottom", "top")}
    resolved = {"title": title, "simulation": "incompressible_flow", "boundaries": boundaries, "time": {"dt": 0.5}}
    recorder.start(resolved, {"title": title, "simulation": "incompressible_flow", "solids": ["block"], "n_dofs": 7})
    axes = [side * (np.arange(n) + 0.5) for n in shape]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    middle = axes[2].mean()
    solid = (x > 0.7) & (x < 0.9) & (y > 0.4) & (y < 0.6) & (abs(z - middle) < 0.2)
    velocity = np.stack([-y, x, 0.0 * x], axis=-1)[..., : 2 if shape[2] == 1 else 3]
    cells: dict[str, list[np.ndarray]] = {}
    for step in range(3):
        time = 0.5 * step
        distance = np.sqrt((x - 0.3) ** 2 + (y - 0.25 - 0.4 * time) ** 2 + (z - middle) ** 2)
        density = np.where(solid, 0.0, np.clip(1.5 - distance / 0.12, 0.0, 1.0))
        cells = {"density": [density], "velocity": [velocity], "solid": [solid.astype(np.uint8)]}
        cells = {name: values for name, values in cells.items() if name not in without}
        if step:
            row = {"dt": 0.5, "substeps": 2, "iterations": 5, "relative_residual": 1e-7 * step, "seconds": 0.1}
            found = {
                "divergence_before": 2.0,
                "divergence": 1e-6,
                "imbalance": 0.0,
                "kinetic_energy": time,
                "smoke": 0.1,
            }
            recorder.step(
                {"step": step, "time": time, "smoke": 0.1, **row, **found, "measure.height": 0.25 + 0.4 * time}
            )
        recorder.frame(step, time, {}, cells)
    recorder.finish("done", "", {"wall_seconds": 1.5}, {}, cells)
    return folder


def record_particles(folder: Path, dim: int, n: int = 12, **more: np.ndarray) -> Path:
    """Three frames of two blocks of n^dim particles, 0.6 m wide and 0.05 m apart if n is 12, that fall beside a wall.

    The lower block melts: its phase is 1 from the second frame on. `more` are further fields.
    """
    columns = ("step", "time", "dt", "iterations", "relative_residual", "kinetic_energy", "elastic_energy")
    recorder = Recorder(folder, VTPWriter(), columns)
    side = 0.6 / n
    block = side * (np.stack(np.meshgrid(*[np.arange(n)] * dim, indexing="ij"), axis=-1).reshape(-1, dim) + 0.5)
    up = np.eye(dim)[1]
    rest = np.concatenate([block, block + 1.0 * up])
    body = np.repeat(np.array([0, 1], dtype=np.int32), len(block))
    wall = {"kind": "plane", "point": [0.0] * dim, "normal": up.tolist()}
    facts = {"title": "Drops", "simulation": "material_points", "bodies": ["low", "high"], "obstacles": [wall]}
    recorder.start({"title": "Drops", "simulation": "material_points", "gravity": (-9.81 * up).tolist()}, facts)
    data: dict[str, np.ndarray] = {}
    for step in range(3):
        time = 0.1 * step
        data = {
            "position": rest + 0.3 * (1 - step) * up,
            "velocity": np.tile(-9.81 * time * up, (len(rest), 1)) * (1.0 + body[:, None]),
            "temperature": 300.0 + 100.0 * body + 10.0 * step,
            "phase": ((body == 0) & (step > 0)).astype(np.int8),
            "body": body,
            **more,
        }
        if step:
            row = {"dt": 0.1, "iterations": 3, "relative_residual": 1e-8, "surface_energy": 0.3, "n_particles": 2 * n}
            energies = {"kinetic_energy": time, "elastic_energy": time**2}
            recorder.step({"step": step, "time": time, **row, **energies, "measure.height": 1.0 - time})
        recorder.frame(step, time, data)
    recorder.finish("done", "", {"wall_seconds": 1.5}, data)
    return folder
