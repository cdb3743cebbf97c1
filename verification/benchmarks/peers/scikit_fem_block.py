"""Plain scikit-fem forms on the block: residual and tangent of the same law, checked against ours.

Run by the Python of the environment with the peers: ``python scikit_fem_block.py CASE RESULT``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from skfem.helpers import ddot, det, grad, identity, inv, transpose


def compare(block: Any) -> dict[str, Any]:
    """Time scikit-fem's forms at the state that femdeform has written; see `felupe_block.compare`."""
    from verification.benchmarks.measure import measure, peak_memory

    mu, lmbda = float(block["mu"]), float(block["lmbda"])
    lmbda_hat = lmbda + mu

    def cofactor(F: Any, J: Any) -> Any:
        return J * transpose(inv(F))

    @skfem.LinearForm
    def residual_form(v: Any, w: Any) -> Any:
        F = grad(w["displacement"]) + identity(grad(w["displacement"]))
        J = det(F)
        return ddot(mu * F + (lmbda_hat * (J - 1.0) - mu) * cofactor(F, J), grad(v))

    @skfem.BilinearForm
    def tangent_form(du: Any, v: Any, w: Any) -> Any:
        F = grad(w["displacement"]) + identity(grad(w["displacement"]))
        J = det(F)
        C = cofactor(F, J)
        dF = grad(du)
        dJ = ddot(C, dF)
        # d cof F = ((cof F : dF) cof F - cof F dF^T cof F) / J
        dC = (dJ * C - _product(_product(C, transpose(dF)), C)) / J
        return ddot(mu * dF + lmbda_hat * dJ * C + (lmbda_hat * (J - 1.0) - mu) * dC, grad(v))

    points, cells = block["points"].T.copy(), block["cells"].T.copy()
    mesh = skfem.MeshTet1(points, cells, sort_t=False, validate=False)
    # One quadrature point: exact for linear tetrahedra, and the cheapest.
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP1()), intorder=0)
    displacement = np.zeros(basis.N)
    displacement[basis.nodal_dofs] = block["displacement"].T

    def residual() -> Any:
        return residual_form.assemble(basis, displacement=basis.interpolate(displacement))

    def tangent() -> Any:
        return tangent_form.assemble(basis, displacement=basis.interpolate(displacement))

    result: dict[str, Any] = {
        "residual": measure(residual),
        "tangent": measure(tangent),
        "both": measure(lambda: (residual(), tangent())),
        "memory": peak_memory(),
        "versions": {"scikit-fem": skfem.__version__, "numpy": np.__version__},
    }
    direction = np.zeros(basis.N)
    direction[basis.nodal_dofs] = block["direction"].T
    forces = _distance(residual()[basis.nodal_dofs].T, block["forces"])
    product = _distance((tangent() @ direction)[basis.nodal_dofs].T, block["product"])
    result |= {"difference_forces": forces, "difference_product": product}
    result["notes"] = [
        f"version {skfem.__version__}, the same law; its forces differ from ours by {forces:.0e}, "
        f"its tangent times a vector by {product:.0e} (relative)"
    ]
    return result


def _product(A: Any, B: Any) -> Any:
    return np.einsum("ij...,jk...->ik...", A, B)


def _distance(a: Any, b: Any) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


if __name__ == "__main__":
    # Behind everything else, so that nothing of this environment is hidden.
    sys.path.append(str(Path(__file__).resolve().parents[3]))
    with np.load(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["block"]) as arrays:
        answer = compare(arrays)
    Path(sys.argv[2]).write_text(json.dumps(answer), encoding="utf-8")
