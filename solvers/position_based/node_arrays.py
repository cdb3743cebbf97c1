"""What sweeps over nodes share: the order of the nodes, and their own terms of the function of a step."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.step_problem import LocalStepProblem
from femdeform.types import BoolArray, FloatArray, IntArray
from solvers.position_based import layout


class NodeArrays:
    """Nodes in the order of a sweep, with inertia, loads and supports; subclasses know the cells.

    Parameters
    ----------
    problem : LocalStepProblem
    colors : (n_nodes,) int64
        Nodes of one colour share no cell.
    used : (n_nodes,) bool
        Nodes that have cells.
    dtype : numpy type
        float64 or float32.

    Attributes
    ----------
    numbering : layout.Numbering
        Order of the nodes; positions given to `sweep` are flat, in this order, three components a node.
    """

    def __init__(self, problem: LocalStepProblem, colors: IntArray, used: BoolArray, dtype: Any) -> None:
        self.dtype = np.dtype(dtype)
        self.n_nodes, self.dim = n, _ = problem.points.shape
        self.numbering = layout.number_nodes(problem.points, colors, problem.free.any(axis=1) & used)
        free = np.zeros((n, 3), dtype=np.uint8)
        free[:, : self.dim] = problem.free[self.numbering.order]
        self._free = free.ravel()
        self._weights = np.zeros(n, dtype=self.dtype)
        self._centers = np.zeros(3 * n, dtype=self.dtype)
        self._loads = np.zeros(3 * n, dtype=self.dtype)
        self._load = np.zeros((n, self.dim))
        self._acc = np.zeros(9 * n, dtype=self.dtype)
        self._steps = np.zeros(3 * n, dtype=self.dtype)
        self._taken = np.ones(n, dtype=self.dtype)

    @property
    def n_colors(self) -> int:
        """Number of colours, one threaded loop each."""
        return self.numbering.n_colors

    @property
    def moving(self) -> slice:
        """The part of flat positions that sweeps change."""
        return slice(0, 3 * int(self.numbering.color_offsets[-1]))

    def begin_step(self, problem: LocalStepProblem) -> None:
        """Take over what the step begun has frozen: inertia and loads."""
        terms = problem.nodal_terms()
        self._weights[:] = terms.weights[self.numbering.order]
        self._write(self._centers, terms.centers)
        self._load = terms.loads
        self._write(self._loads, self._load)

    def update_loads(self, problem: LocalStepProblem, x: FloatArray) -> None:
        """Evaluate forces that follow the positions x (n_nodes, dim), where there are any; renew what lags behind."""
        follower = problem.follower_forces(x)
        if follower is not None:
            self._write(self._loads, self._load + follower)

    def flat(self, x: FloatArray) -> FloatArray:
        """Positions (n_nodes, dim) in the order, the precision and the width of the sweep."""
        out = np.zeros(3 * self.n_nodes, dtype=self.dtype)
        self._write(out, x)
        return out

    def unflat(self, flat: FloatArray, out: FloatArray) -> None:
        """Write flat positions of the nodes that move back to ``out`` (n_nodes, dim)."""
        n = int(self.numbering.color_offsets[-1])
        out[self.numbering.order[:n]] = flat.reshape(-1, 3)[:n, : self.dim]

    def _write(self, flat: FloatArray, field: FloatArray) -> None:
        flat.reshape(-1, 3)[:, : self.dim] = field[self.numbering.order]

    def sweep(self, x: FloatArray, relaxation: float = 1.0) -> None:
        """Move every node once.

        Parameters
        ----------
        x : (3 n_nodes,)
            Flat positions [m], see `flat`; changed.
        relaxation : float
            Factor of the step of every node that touches no obstacle, in (0, 2).
        """
        raise NotImplementedError
