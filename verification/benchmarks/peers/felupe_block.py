"""FElupe on the block: residual vector, stiffness matrix and one Newton iteration with Jacobi-CG.

Run by the Python of the environment with the peers: ``python felupe_block.py CASE RESULT``.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import felupe
import numpy as np
import scipy.sparse
import scipy.sparse.linalg

_TOLERANCE = 1e-6
_MOST_ITERATIONS = 5000


def compare(block: Any) -> dict[str, Any]:
    """Time FElupe at the state that femdeform has written.

    Parameters
    ----------
    block : npz file
        As written by `verification.benchmarks.newton_case.dump`.

    Returns
    -------
    dict
        Summaries of seconds for ``residual``, ``tangent``, ``both`` and ``iteration``; peaks of memory [bytes].
    """
    from verification.benchmarks.measure import measure, peak_memory, summary

    mesh = felupe.Mesh(block["points"], block["cells"], cell_type="tetra")
    field = felupe.FieldContainer([felupe.Field(felupe.RegionTetra(mesh), dim=3)])
    mu, lmbda = float(block["mu"]), float(block["lmbda"])
    # Its standard law: isochoric neo-Hookean plus a volumetric term; it agrees with ours at small strain.
    body = felupe.SolidBody(felupe.NeoHooke(mu=mu, bulk=lmbda + 2.0 * mu / 3.0), field)
    field[0].values[:] = block["displacement"]

    def residual() -> Any:
        return body.assemble.vector(field)

    def tangent() -> Any:
        return body.assemble.matrix(field)

    result: dict[str, Any] = {
        "residual": measure(residual),
        "tangent": measure(tangent),
        "both": measure(lambda: (residual(), tangent())),
        "memory": peak_memory(),
    }
    free = np.ones(3 * mesh.npoints, dtype=bool)
    free.reshape(-1, 3)[block["fixed"]] = False
    free_dofs = np.flatnonzero(free)
    load = block["load"].ravel()
    steps = 0

    def count(_: Any) -> None:
        nonlocal steps
        steps += 1

    def iteration() -> tuple[Any, Any, Any]:
        nonlocal steps
        steps = 0
        r = (residual().toarray().ravel() - load)[free_dofs]
        K = tangent().tocsr()[free_dofs][:, free_dofs]
        jacobi = scipy.sparse.diags(1.0 / K.diagonal())
        dx, _ = scipy.sparse.linalg.cg(
            K, -r, rtol=_TOLERANCE, atol=0.0, maxiter=_MOST_ITERATIONS, M=jacobi, callback=count
        )
        return K, r, dx

    times = []
    remainder = float("inf")
    for _ in range(6):
        start = time.perf_counter()
        K, r, dx = iteration()
        times.append(time.perf_counter() - start)
        remainder = float(np.linalg.norm(K @ dx + r) / np.linalg.norm(r))
    if remainder < 10.0 * _TOLERANCE:
        result["iteration"] = summary(times[1:])
    result |= {
        "iterations": steps,
        "relative_residual": remainder,
        "iteration_memory": peak_memory(),
        "versions": {"felupe": felupe.__version__, "numpy": np.__version__, "scipy": scipy.__version__},
    }
    result["notes"] = [
        f"version {felupe.__version__}, NeoHooke (isochoric and volumetric part) with the same moduli; "
        f"Newton iteration with SciPy's CG and Jacobi, {steps} steps to {remainder:.1e}"
    ]
    return result


if __name__ == "__main__":
    # Behind everything else, so that nothing of this environment is hidden.
    sys.path.append(str(Path(__file__).resolve().parents[3]))
    with np.load(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["block"]) as arrays:
        answer = compare(arrays)
    Path(sys.argv[2]).write_text(json.dumps(answer), encoding="utf-8")
