"""XPBD of Newton (the physics engine, on Warp) on the block: milliseconds an iteration.

Run by the Python of the environment with the peers: ``python newton_xpbd.py CASE RESULT``.
"""

from __future__ import annotations

import time
from typing import Any

from newton_block import make_block, serve

_FEW, _MANY, _REPETITIONS = 1, 11, 5
# At the default of 0.9 its Jacobi sweeps diverge on tetrahedra.
_RELAXATION = 0.1


def compare(block: Any) -> dict[str, Any]:
    """Time a step of the block with few and with many iterations; the difference counts."""
    import newton
    import numpy as np
    import warp as wp
    from newton.solvers import SolverXPBD

    from verification.benchmarks.measure import summary
    from verification.benchmarks.step_residual import follow

    model, _ = make_block(block)
    start, end, control = model.state(), model.state(), model.control()

    def step(iterations: int, dt: float = float(block["dt"])) -> float:
        solver = SolverXPBD(model, iterations=iterations, soft_body_relaxation=_RELAXATION)
        start.particle_q.assign(block["positions"].astype(np.float32))
        start.particle_qd.zero_()
        begin = time.perf_counter()
        solver.step(start, end, control, None, dt)
        return time.perf_counter() - begin

    step(_FEW)
    times = [(step(_MANY) - step(_FEW)) / (_MANY - _FEW) for _ in range(_REPETITIONS)]
    is_finite = bool(np.all(np.isfinite(end.particle_q.numpy())))
    outcome = "positions stay finite" if is_finite else "positions are no longer finite"

    def advance(dt: float, iterations: int) -> Any:
        step(iterations, dt)
        return end.particle_q.numpy()

    return {
        "iteration": summary(times),
        "reached": follow(block, "trace_and_determinant", advance),
        "threads": 1,
        "notes": [
            f"version {newton.__version__} on Warp {wp.__version__}: Jacobi sweeps, float32, relaxation "
            f"{_RELAXATION:g}; after {_MANY} iterations {outcome}"
        ],
    }


if __name__ == "__main__":
    serve(compare)
