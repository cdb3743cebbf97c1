"""From the `contact` block to numbers and pairs: defaults, thickness, who touches whom, where bodies start."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, scene, step, write

from femdeform.contact.ipc import IPCContact, body_pairs
from femdeform.contact.obstacle_barrier import ObstacleBarrier
from femdeform.errors import InputError
from femdeform.run.setup import Simulation
from femdeform.scene.checks import check_file


def contact_of(simulation: Simulation) -> IPCContact:
    (contact,) = simulation.problem.couplings
    assert isinstance(contact, IPCContact)
    return contact


def apart(gap: float, **more: Any) -> dict[str, Any]:
    """Two squares side by side, of half a metre, with edges of 0.25 m and 0.125 m."""
    return scene(
        {
            "a": body(block([0.5, 0.5], [2, 2])),
            "b": body(block([0.5, 0.5], [4, 4], translate=[0.5 + gap, 0.0])),
        },
        **{"contact": {"method": "ipc"}, **more},
    )


def test_defaults() -> None:
    contact = contact_of(build(apart(0.1)))
    assert contact.reach == pytest.approx(0.1 * 0.125)
    assert contact.offset == 0.0
    assert contact.friction == 0.0
    # The largest body is 0.7 m across.
    assert contact.stick_velocity == pytest.approx(1e-3 * np.hypot(0.5, 0.5))


def test_penalty_is_the_default_and_brings_no_contact_between_bodies() -> None:
    simulation = build(apart(0.0, contact={}))
    assert not simulation.problem.couplings
    assert not simulation.problem.has_barriers


@pytest.mark.parametrize(("order", "dim"), [(1, 2), (2, 2), (1, 3), (2, 3)])
def test_the_area_of_the_vertices_is_the_surface(order: int, dim: int) -> None:
    data = scene(
        {"b": body(block([0.4, 0.2, 0.1][:dim], [2, 1, 1][:dim]), element_order=order)},
        contact={"method": "ipc", "stiffness": 5.0},
    )
    surface = contact_of(build(data)).surface
    area = 1.2 if dim == 2 else 2 * (0.08 + 0.04 + 0.02)
    assert surface.vertex_weight.sum() == pytest.approx(5.0 * area, rel=1e-12)
    assert surface.vertex_weight.min() > 0.0
    # Every edge has a third of the triangles beside it; in the plane it is the area.
    assert surface.edge_weight.sum() == pytest.approx(5.0 * area, rel=1e-12)
    # A closed surface: as many ends of edges as there should be.
    n_vertices, n_edges, n_faces = len(surface.nodes), len(surface.edges), len(surface.faces)
    assert n_vertices - n_edges + n_faces == (2 if dim == 3 else 0)


def test_stiffness_follows_each_body() -> None:
    """Pressure per displacement of a layer of elements, or the inertia of the body over a step if that is more."""
    data = scene(
        {
            "hard": body(block([0.5, 0.5], [2, 2]), material(E=1e8)),
            "soft": body(block([0.5, 0.5], [2, 2], translate=[1.0, 0.0]), material(E=1e2, density=1000.0)),
        },
        contact={"method": "ipc"},
    )
    surface = contact_of(build(data)).surface
    reach = 0.1 * 0.25
    length = 2.0
    assert surface.vertex_weight[surface.body == 0].sum() / length == pytest.approx(reach * 1e8 / 0.25)
    inertia = 1000.0 * 0.25 / (length * 0.01**2)
    assert surface.vertex_weight[surface.body == 1].sum() / length == pytest.approx(reach * inertia)
    still = contact_of(build({**data, "time": quasistatic()})).surface
    assert still.vertex_weight[still.body == 1].sum() / length == pytest.approx(reach * 1e2 / 0.25)


def test_thickness() -> None:
    cloth = {"recipe": "cloth", "size": [1.0, 1.0], "cells": [4, 4]}
    rod = {"recipe": "rod", "start": [-0.5, 0.3, 0.0], "end": [0.5, 0.3, 0.0], "cells": 4}
    bodies = {
        "c": body(cloth, kind="membrane", thickness=0.02),
        "r": body(rod, kind="rod", cross_section=3e-4),
    }
    ball = [{"kind": "sphere", "center": [0.0, -2.0, 0.0], "radius": 1.0}]
    radius = float(np.sqrt(3e-4 / np.pi))
    simulation = build(scene(bodies, contact={"method": "ipc"}, obstacles=ball))
    contact = contact_of(simulation)
    # One number for all pairs: that of the thinnest, two rods here.
    assert contact.offset == pytest.approx(2.0 * radius)
    (barrier,) = simulation.problem.contacts
    assert isinstance(barrier, ObstacleBarrier)
    np.testing.assert_allclose(np.unique(barrier.offset), [radius, 0.01])
    only = contact_of(build(scene(bodies, contact={"method": "ipc", "between": [["c", "r"]], "self_contact": False})))
    assert only.offset == pytest.approx(0.01 + radius)
    # A solid among them has none.
    with_solid = {**bodies, "s": body(block([0.1, 0.1, 0.1], [1, 1, 1], translate=[0.0, 1.0, 0.0]))}
    assert contact_of(build(scene(with_solid, contact={"method": "ipc"}))).offset == 0.0


def test_a_cloth_thicker_than_its_mesh_is_taken_thinner() -> None:
    cloth = {"recipe": "cloth", "size": [1.0, 1.0], "cells": [4, 4]}
    simulation = build(scene({"c": body(cloth, kind="membrane", thickness=0.1)}, contact={"method": "ipc"}))
    assert contact_of(simulation).offset == pytest.approx(0.3 * 0.25)
    assert any("thicker than their meshes are wide" in notice for notice in simulation.notices)
    assert contact_of(simulation).count(simulation.state.x) == 0


def test_pairs() -> None:
    names = ["a", "b", "c"]
    assert body_pairs(names, True, None).all()
    np.testing.assert_array_equal(body_pairs(names, False, None), ~np.eye(3, dtype=bool))
    chosen = body_pairs(names, True, [("c", "a")])
    np.testing.assert_array_equal(np.argwhere(chosen), [[0, 0], [0, 2], [1, 1], [2, 0], [2, 2]])


@pytest.mark.parametrize("self_contact", [True, False])
@pytest.mark.parametrize("between", [None, [["a", "b"]], [["c", "b"], ["a", "c"]]])
def test_who_touches_whom(self_contact: bool, between: list[list[str]] | None) -> None:
    """Three bodies side by side, one of them folded so that it touches itself, all within reach of one another."""
    contact: dict[str, Any] = {"method": "ipc", "distance": 0.02, "self_contact": self_contact}
    if between is not None:
        contact["between"] = between
    # Slender triangles: the vertices of one side are within reach of the other.
    bodies = {
        name: body(block([0.1, 0.015], [4, 1], translate=[0.0, 0.025 * k])) for k, name in enumerate(("a", "b", "c"))
    }
    simulation = build(scene(bodies, contact=contact))
    term, x = contact_of(simulation), simulation.state.x
    blocks = term.hessian_blocks(x, project=True)
    of_node = np.full(len(x), -1)
    of_node[term.surface.nodes] = term.surface.body
    coupled = np.unique(np.sort(np.stack([of_node[blocks.rows], of_node[blocks.columns]], axis=1), axis=1), axis=0)
    different = {tuple(pair) for pair in coupled.tolist() if pair[0] != pair[1]}
    # a and c are too far apart.
    expected = {(0, 1), (1, 2)} if between is None else ({(0, 1)} if len(between) == 1 else {(1, 2)})
    assert different == expected
    distances_within = term.count(x)
    if not self_contact:
        without = build(scene(bodies, contact={**contact, "self_contact": True}))
        assert contact_of(without).count(x) > distances_within


def test_a_barrier_that_acts_at_rest_is_told() -> None:
    simulation = build(scene({"b": body(block([0.1, 0.015], [4, 1]))}, contact={"method": "ipc", "distance": 0.02}))
    (notice,) = simulation.notices
    assert "the barrier acts inside `b` at rest" in notice


def faults(tmp_path: Path, data: dict[str, Any]) -> list[str]:
    return [f"{fault.key}: {fault.message}" for fault in check_file(write(data, tmp_path / "scene.yaml"))]


def test_where_bodies_start(tmp_path: Path) -> None:
    assert faults(tmp_path, apart(1e-3)) == []
    (touching,) = faults(tmp_path, apart(0.0))
    assert touching.startswith("bodies.b.mesh: `b` touches or intersects `a` near (0.4375, ")
    # Who may not touch may start anywhere.
    only = {"method": "ipc", "between": [["a", "c"]]}
    data = apart(-0.1, contact=only)
    data["bodies"]["c"] = body(block([0.1, 0.1], [1, 1], translate=[3.0, 0.0]))
    assert faults(tmp_path, data) == []


def test_spatial_bodies_that_start_inside_one_another(tmp_path: Path) -> None:
    data = scene(
        {
            "a": body(block([0.2, 0.2, 0.2], [2, 2, 2])),
            "b": body(block([0.2, 0.2, 0.2], [2, 2, 2], translate=[0.13, 0.15, 0.11])),
        },
        contact={"method": "ipc"},
    )
    (fault,) = faults(tmp_path, data)
    assert fault.startswith("bodies.b.mesh: `b` touches or intersects `a` near (0.1")
    with pytest.raises(InputError, match="touches or intersects"):
        build(data)
    layers = {
        name: body(
            {"recipe": "cloth", "size": [1.0, 1.0], "cells": [4, 4], "translate": [0.03, y, 0.02 * y]},
            kind="membrane",
            thickness=0.01,
        )
        for name, y in (("low", 0.0), ("high", 0.008))
    }
    (fault,) = faults(tmp_path, scene(layers, contact={"method": "ipc"}))
    assert "`high` is 0.008 m from `low`" in fault
    assert "less than their thickness of 0.01 m" in fault


def test_containers_are_their_walls() -> None:
    data = scene(
        {"b": body(block([0.2, 0.2], [1, 1], translate=[0.4, 0.4]))},
        obstacles=[{"kind": "box", "min": [0.0, 0.0], "max": [1.0, 1.0], "inside": True}],
        contact={"method": "ipc"},
    )
    simulation = build(data)
    assert len(simulation.problem.contacts) == 4
    gaps = [term.gaps(simulation.state.x).min() for term in simulation.problem.contacts]  # type: ignore[union-attr]
    np.testing.assert_allclose(gaps, 0.4)
    step(simulation)
