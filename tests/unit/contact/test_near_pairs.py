"""Which vertices are found near which surfaces, at what distance, on which side."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenario import block, body, build, material, quasistatic, scene

from femdeform.contact.near_pairs import NearPairs, NearPairSearch
from femdeform.contact.weak_contact import WeakContact

Array = NDArray[np.float64]


def search_of(bodies: dict[str, Any], **contact: Any) -> tuple[NearPairSearch, Array]:
    simulation = build(scene(bodies, contact={"method": "weak_constraints", "stiffness": 1.0, **contact}))
    contact_term = simulation.problem.weak_contact
    assert isinstance(contact_term, WeakContact)
    return contact_term._search, contact_term._search.surface.rest.copy()


def cube(dim: int, n: int, size: float = 1.0, at: tuple[float, ...] = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    return body(block([size] * dim, [n] * dim, translate=list(at[:dim])), material())


def box_distance(x: Array, low: float, high: float) -> Array:
    """Signed distance of points from a cube."""
    out = np.maximum(np.maximum(low - x, x - high), 0.0)
    inside = np.max(np.maximum(low - x, x - high), axis=1)
    return np.where(inside < 0.0, inside, np.linalg.norm(out, axis=1))


@pytest.mark.parametrize("dim", [2, 3])
def test_distances_are_those_of_a_cube(dim: int) -> None:
    """Vertices of a small cube that turns about the corners of a large one, inside and outside."""
    rng = np.random.default_rng(3)
    search, x = search_of({"large": cube(dim, 4), "small": cube(dim, 2, 0.5, (2.0, 2.0, 2.0))}, margin=0.2)
    small = search.surface.body == 1
    own = x[small] - x[small].mean(axis=0)
    n_inside = n_outside = n_same = 0
    for _ in range(60):
        turn, _ = np.linalg.qr(rng.standard_normal((dim, dim)))
        if np.linalg.det(turn) < 0.0:
            turn[0] *= -1.0
        x[small] = own @ turn.T + rng.uniform(-0.25, 1.25, dim)
        found = search(x, x)
        mine = search.surface.body[found.vertices] == 1
        exact = box_distance(x[found.vertices[mine]], 0.0, 1.0)
        # A corner is not pushed out of a side that looks the same way as itself, but of the next one.
        assert np.all(np.abs(found.distance[mine]) >= np.abs(exact) - 1e-12)
        n_same += int((np.abs(found.distance[mine] - exact) < 1e-12).sum())
        assert np.array_equal(found.distance[mine] < 0.0, exact < 0.0)
        n_inside += int((exact < 0.0).sum())
        n_outside += int((exact > 0.0).sum())
        foot = np.einsum("nk,nkc->nc", found.weights, x[found.corners])
        away = x[found.vertices] - foot
        np.testing.assert_allclose(np.einsum("nc,nc->n", away, found.normals), found.distance, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=1e-12)
    assert min(n_inside, n_outside) > 20
    assert n_same > 0.8 * (n_inside + n_outside)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("depth", [-1e-3, 0.0, 1e-12, 1e-7, 0.02])
def test_flush_blocks_push_along_the_common_normal(dim: int, depth: float) -> None:
    """Edges above edges: nobody slips down the side of the other block."""
    search, x = search_of({"low": cube(dim, 3), "high": cube(dim, 3, at=(0.0, 1.0, 0.0))})
    x[search.surface.body == 1, 1] -= depth
    found = search(x, x)
    n_face = 4 ** (dim - 1)
    assert len(found.vertices) == 2 * n_face
    np.testing.assert_allclose(found.distance, -depth, atol=1e-13)
    up = np.where(search.surface.body[found.vertices] == 1, 1.0, -1.0)
    np.testing.assert_allclose(found.normals[:, 1], up, atol=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_no_body_touches_itself_at_rest_nor_under_pressure(dim: int) -> None:
    """Neighbours, corners, and the two sides of a wall of one cell."""
    flat = body(block([2.0, 0.25, 1.0][:dim], [8, 1, 4][:dim]), material())
    search, x = search_of({"wall": flat}, margin=0.12)
    assert not len(search(x, x).vertices)
    x[:, 1] *= 0.3
    assert not len(search(x, x).vertices)
    x[:, 0] *= 0.5
    assert not len(search(x, x).vertices)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_strip_rolled_up_meets_itself(dim: int) -> None:
    strip = body(block([6.0, 0.2, 0.2][:dim], [60, 2, 2][:dim]), material())
    search, x = search_of({"strip": strip})
    angle = 1.003 * 2.0 * np.pi * x[:, 0] / 6.0
    radius = 6.0 / (2.0 * np.pi) + x[:, 1]
    x[:, 0], x[:, 1] = radius * np.sin(angle), radius * np.cos(angle)
    found = search(x, x)
    assert len(found.vertices)
    rest = search.surface.rest
    far = np.abs(rest[found.vertices, 0] - rest[found.corners[:, 0], 0])
    assert far.min() > 5.0  # the ends meet, nothing else does
    assert (found.distance < 0.0).any()


def test_expected_motion_finds_what_is_far_now() -> None:
    search, x = search_of({"low": cube(3, 2), "high": cube(3, 3, 0.5, (0.2, 2.0, 0.2))}, margin=0.05)
    assert not len(search(x, x).vertices)
    end = x.copy()
    end[search.surface.body == 1, 1] -= 3.0  # right through
    found = search(x, end)
    assert len(found.vertices) >= 16
    assert np.all(found.distance > 0.9)
    parted = x.copy()
    parted[search.surface.body == 1, 1] += 3.0
    assert not len(search(x, parted).vertices)


def test_only_what_may_touch() -> None:
    bodies = {"a": cube(3, 2), "b": cube(3, 2, at=(0.1, 1.0, 0.1)), "c": cube(3, 2, at=(0.1, -1.0, 0.1))}

    def pairs(**contact: Any) -> set[tuple[int, int]]:
        search, x = search_of(bodies, **contact)
        found: NearPairs = search(x, x)
        of = search.surface.body
        return {
            tuple(sorted((int(of[v]), int(of[c])))) for v, c in zip(found.vertices, found.corners[:, 0], strict=True)
        }

    assert pairs() == {(0, 1), (0, 2)}
    assert pairs(between=[["a", "c"]]) == {(0, 2)}


def test_rows_come_in_a_fixed_order() -> None:
    search, x = search_of({"a": cube(3, 3), "b": cube(3, 4, at=(0.1, 0.98, 0.1))})
    first, second = search(x, x), search(x.copy(), x.copy())
    for name in vars(first):
        assert np.array_equal(getattr(first, name), getattr(second, name))
    assert np.all(np.diff(first.vertices) >= 0)


def test_an_overlap_at_the_start_is_told() -> None:
    bodies = {"a": cube(3, 3), "b": cube(3, 3, at=(0.1, 0.95, 0.1))}
    data = scene(bodies, contact={"method": "weak_constraints", "stiffness": 1e5}, time=quasistatic())
    notices = build(data).notices
    assert any("starts inside" in notice and "0.05 m" in notice and "5e+03 N" in notice for notice in notices)
    apart = {"a": cube(3, 3), "b": cube(3, 3, at=(0.1, 1.0, 0.1))}
    assert not any("starts inside" in notice for notice in build({**data, "bodies": apart}).notices)
