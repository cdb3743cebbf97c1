"""A multigrid cycle with learned relaxation and interpolation, symmetric positive definite whatever was learned."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.pressure_system import GridArray, PressureSystem, shifted
from solvers.linear.poisson import spd_lmg_kernels as kernels
from solvers.linear.poisson import spd_lmg_network as network
from solvers.linear.poisson.multigrid import COARSEST_SWEEPS, OVERCORRECTION
from solvers.linear.poisson.multigrid_levels import EvenSurface, Level, make_levels


@dataclass
class _Learned:
    """What is learned of a level: relaxation, weights of parents, and the factor of its correction."""

    level: Level
    weights: Any
    omega: Any
    parents: Any
    factor: Any
    residual: GridArray

    def sweep(self, first: int) -> None:
        wx, wy, wz = self.weights
        kernels.relaxed_sweep(self.level.diagonal, wx, wy, wz, self.omega, self.level.b, self.level.x, first)

    def restrict(self, coarse: GridArray) -> None:
        wx, wy, wz = self.weights
        kernels.residual(self.level.diagonal, wx, wy, wz, self.level.b, self.level.x, self.residual)
        kernels.restrict(self.parents, self.residual, coarse)


class LearnedMultigrid:
    """A V-cycle that a small network has adapted to the domain.

    As `Multigrid`, with (i) a relaxation factor of each voxel, 2 sigmoid(g) in (0, 2), for red-black sweeps before the
    correction and the mirrored ones after it; (ii) linear interpolation over the parents that can be reached, plus
    learned weights that sum to zero over them, and its transpose for restriction; (iii) a factor for each level. g and
    the weights come from a network that sees couplings, air and solids around a voxel, evaluated when the domain
    changes: a cycle costs no network. With heads of zero it is the classical cycle with linear interpolation.

    **It is symmetric and positive definite for any parameters.** A relaxed sweep over voxels of one colour, which do
    not touch, changes the energy of the error by ``-sum omega (2 - omega) r_i^2/a_ii``: it falls, as omega is in
    (0, 2). Let S be the map of the sweeps before, ``x = S b``, with error map ``E = I - S A``, and S^T the mirrored
    sweeps. Then ``B = S + S^T - S^T A S + (I - S^T A) P M P^T (I - A S)`` with the cycle M of the next level. The first
    part equals ``A^-1 - E A^-1 E^T``, positive as E contracts in the energy; the second is semi-definite for any P if M
    is, and M is by the same argument, down to symmetric Gauss-Seidel on the coarsest level. So plain conjugate
    gradients apply.

    Parameters
    ----------
    system : PressureSystem
    parameters : mapping of str to array
        As `spd_lmg_network.parameter_shapes` has them.
    sweeps : int
        Before and after each correction; trained with one.
    dtype : type
        Precision of the cycle.

    References
    ----------
    K. Lan, E. Palazzolo, D. Hyde, J. Teran and others, A neural-preconditioned Poisson solver for mixed Dirichlet and
    Neumann boundary conditions, ICML 2024, for networks that see the domain and are linear in the residual.

    Limitations
    -----------
    Coarse matrices do not see thin walls, and take aggregates to end where air begins (`EvenSurface`). The set-up costs
    more than a solve.
    """

    def __init__(
        self,
        system: PressureSystem,
        parameters: Mapping[str, NDArray[Any]],
        sweeps: int = 1,
        dtype: type[np.floating[Any]] = np.float32,
    ) -> None:
        dim = system.dim
        for name, shape in network.parameter_shapes(dim).items():
            if name not in parameters or parameters[name].shape != shape:
                raise ValueError(f"the weights hold no {name} of shape {shape}: they are of another dimension or kind")
        self.system = system
        self.sweeps = sweeps
        levels = make_levels(system, EvenSurface(system), dtype)
        # Where fluid is scattered in parts of a coarse voxel that level has no unknowns, and nothing to adapt to.
        used = [level for level in levels if level.diagonal.any()]
        levels = used or levels[:1]
        self.coarsest = levels[-1]
        self.learned: list[_Learned] = []
        for k, (level, coarse) in enumerate(itertools.pairwise(levels)):
            weights = level.weights or finest_weights(system, dtype)
            diagonal = level.diagonal.astype(dtype)
            values = network.features(diagonal, weights, dim)
            answer = network.heads(parameters, network.NETWORKS[min(k, 1)], values, dim)
            omega, parents = interpret(answer, network.parent_shares(diagonal, weights, coarse.diagonal, dim))
            factor = OVERCORRECTION * np.exp(parameters["factors"][min(k, network.LEVELS - 1)])
            self.learned.append(
                _Learned(
                    Level(diagonal, weights, level.b, level.x),
                    weights,
                    omega.astype(dtype),
                    parents.astype(dtype),
                    dtype(factor),
                    np.zeros_like(diagonal),
                )
            )

    def apply(self, r: GridArray, z: GridArray) -> None:
        """One V-cycle from zero; see `Preconditioner`."""
        finest = self.learned[0].level if self.learned else self.coarsest
        finest.b[...] = r
        self._cycle(0)
        z[...] = finest.x

    def _cycle(self, k: int) -> None:
        if k == len(self.learned):
            self._solve_coarsest()
            return
        learned = self.learned[k]
        coarse = self.learned[k + 1].level if k + 1 < len(self.learned) else self.coarsest
        x = learned.level.x
        x[...] = 0.0
        for _ in range(self.sweeps):
            learned.sweep(0)
        learned.restrict(coarse.b)
        self._cycle(k + 1)
        kernels.prolong(coarse.x, learned.parents, learned.factor, x)
        for _ in range(self.sweeps):
            learned.sweep(1)

    def _solve_coarsest(self) -> None:
        self.coarsest.x[...] = 0.0
        for first in (0, 1):
            for _ in range(COARSEST_SWEEPS):
                self.coarsest.sweep(first)


def finest_weights(system: PressureSystem, dtype: type[np.floating[Any]]) -> tuple[Any, Any, Any]:
    """Couplings of the finest level as coarser ones store them."""
    unknown = system.unknown
    x, y, z = ((unknown & shifted(unknown, axis, 1)).astype(dtype) for axis in range(3))
    return x, y, z


def interpret(answer: NDArray[Any], shares: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Relaxation (nx + 2, ..) in (0, 2) and weights of parents (2^dim, nx + 2, ..) from what the network answers."""
    logit = np.where(network.colours(answer.shape[:-1]), answer[..., 1], answer[..., 0])
    omega = 2.0 / (1.0 + np.exp(-np.clip(logit, -network.LARGEST_LOGIT, network.LARGEST_LOGIT)))
    raw, valid = np.moveaxis(answer[..., 2:], -1, 0), shares > 0.0
    mean = (raw * valid).sum(axis=0) / np.maximum(valid.sum(axis=0), 1)
    return omega, shares + (raw - mean) * valid
