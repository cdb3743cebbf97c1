"""Child processes of the material point benchmark that take implicit steps, or steps of a scene: one case each.

``python -m verification.benchmarks.mpm_step_case CASE RESULT``: CASE is a JSON file with ``kind`` and more.
"""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from femdeform import jit
from femdeform.contact.obstacles import Sphere
from femdeform.mpm.grid import Grid
from femdeform.mpm.groups import Groups
from femdeform.mpm.heat import HeatConduction
from femdeform.mpm.implicit_step import solve_step
from femdeform.mpm.particle_sampling import sample_particles
from femdeform.mpm.particles import LIQUID
from femdeform.mpm.point_potential import PointPotential
from femdeform.mpm.point_terms import PointMaterials, SurfaceTension
from femdeform.mpm.surface_sampling import SurfaceSampler
from solvers.linear.block_cg import BlockCG
from verification.benchmarks import child_process

RADIUS, DENSITY = 0.2, 10.0
# Surface tension [N/m] by dimension.
TENSION = {2: 0.1, 3: 1.0}
_SCENES = Path(__file__).resolve().parents[2] / "scenes" / "mpm"
PHASES = ("sampling", "split", "heat", "to grid", "solve", "to points", "step")


def linear_solver(name: str) -> Any:
    """`block_cg`, or a preset of PETSc."""
    if name == "block_cg":
        return BlockCG(1e-6)
    from solvers.linear.ksp import KSP

    return KSP(name)


def courant(case: dict[str, Any]) -> dict[str, Any]:
    """Iterations of the first linear solve of an implicit step of a drop.

    Parameters
    ----------
    case : dict
        ``dim``, ``cells`` along a unit length, ``numbers``: Courant numbers c dt/dx of sound, which the bulk modulus
        sets while dt is half the period of the shortest capillary wave over 2 pi; ``method``: see `linear_solver`.

    Returns
    -------
    dict
        ``unknowns``; ``iterations``, ``converged``, ``reasons``: of each Courant number.
    """
    dim, spacing = case["dim"], 1.0 / case["cells"]
    grid, k = Grid(spacing, "quadratic"), TENSION[case["dim"]]
    particles = sample_particles(Sphere(np.full(dim, 0.5), RADIUS, False), spacing, 2, DENSITY)
    particles.phase[:] = LIQUID
    samples = SurfaceSampler(spacing).sample(particles.x, 0)
    groups = Groups.split(particles.x, particles.mass, samples, grid)
    mass, velocity = groups.to_grid(particles.v, particles.affine)
    dt = 0.5 * float(np.sqrt(DENSITY * spacing**3 / (2.0 * np.pi * k)))
    found: dict[str, Any] = {"iterations": [], "converged": [], "reasons": []}
    for number in case["numbers"]:
        bulk = DENSITY * (number * spacing / dt) ** 2
        materials = PointMaterials({}, np.full(particles.n, bulk), np.zeros(particles.n))
        potential = PointPotential(np.zeros(dim), True)
        tension = SurfaceTension(samples, np.full(samples.n, k))
        potential.begin_step(groups.stencils, mass, velocity, particles, materials, dt, tension)
        start = potential.solver_state(None).x
        solver = linear_solver(case["method"])
        result = solver.solve(potential.hessian(start, True), -potential.gradient(start))
        solver.destroy()
        found["iterations"].append(result.iterations)
        found["converged"].append(result.converged)
        found["reasons"].append(result.reason)
    return {"unknowns": int(velocity.size), "n": particles.n, "samples": samples.n, **found}


@contextmanager
def _clock(spent: dict[str, float], rows: list[dict[str, float]]) -> Iterator[None]:
    """Measure the parts of steps of scenes: `spent` are the seconds of the current step, `rows` those of all steps."""
    from femdeform.run import point_step

    def timed(function: Callable[..., Any], name: str) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            begin = time.perf_counter()
            answer = function(*arguments, **options)
            spent[name] += time.perf_counter() - begin
            if name == "step":
                rows.append(dict(spent))
                spent.clear()
            return answer

        return call

    split = Groups.split
    places: list[tuple[Any, str, Callable[..., Any], str]] = [
        (SurfaceSampler, "sample", SurfaceSampler.sample, "sampling"),
        (Groups, "split", split, "split"),
        (HeatConduction, "step", HeatConduction.step, "heat"),
        (Groups, "to_grid", Groups.to_grid, "to grid"),
        (Groups, "to_points", Groups.to_points, "to points"),
        (point_step, "solve_step", solve_step, "solve"),
        (point_step.PointStep, "take", point_step.PointStep.take, "step"),
    ]
    patches = [
        mock.patch.object(owner, attribute, timed(function, name)) for owner, attribute, function, name in places
    ]
    for patch in patches:
        patch.start()
    try:
        yield
    finally:
        for patch in patches:
            patch.stop()


def steps_of_scene(case: dict[str, Any]) -> dict[str, Any]:
    """Time the parts of steps of a scene, as table 3.2 of the source divides them.

    Parameters
    ----------
    case : dict
        ``scene``: a name in scenes/mpm; ``steps``: how many are taken; the first fifth is not counted.

    Returns
    -------
    dict
        ``n`` points, ``samples``, ``nodes``, ``scheme``, ``phases``: medians by name [s].
    """
    from femdeform.cli import main
    from femdeform.run.table import read_table
    from femdeform.scene.load import load_scene
    from femdeform.scene.point_schema import PointScene

    path = _SCENES / f"{case['scene']}.yaml"
    scene = load_scene(path).scene
    assert isinstance(scene, PointScene)
    settings = scene.time
    rows: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder, _clock(defaultdict(float), rows):
        out = Path(folder) / "out"
        end = f"time.end={case['steps'] * settings.dt}"
        # Expectations are those of the whole scene: its verdict does not matter here.
        code = main(["run", str(path), "--out", str(out), "--quiet", "--set", end, "--set", "expect={}"])
        if code != 0:
            raise RuntimeError(f"{path.name} ended with {code}")
        history = read_table(out / "history.csv")
        from femdeform.run.checkpoint import read_checkpoint

        n = len(read_checkpoint(out).fields["x"])
    counted = rows[len(rows) // 5 :]
    phases = {name: float(np.median([row.get(name, 0.0) for row in counted])) for name in PHASES}
    return {
        "n": n,
        "samples": int(history["samples"][-1]),
        "nodes": int(history["nodes"][-1]),
        "scheme": settings.scheme,
        "threads": jit.set_threads(),
        "phases": phases,
    }


if __name__ == "__main__":
    child_process.serve({"courant": courant, "scene": steps_of_scene})
