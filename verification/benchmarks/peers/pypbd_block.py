"""XPBD of pyPBD (the PositionBasedDynamics library) on the block: milliseconds an iteration.

Run by the Python of the environment with the peers: ``python pypbd_block.py CASE RESULT``.
"""

from __future__ import annotations

import json
import os
import sys
import time
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_FEW, _MANY, _REPETITIONS = 1, 11, 5
# XPBD on the strain energy of St. Venant and Kirchhoff in the numbering of the library.
_XPBD_FEM = 3


def compare(block: Any) -> dict[str, Any]:
    """Time a step of the block with few and with many iterations; the difference counts.

    Parameters
    ----------
    block : npz file
        As written by `verification.benchmarks.xpbd_case.dump`.
    """
    import numpy as np
    import pypbd

    from verification.benchmarks.measure import summary
    from verification.benchmarks.step_residual import follow

    points, cells, positions = block["points"], block["cells"], block["positions"]
    mu, lmbda = float(block["mu"]), float(block["lmbda"])
    modulus, ratio = mu * (3.0 * lmbda + 2.0 * mu) / (lmbda + mu), 0.5 * lmbda / (lmbda + mu)
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    share = float(block["density"]) * np.linalg.det(edges) / 24.0
    mass = np.bincount(cells.ravel(), np.repeat(share, 4), minlength=len(points))
    mass[points[:, 0] == 0.0] = 0.0

    simulation = pypbd.Simulation.getCurrent()
    simulation.initDefault()
    model, stepper = simulation.getModel(), simulation.getTimeStep()
    body = model.addTetModel(list(points), cells.ravel().tolist())
    particles = model.getParticles()
    for node, own in enumerate(mass):
        particles.setMass(node, float(own))
    model.addSolidConstraints(body, _XPBD_FEM, modulus, ratio, 1.0, False, False)
    stepper.setValueUInt(pypbd.TimeStepController.NUM_SUB_STEPS, 1)

    def step(iterations: int, dt: float = float(block["dt"])) -> float:
        pypbd.TimeManager.getCurrent().setTimeStepSize(dt)
        stepper.setValueUInt(pypbd.TimeStepController.MAX_ITERATIONS, iterations)
        for node, position in enumerate(positions):
            particles.setPosition(node, position)
            particles.setVelocity(node, np.zeros(3))
        begin = time.perf_counter()
        stepper.step(model)
        return time.perf_counter() - begin

    step(_FEW)
    times = [(step(_MANY) - step(_FEW)) / (_MANY - _FEW) for _ in range(_REPETITIONS)]

    def advance(dt: float, iterations: int) -> Any:
        step(iterations, dt)
        return np.array([particles.getPosition(node) for node in range(len(points))])

    away = float(np.abs(advance(float(block["dt"]), _MANY) - positions).max())
    return {
        "iteration": summary(times),
        "reached": follow(block, "saint_venant_kirchhoff", advance),
        "threads": int(os.environ.get("OMP_NUM_THREADS", os.cpu_count() or 1)),
        "notes": [
            f"version {version('pypbd')}: St. Venant-Kirchhoff; after {_MANY} iterations nodes have moved by at most "
            f"{away:.1e} m in the step"
        ],
    }


if __name__ == "__main__":
    # Behind everything else, so that nothing of this environment is hidden.
    sys.path.append(str(Path(__file__).resolve().parents[3]))
    answer: dict[str, Any]
    if find_spec("pypbd") is None:
        answer = {"skipped": "pyPBD is not in the environment with the peers"}
    else:
        import numpy as np

        with np.load(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["block"]) as arrays:
            answer = compare(arrays)
    Path(sys.argv[2]).write_text(json.dumps(answer), encoding="utf-8")
