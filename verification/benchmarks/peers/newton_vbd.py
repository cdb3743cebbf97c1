"""Vertex block descent of Newton (the physics engine, on Warp) on the block: milliseconds an iteration.

Run by the Python of the environment with the peers: ``python newton_vbd.py CASE RESULT``.
"""

from __future__ import annotations

import time
from typing import Any

from newton_block import make_block, serve

_FEW, _MANY, _REPETITIONS = 1, 11, 5


def compare(block: Any) -> dict[str, Any]:
    """Time a step of the block with few and with many iterations; the difference counts.

    Parameters
    ----------
    block : npz file
        As written by `verification.benchmarks.pbng_case.dump`.
    """
    import newton
    import numpy as np
    import warp as wp
    from newton.solvers import SolverVBD

    from verification.benchmarks.measure import summary
    from verification.benchmarks.step_residual import follow

    model, colors = make_block(block, colored=True)
    start, end, control = model.state(), model.state(), model.control()

    def step(iterations: int, dt: float = float(block["dt"])) -> float:
        solver = SolverVBD(model, iterations=iterations)
        start.particle_q.assign(block["positions"].astype(np.float32))
        start.particle_qd.zero_()
        begin = time.perf_counter()
        solver.step(start, end, control, None, dt)
        return time.perf_counter() - begin

    step(_FEW)
    times = [(step(_MANY) - step(_FEW)) / (_MANY - _FEW) for _ in range(_REPETITIONS)]
    moved = end.particle_q.numpy()
    if not np.all(np.isfinite(moved)):
        raise RuntimeError("its positions are not finite")

    def advance(dt: float, iterations: int) -> Any:
        step(iterations, dt)
        return end.particle_q.numpy()

    return {
        "iteration": summary(times),
        # Only the benchmark of XPBD asks for it.
        "reached": follow(block, "neo_hookean", advance) if "looks" in block else [],
        "threads": 1,
        "colors": colors,
        "notes": [
            f"version {newton.__version__} on Warp {wp.__version__}: stable neo-Hookean, float32, one thread, "
            f"{colors} colours"
        ],
    }


if __name__ == "__main__":
    serve(compare)
