"""Quantities per cell for output and for judging a run: deformation gradients, stresses, volumes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from femdeform.fem import fibre_kernels
from femdeform.fem.discretization import ElementGroup
from femdeform.fem.energies import ElasticEnergy
from femdeform.types import FloatArray

# Components of each cell field, by its word in a scene.
CELL_FIELDS = ("von_mises", "jacobian", "energy_density", "cauchy_stress", "pk1")


def deformation_gradients(group: ElementGroup, x: FloatArray) -> FloatArray:
    """F of every cell at every quadrature point, (n_cells, n_q, d, d)."""
    return np.asarray(np.einsum("eac,eqak->eqck", x[group.cells], group.gradients, optimize=True))


def jacobians(group: ElementGroup, x: FloatArray) -> FloatArray:
    """Volume, area or length ratio at every quadrature point, (n_cells, n_q); signed for solids."""
    F = deformation_gradients(group, x)
    if group.kind == "solid":
        return np.asarray(np.linalg.det(F))
    stretches = np.linalg.svd(F, compute_uv=False)
    return np.asarray(np.prod(stretches[..., : group.cells.shape[1] - 1], axis=-1))


def cell_field(name: str, term: ElasticEnergy, x: FloatArray) -> FloatArray:
    """Evaluate one field of a scene's `output.fields` on the cells of a group.

    Parameters
    ----------
    name : str
        One of `CELL_FIELDS`.
    term : ElasticEnergy
        The group's energy.
    x : (n_local, dim) float64
        Positions [m].

    Returns
    -------
    (n_cells,) or (n_cells, 9) float64
        Volume averages over each cell; tensors row-major, 3x3 also in 2D; stresses [Pa], NaN for membranes and
        rods, whose stress across is a reaction to the frozen thickness.
    """
    group = term.group
    volume = group.weights.sum(axis=1)
    if name == "energy_density":
        return np.asarray(term.cell_energies(x) / volume)
    if name == "jacobian":
        return np.asarray((group.weights * jacobians(group, x)).sum(axis=1) / volume)
    if group.kind != "solid":
        return np.full(group.n_cells if name == "von_mises" else (group.n_cells, 9), np.nan)
    stress = _average_stress(group, x, spatial=name != "pk1")
    if name == "von_mises":
        return _von_mises(stress)
    return stress.reshape(-1, 9)


def _average_stress(group: ElementGroup, x: FloatArray, spatial: bool) -> FloatArray:
    """Cauchy stress, or PK1, averaged over each cell, (n_cells, 3, 3).

    In plane strain the stress across the plane is that of the three-dimensional law at diag(F, 1).
    """
    from femdeform.materials import batch

    F = deformation_gradients(group, x)
    d = F.shape[-1]
    P = np.asarray(batch.pk1(np.ascontiguousarray(F.reshape(-1, d, d)), group.law)).reshape(F.shape)
    if d == 2:
        spread = np.zeros((*F.shape[:2], 3, 3))
        spread[..., :2, :2], spread[..., 2, 2] = F, 1.0
        law = type(group.law).from_lame(group.law.mu, group.law.lmbda, 3)
        full = np.asarray(batch.pk1(spread.reshape(-1, 3, 3), law)).reshape(spread.shape)
        full[..., :2, :2] = P
        F, P = spread, full
    for f in group.fibres:
        t = np.empty((*f.weights.shape[:2], 3))
        fibre_kernels.stresses(x, group.cells, f.rows, f.weights, f.muscle.law, t)
        P[f.rows, :, :, :d] += t[..., None] * f.directions[:, None, None, :]
    if spatial:
        P = P @ np.swapaxes(F, -1, -2) / np.linalg.det(F)[..., None, None]
    return np.asarray(np.einsum("eq,eqij->eij", group.weights, P) / group.weights.sum(axis=1)[:, None, None])


def _von_mises(stress: FloatArray) -> FloatArray:
    deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    return np.asarray(np.sqrt(1.5 * np.einsum("eij,eij->e", deviator, deviator)))


def volumes(groups: Sequence[ElementGroup], x: FloatArray) -> tuple[float, float, float]:
    """Reference volume, deformed volume [m^3] and smallest J over this rank's solid cells (all cells if none is)."""
    chosen = [g for g in groups if g.kind == "solid"] or list(groups)
    reference = sum(float(g.weights.sum()) for g in chosen)
    ratios = [jacobians(g, x) for g in chosen]
    deformed = sum(float(np.vdot(g.weights, J)) for g, J in zip(chosen, ratios, strict=True))
    return reference, deformed, min((float(J.min()) for J in ratios), default=np.inf)
