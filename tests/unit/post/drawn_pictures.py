"""Pictures of results, for tests that look at their pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femdeform.post import backend
from femdeform.post.render import draw_frames
from femdeform.run.result import Result

needs_opengl = pytest.mark.skipif(not backend._can_draw(), reason="no OpenGL here, not even in software")
_SIZE = (640, 400)


def draw(folder: Path, frames: list[int], field: str | None = None) -> list[np.ndarray]:
    """Pictures as integers, without title, time and legend."""
    pictures = draw_frames(Result.open(folder), frames, field=field, size=_SIZE)
    return [picture[50:360, : int(0.83 * _SIZE[0])].astype(int) for picture in pictures]
