"""The block ``solver: {method: mixed_fem}``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from femdeform.scene.scene_model import LineSearch, Positive, SceneModel


class Tikhonov(SceneModel):
    """The term of the published scheme that keeps nine multipliers a point solvable (docs/methods/mixed-fem.md)."""

    per: Literal["density", "volume", "compliance"] = Field(
        description="what `value` counts: density: epsilon itself, on stress densities (caps every modulus near "
        "1 / epsilon); volume: epsilon per volume, on stress times volume (locks rotations); compliance: epsilon times "
        "2 mu of each cell"
    )
    value: Positive = Field(description="epsilon; density: [1/Pa], volume: [1/(Pa m^3)], compliance: [-]")
    proximal: bool = Field(
        default=False,
        description="subtract epsilon times the last multipliers on the right: the fixed point is then that of no term",
    )


class MixedFEMSolver(SceneModel):
    method: Literal["mixed_fem"] = Field(
        description="mixed variational finite elements: positions, stretches, rotations and stress multipliers"
    )
    scheme: Literal["converged", "alternating"] = Field(
        default="converged",
        description="converged: descent on the energy to `tolerance`; alternating: the published interactive scheme, a "
        "fixed number of iterations",
    )
    tolerance: float = Field(default=1e-8, gt=0.0, lt=1.0, description="residual over the forces of the problem [-]")
    max_iterations: int = Field(default=100, ge=1, description="iterations a step of the converged scheme")
    line_search: LineSearch = Field(default=LineSearch(), description="backtracking line search (Armijo)")

    global_solve: Literal["condensed", "condensed_cg", "kkt_direct", "kkt_minres", "kkt_cg"] = Field(
        default="condensed",
        description="condensed: multipliers eliminated, one definite system in the positions for `linear_solver`; "
        "condensed_cg: the same by conjugate gradients preconditioned by the constant matrix M/h^2 + 2 mu J^T V J, "
        "which is factorised when dt changes; "
        "kkt_direct: LDL^T of the saddle system; kkt_minres: MINRES with a definite block-diagonal preconditioner; "
        "kkt_cg: conjugate gradients with the constant factorised saddle system as preconditioner (alternating with "
        "`tikhonov` and inertia only)",
    )
    kkt_tolerance: float = Field(
        default=1e-8,
        gt=0.0,
        lt=1.0,
        description="residual of each block row of the saddle system over its own size; condensed_cg: over the "
        "right-hand side [-]",
    )
    kkt_max_iterations: int = Field(default=10000, ge=1, description="steps of condensed_cg, kkt_minres and kkt_cg")

    twist: Literal["rule", "never", "always"] = Field(
        default="rule",
        description="stiffness of rotations in the converged scheme: rule: that of the multipliers, where they are "
        "tension; never: none, mixed-(+); always: that of the stress at the positions, as in projected Newton",
    )
    finish: Literal["exact", "mixed"] = Field(
        default="exact",
        description="exact: the exact Hessian once full steps reduce the residual, for quadratic convergence; mixed: "
        "the mixed matrix to the end",
    )
    floor: float = Field(
        default=0.1, gt=0.0, le=1.0, description="smallest stiffness of a mode of the stretch, over mu [-]"
    )

    outer_iterations: int = Field(default=1, ge=1, description="outer iterations a step of the alternating scheme (n)")
    inner_iterations: int = Field(default=5, ge=1, description="inner iterations an outer one (m)")
    tikhonov: Tikhonov | None = Field(
        default=None,
        description="regularisation of the alternating scheme's nine multipliers a point; without it six multipliers, "
        "the symmetric stress, which need none",
    )
    beta: Positive = Field(
        default=10.0, description="penalty of the rotation step over the norm of the cell's multiplier (alpha) [-]"
    )
    beta_growth: float = Field(
        default=1.5, ge=1.0, allow_inf_nan=False, description="growth of alpha from one inner iteration to the next [-]"
    )

    @model_validator(mode="after")
    def _consistent(self) -> MixedFEMSolver:
        if self.global_solve == "kkt_cg" and (self.scheme != "alternating" or self.tikhonov is None):
            raise ValueError(
                "global_solve: kkt_cg needs a constant constraint matrix: scheme alternating with `tikhonov`; "
                "use condensed, kkt_direct or kkt_minres"
            )
        if self.tikhonov is not None and self.scheme == "converged":
            raise ValueError("tikhonov: the converged scheme needs none; remove it, or use scheme alternating")
        return self

    @property
    def accuracy(self) -> str:
        """What a step promises, in words."""
        if self.scheme == "alternating":
            n, m = self.outer_iterations, self.inner_iterations
            return f"none: a fixed number of {n} x {m} iterations a step; see relative_residual"
        return f"{self.tolerance:g} of the forces of each step (column force_scale, N)"
