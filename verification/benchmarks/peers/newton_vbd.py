"""Vertex block descent of Newton (the physics engine, on Warp) on the block: milliseconds an iteration.

Run by the Python of the environment with the peers: ``python newton_vbd.py CASE RESULT``.
"""

from __future__ import annotations

import json
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

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

    wp.config.quiet = True
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
    points = block["points"]
    builder.add_soft_mesh(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0, 0.0, 0.0),
        vertices=[wp.vec3(*point) for point in points],
        indices=block["cells"].ravel().astype(int).tolist(),
        density=float(block["density"]),
        k_mu=float(block["mu"]),
        k_lambda=float(block["lmbda"]),
        k_damp=0.0,
        add_surface_mesh_edges=False,
        validate_mesh=False,
    )
    builder.color()
    colors = len(builder.particle_color_groups)
    for node in np.flatnonzero(points[:, 0] == 0.0):
        builder.particle_mass[int(node)] = 0.0
    model = builder.finalize(device="cpu")
    start, end, control = model.state(), model.state(), model.control()

    def step(iterations: int) -> float:
        solver = SolverVBD(model, iterations=iterations)
        start.particle_q.assign(block["positions"].astype(np.float32))
        start.particle_qd.zero_()
        begin = time.perf_counter()
        solver.step(start, end, control, None, float(block["dt"]))
        return time.perf_counter() - begin

    step(_FEW)
    times = [(step(_MANY) - step(_FEW)) / (_MANY - _FEW) for _ in range(_REPETITIONS)]
    moved = end.particle_q.numpy()
    if not np.all(np.isfinite(moved)):
        raise RuntimeError("its positions are not finite")
    return {
        "iteration": summary(times),
        "colors": colors,
        "notes": [
            f"version {newton.__version__} on Warp {wp.__version__}: stable neo-Hookean, float32, one thread, "
            f"{colors} colours"
        ],
    }


if __name__ == "__main__":
    # Behind everything else, so that nothing of this environment is hidden.
    sys.path.append(str(Path(__file__).resolve().parents[3]))
    answer: dict[str, Any]
    if find_spec("newton") is None or find_spec("warp") is None:
        answer = {"skipped": "Newton and Warp are not in the environment with the peers"}
    else:
        import numpy as np

        with np.load(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["block"]) as arrays:
            answer = compare(arrays)
    Path(sys.argv[2]).write_text(json.dumps(answer), encoding="utf-8")
