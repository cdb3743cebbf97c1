"""The block ``solver: {method: pbng}``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from femdeform.scene.scene_model import SceneModel


class PBNGSolver(SceneModel):
    method: Literal["pbng"] = Field(
        description="position-based nonlinear Gauss-Seidel: sweeps that move one node after another; one rank"
    )
    tolerance: float = Field(default=1e-8, gt=0.0, lt=1.0, description="residual over the forces of the problem [-]")
    max_iterations: int = Field(default=5000, ge=1, description="sweeps a step")
    iterations: int | None = Field(
        default=None,
        ge=1,
        description="a fixed number of sweeps a step, which is taken whatever its residual is; `tolerance` and "
        "`max_iterations` then have no part",
    )
    check_every: int = Field(
        default=10,
        ge=1,
        description="sweeps between two looks at the residual, a look costs about as much as five",
    )
    relaxation: float = Field(
        default=1.0,
        gt=0.0,
        lt=2.0,
        description="factor of the step of every node; above 1 nodes go too far on purpose (SOR inside the sweep) [-]",
    )
    acceleration: Literal["none", "chebyshev", "sor", "anderson"] = Field(
        default="anderson",
        description="what is made of whole sweeps; taken back where the energy rises, for the longer the more often",
    )
    rho: float = Field(default=0.95, gt=0.0, lt=1.0, description="chebyshev: estimated convergence rate of sweeps [-]")
    gamma: float = Field(default=1.7, gt=0.0, lt=2.0, description="chebyshev: relaxation [-]")
    omega: float = Field(
        default=1.7, ge=1.0, lt=2.0, description="sor: extrapolation from the sweep before the last [-]"
    )
    window: int = Field(default=8, ge=1, le=50, description="anderson: sweeps that are combined")
    finish: Literal["none", "newton_krylov"] = Field(
        default="none",
        description="newton_krylov: Newton steps by `linear_solver` below `finish_below`, sweeps between them",
    )
    finish_below: float = Field(
        default=1e-2, gt=0.0, description="newton_krylov: residual over the forces at which it takes over [-]"
    )
    precision: Literal["float64", "float32"] = Field(
        default="float64",
        description="of the sweeps; float32 goes over to float64 once the residual, always in float64, falls no more",
    )

    @model_validator(mode="after")
    def _consistent(self) -> PBNGSolver:
        if self.relaxation != 1.0 and self.acceleration in ("chebyshev", "sor"):
            raise ValueError(f"relaxation: {self.acceleration} relaxes whole sweeps already; use one of the two")
        if self.finish != "none" and self.iterations is not None:
            raise ValueError("finish: a fixed number of sweeps has no tolerance to finish for")
        return self

    @property
    def accuracy(self) -> str:
        """What a step promises, in words."""
        if self.iterations is not None:
            return f"none: a fixed number of {self.iterations} sweeps a step; see relative_residual"
        return f"{self.tolerance:g} of the forces of each step (column force_scale, N)"
