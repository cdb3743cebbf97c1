"""The block `linear_solver:` of flows: what solves for the pressure."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from femdeform.scene.scene_model import SceneModel, default_tag


class _PressureModel(SceneModel):
    tolerance: float = Field(default=1e-6, gt=0.0, lt=1.0, description="residual over the right-hand side [-]")
    max_iterations: int = Field(default=2000, ge=1, description="iterations before the solve has failed")


class MultigridPressureSolver(_PressureModel):
    method: Literal["mg_pcg"] = Field(
        default="mg_pcg", description="conjugate gradients with a geometric multigrid cycle"
    )
    sweeps: int = Field(default=2, ge=1, le=4, description="smoothing sweeps before and after each coarser level")
    precision: Literal["float32", "float64"] = Field(default="float32", description="numbers inside of the cycle")


class CGPressureSolver(_PressureModel):
    method: Literal["cg"] = Field(description="conjugate gradients")


class ICCPressureSolver(_PressureModel):
    method: Literal["icc"] = Field(description="conjugate gradients with incomplete Cholesky factors")
    modification: float = Field(
        default=0.97, ge=0.0, le=1.0, description="part of dropped fill that goes to the diagonal; 0: IC(0) [-]"
    )
    backend: Literal["femdeform", "petsc"] = Field(
        default="femdeform", description="whose factors; PETSc's know no modification"
    )


class DeflatedPressureSolver(_PressureModel):
    method: Literal["deflated_cg"] = Field(description="conjugate gradients without the span of some Ritz vectors")
    n_vectors: int = Field(default=16, ge=1, description="Ritz vectors")
    seed: int = Field(default=0, ge=0, description="seed of the Lanczos process that finds them")


class HyprePressureSolver(_PressureModel):
    method: Literal["hypre"] = Field(description="conjugate gradients with hypre's algebraic multigrid, from PETSc")


class GAMGPressureSolver(_PressureModel):
    method: Literal["gamg"] = Field(description="conjugate gradients with PETSc's algebraic multigrid")


class _LearnedPressureModel(_PressureModel):
    weights: str | None = Field(
        default=None,
        min_length=1,
        description="name of shipped weights, or a file `.npz` made by `femdeform train`, beside the scene; default: "
        "the shipped ones for the grid's dimension",
    )
    fallback: Literal["mg_pcg", "none"] = Field(
        default="mg_pcg", description="what goes on where the learned solver is slow or fails; none: nothing"
    )
    compare_times: bool = Field(
        default=False,
        description="whether every 50th solve is made with multigrid too, and the slower solver is put aside until the "
        "next; results then depend on how fast the machine was, and a resumed run may differ from an unbroken one in "
        "the last digits, which is why it has to be asked for",
    )

    @model_validator(mode="after")
    def _compare_with_something(self) -> _LearnedPressureModel:
        if self.compare_times and self.fallback == "none":
            raise ValueError("compare_times needs a fallback, which may be the faster one")
        return self


class DCDMPressureSolver(_LearnedPressureModel):
    method: Literal["dcdm"] = Field(description="deep conjugate directions: search directions of a network")
    kept: int | Literal["all"] = Field(
        default=2, description="earlier directions that a new one is made A-orthogonal to, at least 1, or all"
    )

    @field_validator("kept")
    @classmethod
    def _keep_one(cls, value: int | str) -> int | str:
        if isinstance(value, int) and value < 1:
            raise ValueError("at least one direction has to be kept")
        return value


class SPDLMGPressureSolver(_LearnedPressureModel):
    method: Literal["spd_lmg"] = Field(description="conjugate gradients with a learned multigrid cycle")
    sweeps: int = Field(
        default=1, ge=1, le=4, description="smoothing sweeps before and after each coarser level; trained with 1"
    )


ClassicalPressureSolver = (
    MultigridPressureSolver
    | CGPressureSolver
    | ICCPressureSolver
    | DeflatedPressureSolver
    | HyprePressureSolver
    | GAMGPressureSolver
)
LearnedPressureSolver = DCDMPressureSolver | SPDLMGPressureSolver

PressureSolver = Annotated[
    Annotated[ClassicalPressureSolver | LearnedPressureSolver, Field(discriminator="method")],
    BeforeValidator(default_tag("method", "mg_pcg")),
]
