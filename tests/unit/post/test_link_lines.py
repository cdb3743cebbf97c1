"""Lines of springs and pairs in pictures."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.post.links import link_segments, places_in_space

LINE = [{"nodes": [1, 3], "weights": [0.25, 0.75]}, {"place": [1.0, 2.0], "velocity": [0.5, 0.0]}]


def test_ends_follow_nodes_and_time() -> None:
    positions = np.arange(12.0).reshape(4, 3)
    (segment,) = link_segments([LINE])
    np.testing.assert_allclose(segment(positions, 2.0), [0.25 * positions[1] + 0.75 * positions[3], [2.0, 2.0, 0.0]])


def test_every_line_has_ends_of_its_own() -> None:
    positions = np.arange(12.0).reshape(4, 3)
    lines = [[{"nodes": [k], "weights": [1.0]}, {"nodes": [0], "weights": [1.0]}] for k in (1, 2)]
    first, second = link_segments(lines)
    np.testing.assert_allclose(first(positions, 0.0), positions[[1, 0]])
    np.testing.assert_allclose(second(positions, 0.0), positions[[2, 0]])


def test_pictures_have_room_for_points_of_space() -> None:
    np.testing.assert_allclose(places_in_space([LINE]), [[1.0, 2.0, 0.0]])


@pytest.mark.parametrize("facts", [None, "x", [1, None, [{}], [{"nodes": []}, {}]]])
def test_what_cannot_be_understood_is_left_out(facts: object) -> None:
    assert link_segments(facts) == []
    assert places_in_space(facts) == []
