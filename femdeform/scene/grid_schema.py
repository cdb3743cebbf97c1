"""The block ``grid:``: bodies that move with a background grid."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from femdeform.scene.scene_model import Positive, SceneModel


class GridEmbedding(SceneModel):
    """Bodies embedded in a background grid, whose nodes are the unknowns of a step."""

    cell_size: Positive = Field(
        description="distance of the grid nodes, the resolution of motion and contact; about the edges of the meshes "
        "or larger [m]"
    )
    kernel: Literal["quadratic", "linear"] = Field(
        default="quadratic",
        description="B-splines that weigh the nodes; linear is cheaper, less smooth, and loses some angular momentum",
    )
    obstacles: Literal["separating", "slip", "sticky"] = Field(
        default="separating",
        description="grid nodes inside obstacles: pushed out but free to leave, kept from moving across, or held",
    )
    cfl: float = Field(
        default=0.4,
        gt=0.0,
        le=1.0,
        description="part of a cell that a body may cross in a step; steps are shortened where it moves faster [-]",
    )
