"""B-PXPBD and FP-PXPBD: forms of XPBD that keep the primary residual, and converge."""

from __future__ import annotations

from femdeform.scene.constraint_schema import BPXPBDSolver, FPPXPBDSolver
from femdeform.step_problem import LocalStepProblem
from solvers.position_based.cell_sweep import CellSweep
from solvers.position_based.constraint_step import Stopping
from solvers.position_based.constraint_sweeps import BlendedSweep
from solvers.position_based.piola_sweep import PiolaSweep
from solvers.xpbd import CellSolver


def _stopping(options: BPXPBDSolver | FPPXPBDSolver) -> Stopping:
    fixed = options.iterations is not None
    sweeps = options.max_iterations if options.iterations is None else options.iterations
    return Stopping(sweeps, None if fixed else options.tolerance, options.check_every, fixed, converges=True)


class BlendedPXPBD(CellSolver):
    """XPBD whose every update is blended with the one that zeroes the primary residual of the nodes it moves.

    References
    ----------
    Y. Chen, Y. Han, J. Chen, S. Ma, R. Fedkiw, J. Teran, Primal extended position based dynamics for hyperelasticity
    (2023), "B-PXPBD".

    Limitations
    -----------
    Stable only for (1 - zeta) kappa below about 0.1 with kappa = h^2 E / (rho dx^2), and slow where zeta is near 1.
    Momentum is conserved at convergence only. Laws and scenes as for XPBD.
    """

    options: BPXPBDSolver

    def make_sweep(self, problem: LocalStepProblem, previous: CellSweep | None = None) -> CellSweep:
        """See `CellSolver`."""
        return BlendedSweep(problem, self.options.zeta, self.options.epsilon, previous=previous)

    def stopping(self) -> Stopping:
        """See `CellSolver`."""
        return _stopping(self.options)


class FirstPiolaPXPBD(CellSolver):
    """Stresses of the cells as unknowns, solved for one cell after another with its corners.

    References
    ----------
    Y. Chen, Y. Han, J. Chen, S. Ma, R. Fedkiw, J. Teran, Primal extended position based dynamics for hyperelasticity
    (2023), "FP-PXPBD".

    Limitations
    -----------
    A Gauss-Seidel method on the stresses: its rate falls like 1/kappa with kappa = h^2 E / (rho dx^2), so there is no
    static limit; beyond kappa of about 10 it needs several local steps and many sweeps. A material that must not invert
    may be inverted by its neighbours' steps, which is reported as a failed step. Momentum is conserved as far as the
    cells are solved. Linear triangles and tetrahedra with lumped mass; obstacles by penalty; one rank.
    """

    options: FPPXPBDSolver

    def make_sweep(self, problem: LocalStepProblem, previous: CellSweep | None = None) -> CellSweep:
        """See `CellSolver`."""
        options = self.options
        exact = options.tangent == "exact"
        return PiolaSweep(problem, options.local_iterations, exact, options.line_search, previous)

    def stopping(self) -> Stopping:
        """See `CellSolver`."""
        return _stopping(self.options)
