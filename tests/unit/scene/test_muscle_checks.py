"""What is wrong with muscles of a scene is said at their keys."""

from __future__ import annotations

from typing import Any

import pytest
from scenario import block, body, build, scene

from femdeform.errors import InputError

GOOD: dict[str, Any] = {
    "fibres": {"kind": "constant", "direction": [1.0, 0.0]},
    "max_isometric_stress": 1e5,
    "activation": 0.5,
}


def faults(muscle: dict[str, Any] | None = None, **more: Any) -> list[tuple[str, str]]:
    solver = more.pop("solver", {"method": "projected_newton"})
    own = body(block([1.0, 1.0], [2, 2]), **({} if muscle is None else {"muscle": muscle}), **more)
    try:
        build(scene({"m": own}, solver=solver))
    except InputError as error:
        return [(fault.key, fault.message) for fault in error.faults]
    return []


def test_a_good_one() -> None:
    assert faults(GOOD) == []


@pytest.mark.parametrize(
    ("change", "key", "message"),
    [
        ({"fibres": {"kind": "constant", "direction": [1.0, 0.0, 0.0]}}, "fibres.direction", "needs 2 entries"),
        ({"fibres": {"kind": "cell_data", "name": "v"}}, "fibres.name", "no vectors of cells `v`"),
        ({"fibres": {"kind": "harmonic", "origin": "m.left", "insertion": "m.rigth"}}, "fibres.insertion", "no group"),
        ({"activation": 1.5}, "activation", "1"),
        ({"activation": {"times": [0.0, 1.0], "values": [0.0, 2.0]}}, "activation", "between 0 and 1"),
        ({"max_isometric_stress": -1.0}, "max_isometric_stress", "greater than 0"),
    ],
)
def test_keys_are_named(change: dict[str, Any], key: str, message: str) -> None:
    found = faults({**GOOD, **change})
    assert found
    assert any(where.startswith(f"bodies.m.muscle.{key}") and message in text for where, text in found), found


def test_groups() -> None:
    (found,) = faults(muscles={"belly": GOOD})
    assert found[0] == "bodies.m.muscles.belly"
    assert "no group of cells `belly`" in found[1]
    found_both = faults(GOOD, muscles={"belly": GOOD})
    assert any("use one of the two" in text for _, text in found_both)


def test_groups_must_not_share_cells() -> None:
    mesh = {"recipe": "muscle", "cells": [6, 2]}
    muscle = {**GOOD, "fibres": {"kind": "constant", "direction": [1.0, 0.0, 0.0]}}
    with pytest.raises(
        InputError, match="share cells, which can have the fibres of one muscle only: `muscle`, `belly`"
    ):
        build(scene({"m": body(mesh, muscles={"muscle": muscle, "belly": muscle})}))


def test_a_field_that_cannot_be_made_names_its_key() -> None:
    data = scene(
        {
            "m": body(
                block([1.0, 1.0], [2, 2]),
                muscle={**GOOD, "fibres": {"kind": "harmonic", "origin": "m.left", "insertion": "m.bottom"}},
            )
        }
    )
    with pytest.raises(InputError, match=r"bodies\.m\.muscle\.fibres: insertion: shares 1 nodes"):
        build(data)


def test_membranes_have_no_muscles() -> None:
    cloth = {"kind": "membrane", "thickness": 1e-3, "muscle": GOOD}
    with pytest.raises(InputError, match="it belongs to `solid`"):
        build(scene({"m": body({"recipe": "cloth", "cells": [2, 2]}, **cloth)}))
