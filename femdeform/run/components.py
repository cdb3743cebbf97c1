"""Components of vectors by their words."""

from __future__ import annotations

import numpy as np

from femdeform.types import FloatArray


def component_of(vector: FloatArray, component: str) -> float:
    """The component ``x``, ``y`` or ``z`` of a vector, or its ``norm``."""
    return float(np.linalg.norm(vector)) if component == "norm" else float(vector["xyz".index(component)])
