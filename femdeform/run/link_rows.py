"""Rows of weak constraints from the points that they hold together."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from femdeform.contact.weak_constraints import ConstraintRows
from femdeform.types import FloatArray, IntArray


@dataclass(frozen=True)
class Side:
    """One point of each of n rows: interpolated between nodes, or a place in space.

    Attributes
    ----------
    nodes : (n, k) int64
        Nodes of the whole problem; k = 0 in space.
    weights : (n, k) float64
        [-]
    place : (n, dim) float64
        At time 0 [m].
    velocity : (n, dim) float64
        Of places in space [m/s]; zero for points of bodies, whose motion is what is solved for.
    """

    nodes: IntArray
    weights: FloatArray
    place: FloatArray
    velocity: FloatArray

    @classmethod
    def in_space(cls, place: FloatArray, velocity: FloatArray) -> Side:
        """Places in space (n, dim) with a velocity (dim,)."""
        none = np.empty((len(place), 0))
        return cls(none.astype(np.int64), none, place, np.broadcast_to(velocity, place.shape))

    @classmethod
    def of_nodes(cls, nodes: IntArray, weights: FloatArray, points: FloatArray) -> Side:
        """Points between nodes, whose reference positions are `points` (n_global, dim)."""
        place = np.einsum("nk,nkc->nc", weights, points[nodes])
        return cls(nodes, weights, place, np.zeros_like(place))

    @property
    def is_in_space(self) -> bool:
        """Whether the points belong to no body."""
        return int(self.nodes.shape[1]) == 0

    def as_data(self) -> dict[str, list[Any]]:
        """The point of the first row, as plain data."""
        if self.is_in_space:
            return {"place": self.place[0].tolist(), "velocity": self.velocity[0].tolist()}
        return {"nodes": self.nodes[0].tolist(), "weights": self.weights[0].tolist()}


@dataclass(frozen=True)
class Held:
    """Points that a surface or space holds, and the factor of the stiffness of each (n,): 1, or an area [m^2]."""

    side: Side
    factors: FloatArray

    def select(self, chosen: IntArray) -> Held:
        """Return some of them."""
        return Held(Side(*(array[chosen] for array in vars(self.side).values())), self.factors[chosen])


def assemble(
    link: int,
    n_global: int,
    first: Side,
    second: Side,
    target: FloatArray,
    normal: FloatArray,
    tangential: FloatArray,
    direction: FloatArray | None = None,
    facets: IntArray | None = None,
) -> ConstraintRows:
    """Rows of C = first - second - target.

    Parameters
    ----------
    link : int
        Number of the link they are of.
    n_global : int
        Nodes of the whole problem.
    first : Side
        Points that enter with plus.
    second : Side
        Points that enter with minus.
    target : (n, dim) float64
        Difference of the points that is without force [m].
    normal, tangential : (n,) float64
        Stiffness along the direction and across it [N/m].
    direction : (n, dim) float64, optional
        Unit vectors, zero where there is none.
    facets : (n, dim) int64, optional
        Corners of facets whose normals are the directions.
    """
    n, dim = target.shape
    for sign, side in ((1.0, first), (-1.0, second)):
        if side.is_in_space:
            target = target - sign * side.place
    nodes = np.concatenate([first.nodes, second.nodes], axis=1)
    weights = np.concatenate([first.weights, -second.weights], axis=1)
    # A node that both points depend on enters once.
    key = (np.arange(n)[:, None] * n_global + nodes).ravel()
    unique, inverse = np.unique(key, return_inverse=True)
    total = np.bincount(inverse.ravel(), weights=weights.ravel(), minlength=unique.size)
    unique, total = unique[total != 0.0], total[total != 0.0]
    counts = np.bincount(unique // n_global, minlength=n)
    return ConstraintRows(
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        unique % n_global,
        total,
        target,
        second.velocity - first.velocity,
        np.zeros(n),
        normal,
        tangential,
        np.zeros((n, dim)) if direction is None else direction,
        np.full((n, dim), -1, dtype=np.int64) if facets is None else facets,
        np.full(n, link, dtype=np.int64),
    )


def joined(parts: list[ConstraintRows]) -> ConstraintRows:
    """Return the rows of several parts as one."""
    arrays = {
        entry.name: np.concatenate([getattr(part, entry.name) for part in parts])
        for entry in fields(ConstraintRows)
        if entry.name != "offsets"
    }
    counts = np.concatenate([np.diff(part.offsets) for part in parts])
    return ConstraintRows(np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), **arrays)
