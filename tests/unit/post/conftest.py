"""Results to draw and report; written once, not to be changed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_results import block, quadratic, record, record_flow, record_particles

from femdeform.run.vtu import FrameMesh


@pytest.fixture(autouse=True)
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are made without one."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)


@pytest.fixture(scope="session")
def beam(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A block that is sheared upwards."""
    points, cells = block((6, 2, 2), (1.0, 0.2, 0.2))
    mesh = FrameMesh(points, [("tetra", cells)], {"body": [np.zeros(len(cells), dtype=np.int64)]})

    def move(time: float) -> np.ndarray:
        return np.stack([0.0 * points[:, 0], 0.4 * time * points[:, 0] ** 2, 0.0 * points[:, 0]], axis=1)

    def fields(time: float) -> dict[str, list[np.ndarray]]:
        return {
            "von_mises": [1e5 * time * points[cells].mean(axis=1)[:, 0]],
            "cauchy_stress": [np.tile(np.arange(9.0), (len(cells), 1))],
        }

    return record(tmp_path_factory.mktemp("results") / "beam", mesh, move, title="A beam", cell_data=fields)


@pytest.fixture(scope="session")
def assembly(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A P2 block, a membrane and a rod, with obstacles."""
    points, cells = quadratic(*block((2, 2, 2), (0.5, 0.5, 0.5)))
    cloth = np.array([[0.0, 0.8, 0], [1, 0.8, 0], [1, 0.8, 1], [0, 0.8, 1]])
    rod = np.stack([np.linspace(0, 1, 6), np.full(6, 1.0), np.full(6, 0.5)], axis=1)
    all_points = np.concatenate([points, cloth, rod])
    n, m = len(points), len(points) + 4
    blocks = [
        ("tetra10", cells),
        ("triangle", n + np.array([[0, 1, 2], [0, 2, 3]])),
        ("line", m + np.stack([np.arange(5), np.arange(1, 6)], axis=1)),
    ]
    mesh = FrameMesh(all_points, blocks, {"body": [np.full(len(c), i) for i, (_, c) in enumerate(blocks)]})

    def move(time: float) -> np.ndarray:
        return np.stack([0 * all_points[:, 0], -0.2 * time * all_points[:, 1], 0 * all_points[:, 0]], axis=1)

    obstacles = [
        {"kind": "plane", "point": [0, 0, 0], "normal": [0, 1, 0], "friction": 0.3},
        {"kind": "sphere", "center": [1.5, 0.3, 0.5], "radius": 0.3, "velocity": [-0.5, 0, 0]},
        {"kind": "box", "min": [-0.5, 0, 0], "max": [-0.2, 0.3, 0.3]},
        {"kind": "something new"},
        {"kind": "sphere"},
    ]
    facts = {"bodies": ["block", "cloth", "rod"], "obstacles": obstacles}
    return record(tmp_path_factory.mktemp("results") / "assembly", mesh, move, title="Several <bodies>", facts=facts)


@pytest.fixture(scope="session")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two triangles in 2D above a ground line."""
    points = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    mesh = FrameMesh(points, [("triangle", np.array([[0, 1, 2], [0, 2, 3]]))], {})
    facts = {"obstacles": [{"kind": "plane", "point": [0, -0.2], "normal": [0, 1]}]}
    folder = tmp_path_factory.mktemp("results") / "plane"
    return record(folder, mesh, lambda time: 0.2 * time * points, facts=facts, gravity=[0.0, -9.81])


@pytest.fixture(scope="session")
def flow_2d(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Smoke beside a solid in the plane."""
    return record_flow(tmp_path_factory.mktemp("results") / "flow_2d", (24, 32, 1), "Smoke in the plane")


@pytest.fixture(scope="session")
def flow_3d(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Smoke beside a solid in space."""
    return record_flow(tmp_path_factory.mktemp("results") / "flow_3d", (16, 20, 16), "Smoke in space")


@pytest.fixture(scope="session")
def drops_2d(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Particles in the plane."""
    return record_particles(tmp_path_factory.mktemp("results") / "drops_2d", 2)


@pytest.fixture(scope="session")
def drops_3d(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Particles in space."""
    return record_particles(tmp_path_factory.mktemp("results") / "drops_3d", 3)
