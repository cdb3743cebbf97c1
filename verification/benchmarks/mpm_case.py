"""What the child processes of the material point benchmark do: one case each.

``python -m verification.benchmarks.mpm_case CASE RESULT``: CASE is a JSON file with ``kind`` and the case's own keys.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from femdeform import jit
from femdeform.contact.obstacles import Box
from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.materials.neo_hookean import NeoHookean
from femdeform.mpm.explicit import ExplicitPoints
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.grid import Grid
from femdeform.mpm.groups import Groups
from femdeform.mpm.heat import HeatBoundary, HeatConduction
from femdeform.mpm.particle_sampling import sample_particles
from femdeform.mpm.particles import LIQUID
from femdeform.mpm.surface_sampling import SurfaceSampler
from verification.benchmarks import child_process
from verification.benchmarks.measure import peak_memory, summary

DENSITY, MU, LMBDA = 1000.0, 1.0e5, 1.0e5
DT = 1.0e-4
PHASES = ("sort", "to grid", "to points")
SAMPLED_PHASES = ("surface", "stencils", "stencils of heat", "heat", "to grid", "to points")
# Seconds of steps that are timed, and steps at least and at most.
_ENOUGH, _FEWEST, _MOST = 4.0, 10, 60
_LAWS = {
    "neo_hookean": NeoHookean.from_lame(MU, LMBDA, 3),
    "fixed_corotated": FixedCorotated.from_lame(MU, LMBDA, 3),
    "liquid": Liquid(LMBDA, 0.0),
    "viscous liquid": Liquid(LMBDA, 10.0),
}


def cube(points: int, nodes: int, law: str, dtype: str, transfer: str = "apic") -> ExplicitPoints:
    """A cube with eight points a cell in the middle of a unit cube, in a swirling motion, jittered.

    Parameters
    ----------
    points : int
        About how many there shall be.
    nodes : int
        Grid cells along an edge of the unit cube.
    law, dtype, transfer : str
        A key of the materials of this module; ``float64`` or ``float32``; see `ExplicitPoints`.
    """
    dx = 1.0 / nodes
    half = 0.5 * dx * round((points / 8.0) ** (1.0 / 3.0))
    box = Box(np.full(3, 0.5 - half), np.full(3, 0.5 + half), False)
    particles = sample_particles(box, dx, 2, DENSITY, jitter=0.5, seed=1)
    offset = particles.x - 0.5
    particles.v[:] = np.column_stack([-offset[:, 1], offset[:, 0], 0.2 * np.sin(20.0 * offset[:, 0])])
    material = _LAWS[law]
    phase = LIQUID if isinstance(material, Liquid) else 0
    particles.phase[:] = phase
    return ExplicitPoints(
        particles,
        {(0, phase): material},
        dx,
        np.zeros(3),
        np.ones(3),
        transfer=transfer,  # type: ignore[arg-type]
        gravity=np.array([0.0, 0.0, -9.81]),
        dtype=np.dtype(dtype).type,
    )


def steps(case: dict[str, Any]) -> dict[str, Any]:
    """Time explicit steps, phase by phase.

    Parameters
    ----------
    case : dict
        ``points``, ``nodes``, ``law``, ``dtype``, ``transfer``: see `cube`.

    Returns
    -------
    dict
        ``n`` points, ``time``: summary of the seconds of a whole step, ``phases``: medians of its parts by name [s],
        ``momentum``: relative change of the linear momentum beside gravity's over all steps, ``memory`` [bytes].
    """
    dt = DT
    # Compile.
    cube(1000, case["nodes"], case["law"], case["dtype"], case["transfer"]).step(dt)
    explicit = cube(case["points"], case["nodes"], case["law"], case["dtype"], case["transfer"])
    explicit.step(dt)
    before = _momentum(explicit)
    rows: list[tuple[float, ...]] = []
    begin = time.perf_counter()
    while len(rows) < _FEWEST or (time.perf_counter() - begin < _ENOUGH and len(rows) < _MOST):
        marks = [time.perf_counter()]
        for work in (explicit.sort, lambda: explicit.to_grid(dt), lambda: explicit.to_points(dt)):
            work()
            marks.append(time.perf_counter())
        rows.append(tuple(np.diff(marks)))
    gained = _momentum(explicit) - before
    mass = sum(float(points.mass.sum(dtype=np.float64)) for points in explicit.sets)
    expected = mass * len(rows) * dt * explicit.gravity
    return {
        "n": explicit.n,
        "threads": jit.set_threads(),
        "time": summary([sum(row) for row in rows]),
        "phases": dict(zip(PHASES, np.median(rows, axis=0).tolist(), strict=True)),
        "momentum": float(np.abs(gained - expected).max() / np.abs(expected).max()),
        "memory": peak_memory(),
    }


def sampled(case: dict[str, Any]) -> dict[str, Any]:
    """Time the parts of a step with a sampled surface and heat that go through stored stencils.

    Parameters
    ----------
    case : dict
        ``points``, ``nodes``: see `cube`.

    Returns
    -------
    dict
        ``n`` points, ``samples`` of the surface, ``phases``: medians of its parts by name [s].
    """
    rows: list[tuple[float, ...]] = []
    for points, least in ((1000, 1), (case["points"], _FEWEST)):  # the first compiles
        particles = cube(points, case["nodes"], "neo_hookean", "float64").particles()
        particles.temperature[:] = 300.0 + 10.0 * particles.x[:, 0]
        spacing = 1.0 / case["nodes"]
        grid, sampler = Grid(spacing, "quadratic"), SurfaceSampler(spacing)
        conduction = HeatConduction(grid)
        rows = []
        for step in range(least):
            marks = [time.perf_counter()]
            samples = sampler.sample(particles.x, step)
            marks.append(time.perf_counter())
            groups = Groups.split(particles.x, particles.mass, samples, grid)
            marks.append(time.perf_counter())
            stencils = groups.stencils.of_first(particles.n)
            marks.append(time.perf_counter())
            # A tenth of the time that heat takes through a cell.
            dt = 0.1 * spacing**2 * DENSITY
            conduction.step(particles, samples, dt, 0.0, 1.0, 1.0, HeatBoundary(transfer=1.0), stencils=stencils)
            marks.append(time.perf_counter())
            _, velocity = groups.to_grid(particles.v, particles.affine)
            marks.append(time.perf_counter())
            groups.to_points(velocity)
            marks.append(time.perf_counter())
            rows.append(tuple(np.diff(marks)))
    return {
        "n": particles.n,
        "samples": samples.n,
        "threads": jit.set_threads(),
        "phases": dict(zip(SAMPLED_PHASES, np.median(rows, axis=0).tolist(), strict=True)),
    }


def _momentum(explicit: ExplicitPoints) -> Any:
    total = np.zeros(3)
    for points in explicit.sets:
        total += (points.mass[:, None].astype(np.float64) * points.v).sum(axis=0)
    return total


def dump(case: dict[str, Any]) -> dict[str, Any]:
    """Write the points of a case for the peers."""
    particles = cube(case["points"], case["nodes"], "neo_hookean", "float64").particles()
    np.savez(
        case["dump"],
        x=particles.x,
        v=particles.v,
        mass=particles.mass[0],
        volume=particles.volume[0],
        nodes=case["nodes"],
        mu=MU,
        lmbda=LMBDA,
        dt=DT,
    )
    return {}


if __name__ == "__main__":
    child_process.serve({"steps": steps, "sampled": sampled, "dump": dump})
