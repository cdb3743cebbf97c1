"""An MLS-MPM step of neo-Hookean points written in Taichi, on the processor: points a second.

Run by the Python of the environment with the peers: ``python taichi_mpm.py CASE RESULT``. The kernel is of the kind
that is usual there: atomic additions into a dense grid, APIC, and the moving-least-squares form of the forces.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

_REPETITIONS = 12


def serve() -> None:
    """Read the case, time it, write the result; say so if Taichi is not installed."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
    case = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    try:
        import taichi
    except ImportError as error:
        result: dict[str, Any] = {"skipped": f"Taichi is not installed: {error}"}
    else:
        result = run(taichi, case)
    Path(sys.argv[2]).write_text(json.dumps(result), encoding="utf-8")


def run(ti: Any, case: dict[str, Any]) -> dict[str, Any]:
    """Time steps of the points in ``case["dump"]`` with ``case["threads"]`` threads in ``case["dtype"]``."""
    import numpy as np

    from verification.benchmarks.measure import summary

    real = ti.f64 if case["dtype"] == "float64" else ti.f32
    ti.init(arch=ti.cpu, default_fp=real, cpu_max_num_threads=case["threads"], log_level=ti.ERROR, offline_cache=False)
    data = np.load(case["dump"])
    n, nodes = len(data["x"]), int(data["nodes"])
    dx = 1.0 / nodes
    inverse, dt = float(nodes), float(data["dt"])
    p_mass, p_volume = float(data["mass"]), float(data["volume"])
    mu, lmbda = float(data["mu"]), float(data["lmbda"])
    x, v = ti.Vector.field(3, real, n), ti.Vector.field(3, real, n)
    C, F = ti.Matrix.field(3, 3, real, n), ti.Matrix.field(3, 3, real, n)
    grid_v, grid_m = ti.Vector.field(3, real, (nodes,) * 3), ti.field(real, (nodes,) * 3)
    x.from_numpy(data["x"].astype(case["dtype"]))
    v.from_numpy(data["v"].astype(case["dtype"]))
    F.from_numpy(np.tile(np.eye(3, dtype=case["dtype"]), (n, 1, 1)))

    @ti.kernel
    def clear():  # type: ignore[no-untyped-def]
        for i in ti.grouped(grid_m):
            grid_v[i] = ti.Vector.zero(real, 3)
            grid_m[i] = 0.0

    @ti.kernel
    def to_grid():  # type: ignore[no-untyped-def]
        for p in x:
            base = (x[p] * inverse - 0.5).cast(int)
            fx = x[p] * inverse - base.cast(real)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2]
            F[p] = F[p] + dt * C[p] @ F[p]
            J = F[p].determinant()
            cofactor = J * F[p].inverse().transpose()
            P = mu * F[p] + ((lmbda + mu) * (J - 1.0) - mu) * cofactor
            affine = (-dt * p_volume * 4.0 * inverse * inverse) * P @ F[p].transpose() + p_mass * C[p]
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                distance = (offset.cast(real) - fx) * dx
                weight = w[i][0] * w[j][1] * w[k][2]
                grid_v[base + offset] += weight * (p_mass * v[p] + affine @ distance)
                grid_m[base + offset] += weight * p_mass

    @ti.kernel
    def on_grid():  # type: ignore[no-untyped-def]
        for i in ti.grouped(grid_m):
            if grid_m[i] > 0.0:
                grid_v[i] = grid_v[i] / grid_m[i]
                grid_v[i][2] -= dt * 9.81

    @ti.kernel
    def to_points():  # type: ignore[no-untyped-def]
        for p in x:
            base = (x[p] * inverse - 0.5).cast(int)
            fx = x[p] * inverse - base.cast(real)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_v = ti.Vector.zero(real, 3)
            new_C = ti.Matrix.zero(real, 3, 3)
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                distance = offset.cast(real) - fx
                value = w[i][0] * w[j][1] * w[k][2] * grid_v[base + offset]
                new_v += value
                new_C += 4.0 * inverse * value.outer_product(distance)
            v[p] = new_v
            C[p] = new_C
            x[p] += dt * new_v

    def step() -> float:
        begin = time.perf_counter()
        clear()
        to_grid()
        on_grid()
        to_points()
        ti.sync()
        return time.perf_counter() - begin

    for _ in range(3):
        step()
    return {
        "time": summary([step() for _ in range(_REPETITIONS)]),
        "n": n,
        "threads": case["threads"],
        "notes": [f"version {ti.__version__}, MLS-MPM with atomic additions into a dense grid of {nodes}^3 nodes"],
    }


if __name__ == "__main__":
    serve()
