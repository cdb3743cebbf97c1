"""What a scene may say of the constraints of a membrane or rod: edges, tethers, bending, enclosed volume."""

from __future__ import annotations

from pydantic import Field

from femdeform.scene.scene_model import Positive, SceneModel

_EDGE = "compliance of each edge, elongation per force [m/N]; default: from Young's modulus, "


class Tether(SceneModel):
    """Every node may be no farther from the nearest anchor than along the body."""

    to: str = Field(description="group of the body's mesh whose nodes the others are tethered to")
    slack: float = Field(default=1.0, ge=1.0, description="largest distance over that along the edges at rest [-]")
    compliance: Positive = Field(description="of each tether, elongation per force [m/N]")


class EnclosedVolume(SceneModel):
    """Volume that a closed membrane keeps."""

    ratio: Positive = Field(default=1.0, description="volume without force over that at rest [-]")
    compliance: Positive = Field(description="change of volume per pressure [m^3/Pa]")


class RodConstraints(SceneModel):
    """Constraints in place of the energy of the law."""

    edges: Positive | None = Field(default=None, description=_EDGE + "L / (E A)")
    bending_stiffness: Positive | None = Field(
        default=None,
        description="bending stiffness of the rod, moment per curvature, E pi r^4 / 4 of a round one [N m^2]; default: "
        "no resistance",
    )
    tether: Tether | None = Field(default=None, description="limit of the distance from anchors")


class MembraneConstraints(SceneModel):
    """Constraints in place of the energy of the law."""

    edges: Positive | None = Field(
        default=None, description=_EDGE + "L^2 / (E t a) with the area a of the triangles at the edge"
    )
    bending: Positive | None = Field(
        default=None,
        description="compliance of the angle between the two triangles at each edge, angle per moment [rad/(N m)]; "
        "default: no resistance",
    )
    tether: Tether | None = Field(default=None, description="limit of the distance from anchors")
    volume: EnclosedVolume | None = Field(default=None, description="volume that a closed membrane keeps")
