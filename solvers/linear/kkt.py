"""Symmetric saddle systems of positions and cell multipliers, by factorisation, MINRES or conjugate gradients.

    [ A   B^T ] [dx]   [b1]
    [ B  -C   ] [ y] = [b2],      A symmetric (positive definite with inertia), C positive definite, cell by cell

B and C come as dense blocks of the quadrature points; each rank holds the multipliers of its own cells. The two block
rows have different units and sizes, so each is tested against the size of its own terms: one norm over both rows lets
the constraint row stay wrong by its own size (docs/methods/mixed-fem.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.types import FloatArray
from solvers.linear.constant_matrix import ConstantMatrix
from solvers.linear.kkt_matrix import SaddleMatrix, make_matrix
from solvers.linear.kkt_system import Layout, SaddleSystem

# Stages of iterative refinement after a direct solve, and restarts of conjugate gradients.
_CORRECTIONS = 3


@dataclass(frozen=True)
class SaddleResult:
    """Answer of a saddle solver.

    Attributes
    ----------
    x : (n_local, dim) float64
        First unknown, ghosts updated.
    y : list of (n_cells, n_q, n_m) float64
        Multipliers of this rank's cells.
    iterations : int
    converged : bool
        Whether both rows are below the tolerance.
    reason : str
    momentum_residual, constraint_residual : float
        Residual of either block row over the sum of the sizes of its terms [-].
    """

    x: FloatArray
    y: list[FloatArray]
    iterations: int
    converged: bool
    reason: str
    momentum_residual: float
    constraint_residual: float


class SaddleSolver:
    """Saddle systems, again and again; matrices are made anew when the sparsity of A changes.

    Parameters
    ----------
    method : str
        ``kkt_direct``: LDL^T (MUMPS; LU by SuperLU without PETSc) with iterative refinement. ``kkt_minres``: MINRES
        with diag(P, C)^-1, P the constant matrix in the place of A + B^T C^-1 B: few iterations at any stiffness.
        ``kkt_cg``: conjugate gradients with the factorised system of another C as preconditioner, on vectors whose
        first row is satisfied.
    tolerance : float
        Residual of each block row over the sizes of its terms [-].
    max_iterations : int
    use_petsc : bool
        Assemble and factorise with PETSc; otherwise SciPy, serial.
    constant : ConstantMatrix, optional
        P of ``kkt_minres``; whoever steps calls its `begin`.
    options : mapping, optional
        PETSc options of the factorisation; default: those of the preset kkt-direct.

    References
    ----------
    C. C. Paige, M. A. Saunders, Solution of sparse indefinite systems of linear equations (1975).
    H. Elman, D. Silvester, A. Wathen, Finite Elements and Fast Iterative Solvers (2005), algorithm 6.1.
    C. Durazzi, V. Ruggiero, Indefinitely preconditioned conjugate gradient method for large sparse equality and
    inequality constrained quadratic problems (2003).

    Limitations
    -----------
    The cells must not change during the life of an object. ``kkt_cg`` asks for definite A and for the A and B of
    its preconditioner to be those of the system: it is factorised again when they change.
    """

    def __init__(
        self,
        method: str,
        tolerance: float,
        max_iterations: int,
        use_petsc: bool,
        constant: ConstantMatrix | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self.method = method
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self._use_petsc = use_petsc
        self._near = constant
        self._options = options
        self._layout: Layout | None = None
        self._columns: np.ndarray | None = None  # the sparsity that the matrices were made for
        self._matrix: SaddleMatrix | None = None
        self._constant: SaddleMatrix | None = None
        self._constant_values: FloatArray | None = None
        self._scale = (0.0, 0.0)

    def solve(
        self, system: SaddleSystem, b1: FloatArray, b2: Sequence[FloatArray], C0: Sequence[FloatArray] | None = None
    ) -> SaddleResult:
        """Solve for right-hand sides b1 (n_local, dim) and b2, one (n_cells, n_q, n_m) array a group.

        `C0` holds the compliances of the preconditioner of ``kkt_cg``.
        """
        if self._layout is None or self._columns is not system.A.columns:
            self.destroy()
            self._columns = system.A.columns
            self._layout = Layout(system)
            rows, columns = self._layout.coordinates(system)
            self._matrix = make_matrix(self._use_petsc, self._layout, rows, columns, self._options)
            if self.method == "kkt_cg":
                self._constant = make_matrix(self._use_petsc, self._layout, rows, columns, self._options)
        layout, matrix = self._layout, self._matrix
        assert matrix is not None
        free = system.A.free
        B = [b * free[cells].reshape(len(cells), 1, 1, -1) for b, cells in zip(system.B, system.cells, strict=True)]
        values = layout.values(system, B, system.C)
        b = layout.join(b1, b2)
        if layout.partition.max(float(not (np.isfinite(values).all() and np.isfinite(b).all()))):
            return self._result(np.zeros_like(b), 0, False, "matrix is not finite")
        matrix.set_values(values)
        self._scale = layout.row_norms(b)
        if max(self._scale) == 0.0:
            return self._result(np.zeros_like(b), 0, True, "nothing to solve", (0.0, 0.0))
        if self.method == "kkt_direct":
            return self._direct(b)
        if self.method == "kkt_minres":
            return self._minres(b, [np.asarray(np.linalg.inv(c)) for c in system.C])
        assert C0 is not None
        return self._conjugate_gradients(system, B, C0, b)

    # ------------------------------------------------------------------------------------------- judgement

    def _judge(self, b: FloatArray, v: FloatArray) -> tuple[FloatArray, tuple[float, float]]:
        """Residual b - K v and its two rows, each over the sizes of its terms."""
        assert self._layout is not None
        assert self._matrix is not None
        n = self._layout.n_dofs
        first, second = v.copy(), v.copy()
        first[n:], second[:n] = 0.0, 0.0
        one, two = self._matrix.multiply(first), self._matrix.multiply(second)
        residual = b - one - two
        norms = self._layout.row_norms(residual)
        terms = (self._scale, self._layout.row_norms(one), self._layout.row_norms(two))
        sizes = [sum(parts) for parts in zip(*terms, strict=True)]
        relative = [0.0 if size == 0.0 else norm / size for norm, size in zip(norms, sizes, strict=True)]
        return residual, (relative[0], relative[1])

    def _result(
        self, v: FloatArray, iterations: int, converged: bool, reason: str, rows: tuple[float, float] | None = None
    ) -> SaddleResult:
        assert self._layout is not None
        x, y = self._layout.split(v)
        momentum, constraint = (float("nan"), float("nan")) if rows is None else rows
        return SaddleResult(x, y, iterations, converged, reason, momentum, constraint)

    def _is_done(self, rows: tuple[float, float]) -> bool:
        # Not a maximum: nan has to fail.
        return all(row <= self.tolerance for row in rows)

    # ------------------------------------------------------------------------------------------- methods

    def _direct(self, b: FloatArray) -> SaddleResult:
        assert self._matrix is not None
        failure = self._matrix.factorise()
        if failure:
            return self._result(np.zeros_like(b), 0, False, failure)
        v = self._matrix.apply_inverse(b)
        residual, rows = self._judge(b, v)
        for _ in range(_CORRECTIONS):
            if self._is_done(rows) or not np.isfinite(rows).all():
                break
            v = v + self._matrix.apply_inverse(residual)
            residual, rows = self._judge(b, v)
        done = self._is_done(rows)
        return self._result(v, 1, done, "direct" if done else "the factorisation is not accurate enough", rows)

    def _minres(self, b: FloatArray, points: list[FloatArray]) -> SaddleResult:
        layout, matrix, near = self._layout, self._matrix, self._near
        assert layout is not None
        assert matrix is not None
        assert near is not None
        if near.failure:
            return self._result(np.zeros_like(b), 0, False, f"the constant matrix: {near.failure}")

        def precondition(r: FloatArray) -> FloatArray:
            parts = [near.solve(r[: layout.n_dofs].reshape(-1, layout.dim)).ravel()]
            start = layout.n_dofs
            for inverse, shape in zip(points, layout.shapes, strict=True):
                size = int(np.prod(shape))
                parts.append(np.einsum("eqmk,eqk->eqm", inverse, r[start : start + size].reshape(shape)).ravel())
                start += size
            return np.concatenate(parts)

        x = np.zeros_like(b)
        v_old, v = np.zeros_like(b), b.copy()
        z = precondition(v)
        gamma_old, gamma = 1.0, float(np.sqrt(max(layout.dot(z, v), 0.0)))
        eta, s_old, s, c_old, c = gamma, 0.0, 0.0, 1.0, 1.0
        w_old, w = np.zeros_like(b), np.zeros_like(b)
        target, rows = self.tolerance * gamma, (np.inf, np.inf)
        iteration = 0
        while iteration < self.max_iterations and gamma > 0.0:
            z = z / gamma
            Kz = matrix.multiply(z)
            delta = layout.dot(Kz, z)
            v_old, v = v, Kz - (delta / gamma) * v - (gamma / gamma_old) * v_old
            z_new = precondition(v)
            gamma_new = float(np.sqrt(max(layout.dot(z_new, v), 0.0)))
            a0 = c * delta - c_old * s * gamma
            a1 = float(np.hypot(a0, gamma_new))
            a2, a3 = s * delta + c_old * c * gamma, s_old * gamma
            if not a1 > 0.0:
                break
            c_old, c, s_old, s = c, a0 / a1, s, gamma_new / a1
            w_old, w = w, (z - a3 * w_old - a2 * w) / a1
            x += c * eta * w
            eta = -s * eta
            z, gamma_old, gamma = z_new, gamma, gamma_new
            iteration += 1
            if abs(eta) <= target:
                _, rows = self._judge(b, x)
                if self._is_done(rows):
                    return self._result(x, iteration, True, "converged", rows)
                # The recurrence's norm mixes the rows: go on until each of them is small enough.
                target = 0.3 * abs(eta)
        _, rows = self._judge(b, x)
        done = self._is_done(rows)
        return self._result(x, iteration, done, "converged" if done else f"{iteration} iterations of MINRES", rows)

    def _conjugate_gradients(
        self, system: SaddleSystem, B: Sequence[FloatArray], C0: Sequence[FloatArray], b: FloatArray
    ) -> SaddleResult:
        """On vectors with a satisfied first row K and its preconditioner G are definite, with the sign of -C."""
        layout, matrix, constant = self._layout, self._matrix, self._constant
        assert layout is not None
        assert matrix is not None
        assert constant is not None
        values = layout.values(system, B, C0)
        same = self._constant_values is not None and np.array_equal(values, self._constant_values)
        if layout.partition.max(float(not same)):
            constant.set_values(values)
            failure = constant.factorise()
            if failure:
                return self._result(np.zeros_like(b), 0, False, failure)
            self._constant_values = values
        n = layout.n_dofs
        x = constant.apply_inverse(b)
        iteration = 0
        rows = (np.inf, np.inf)
        for _ in range(_CORRECTIONS):
            r, rows = self._judge(b, x)
            if self._is_done(rows) or not np.isfinite(rows).all():
                break
            # Rounding in the first row is put right by G, whose first row is that of K.
            x = x + constant.apply_inverse(np.concatenate([r[:n], np.zeros_like(r[n:])]))
            r, rows = self._judge(b, x)
            r[:n] = 0.0
            z = constant.apply_inverse(r)
            p, rz = z, -layout.dot(r, z)
            target = self.tolerance * layout.row_norms(r)[1] / max(rows[1], 1e-300)
            while iteration < self.max_iterations and rz > 0.0:
                Kp = matrix.multiply(p)
                curvature = -layout.dot(p, Kp)
                if not curvature > 0.0:
                    break
                length = rz / curvature
                x = x + length * p
                r = r - length * Kp
                r[:n] = 0.0
                iteration += 1
                if layout.row_norms(r)[1] <= target:
                    break
                z = constant.apply_inverse(r)
                rz_new = -layout.dot(r, z)
                p, rz = z + (rz_new / rz) * p, rz_new
            if iteration >= self.max_iterations:
                break
        _, rows = self._judge(b, x)
        done = self._is_done(rows)
        return self._result(x, iteration, done, "converged" if done else f"{iteration} conjugate gradients", rows)

    # ------------------------------------------------------------------------------------------- life

    def reset(self) -> None:
        """Forget factors: the next solve is that of a new object."""
        self._constant_values = None
        for matrix in (self._matrix, self._constant):
            if matrix is not None:
                matrix.reset()

    def destroy(self) -> None:
        """Free matrices and factors."""
        for matrix in (self._matrix, self._constant):
            if matrix is not None:
                matrix.destroy()
        self._matrix = self._constant = self._layout = self._constant_values = None
