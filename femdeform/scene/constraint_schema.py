"""The blocks ``solver: {method: xpbd | pbd | xpbd_qs | b_pxpbd | fp_pxpbd}``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from femdeform.scene.scene_model import Positive, SceneModel

_EPSILON = "added under the root of the shear constraint, as the square of a strain [-]"
_CHECK = "sweeps between two looks at the residual, a look costs about as much as five"
_ORDER = "order in which constraints of cells are visited, which decides what is found"
_LINKS = "visit `links` before the cells, not after them: what is visited last is met best"


def _fixed(count: int) -> str:
    return f"none: a fixed number of {count} sweeps a step; see relative_residual"


class XPBDSolver(SceneModel):
    method: Literal["xpbd"] = Field(
        description="extended position-based dynamics: sweeps over constraints of cells; fast, plausible, does not "
        "converge to the equations of motion; dynamics, one rank"
    )
    iterations: int = Field(default=20, ge=1, description="sweeps a step, which is taken whatever its residual is")
    tolerance: float | None = Field(
        default=None, gt=0.0, lt=1.0, description="residual over the forces of the problem that ends a step early [-]"
    )
    check_every: int = Field(default=10, ge=1, description=_CHECK)
    epsilon: float = Field(default=1e-10, ge=0.0, lt=1.0, description=_EPSILON)
    order: Literal["forward", "reverse"] = Field(default="forward", description=_ORDER)
    links_first: bool = Field(default=False, description=_LINKS)
    constraints: Literal["pair", "root"] = Field(
        default="pair",
        description="pair: shape and volume (fixed_corotated, arap, neo_hookean); root: the square root of the energy, "
        "of any law, a comparison that is known to be unstable",
    )
    keep_primary_residual: bool = Field(
        default=False,
        description="keep the term that XPBD leaves out of its step; a comparison that is known to be unstable",
    )

    @model_validator(mode="after")
    def _consistent(self) -> XPBDSolver:
        if self.keep_primary_residual and (self.constraints == "root" or self.order == "reverse"):
            raise ValueError("keep_primary_residual: goes with constraints: pair and order: forward only")
        return self

    @property
    def accuracy(self) -> str:
        """What a step promises, in words."""
        return _fixed(self.iterations)


class PBDSolver(SceneModel):
    method: Literal["pbd"] = Field(
        description="position-based dynamics: XPBD with infinite stiffness, so that the number of sweeps decides how "
        "stiff a body is; fixed_corotated and arap; one rank; a comparison, in statics as well"
    )
    iterations: int = Field(default=20, ge=1, description="sweeps a step")
    pseudo_step: Positive | None = Field(
        default=None,
        description="statics only: time for which the loads push the masses before the sweeps, which is all that is "
        "seen of them [s]; default: the length of the step",
    )
    check_every: int = Field(default=10, ge=1, description=_CHECK)
    order: Literal["forward", "reverse"] = Field(default="forward", description=_ORDER)
    links_first: bool = Field(default=False, description=_LINKS)

    @property
    def tolerance(self) -> None:
        """No residual is aimed at."""
        return None

    @property
    def accuracy(self) -> str:
        """What a step promises, in words."""
        return _fixed(self.iterations)


class XPBDQSSolver(SceneModel):
    method: Literal["xpbd_qs"] = Field(
        description="statics by pseudo-time steps of XPBD without velocity; where it comes to rest depends on "
        "`pseudo_step`, `iterations` and `order`; one rank; a comparison"
    )
    pseudo_step: Positive = Field(description="length of a pseudo-time step [s]; the density is that of the material")
    iterations: int = Field(default=10, ge=1, description="sweeps a pseudo-time step")
    max_pseudo_steps: int = Field(default=1000, ge=1, description="pseudo-time steps a step")
    at_rest: float = Field(
        default=1e-9, gt=0.0, lt=1.0, description="largest motion in a pseudo-time step over the size of the bodies [-]"
    )
    tolerance: float = Field(
        default=1e-8, gt=0.0, lt=1.0, description="residual over the forces of the problem that counts as converged [-]"
    )
    epsilon: float = Field(default=1e-10, ge=0.0, lt=1.0, description=_EPSILON)
    order: Literal["forward", "reverse"] = Field(default="forward", description=_ORDER)
    links_first: bool = Field(default=False, description=_LINKS)

    @property
    def accuracy(self) -> str:
        """What a step promises, in words."""
        return "none: pseudo-time steps until nothing moves; see relative_residual"


class _Converging(SceneModel):
    tolerance: float = Field(default=1e-8, gt=0.0, lt=1.0, description="residual over the forces of the problem [-]")
    max_iterations: int = Field(default=1000, ge=1, description="sweeps a step")
    iterations: int | None = Field(
        default=None,
        ge=1,
        description="a fixed number of sweeps a step, which is taken whatever its residual is; `tolerance` and "
        "`max_iterations` then have no part",
    )
    check_every: int = Field(default=10, ge=1, description=_CHECK)

    @property
    def accuracy(self) -> str:
        """What a step promises, in words."""
        if self.iterations is not None:
            return _fixed(self.iterations)
        return f"{self.tolerance:g} of the forces of each step (column force_scale, N)"


class BPXPBDSolver(_Converging):
    method: Literal["b_pxpbd"] = Field(
        description="XPBD blended with the primary residual, which converges for small stiffness numbers "
        "h^2 E / (rho dx^2); fixed_corotated, arap, neo_hookean; dynamics, one rank"
    )
    zeta: float | None = Field(
        default=None,
        ge=0.0,
        le=1.0,
        description="part of XPBD: higher is more stable, 1 stagnates; null: from the stiffness number kappa of each "
        "cell, 1 - 0.05/kappa [-]",
    )
    epsilon: float = Field(default=1e-10, ge=0.0, lt=1.0, description=_EPSILON)


class FPPXPBDSolver(_Converging):
    method: Literal["fp_pxpbd"] = Field(
        description="first Piola-Kirchhoff position-based dynamics: sweeps that solve for the stress of one cell after "
        "another; every law; dynamics, one rank"
    )
    local_iterations: int = Field(default=3, ge=1, le=20, description="Newton steps of a cell in a sweep")
    tangent: Literal["model", "exact"] = Field(
        default="model",
        description="of these steps: 2 mu I + lambda cof F (x) cof F with a closed inverse, or the projected tangent",
    )
    line_search: bool | None = Field(
        default=None,
        description="halve a cell's step where the energy of the cell and its corners rises; null: with the exact "
        "tangent, and for laws that the model does not bound",
    )


CELL_SWEEPS = (XPBDSolver, PBDSolver, XPBDQSSolver, BPXPBDSolver, FPPXPBDSolver)
