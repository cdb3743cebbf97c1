"""A scene of any kind: the union of what `simulation:` may say."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from femdeform.scene.flow_schema import FlowScene
from femdeform.scene.point_schema import PointScene
from femdeform.scene.schema import DeformableScene

AnyScene = DeformableScene | FlowScene | PointScene
Scene = Annotated[AnyScene, Field(discriminator="simulation")]
