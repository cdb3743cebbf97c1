"""Names of fields as a user gives them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femdeform.errors import InputError
from femdeform.post.fields import select_field, value_range
from femdeform.run.result import Result


def test_fields_by_name(beam: Path) -> None:
    frame = Result.open(beam).read_frame(-1)
    norm = select_field(frame, None, beam)
    np.testing.assert_allclose(norm.values, np.linalg.norm(frame.displacement, axis=1))
    assert (norm.label, norm.on_cells, norm.categorical) == ("displacement [m]", False, False)
    component = select_field(frame, "velocity.y", beam)
    np.testing.assert_allclose(component.values, 2.0 * frame.displacement[:, 1])
    assert component.label == "velocity y [m/s]"
    scalar = select_field(frame, "von_mises", beam)
    assert (scalar.label, scalar.on_cells) == ("von mises [Pa]", True)
    np.testing.assert_array_equal(scalar.values, frame.cell_data["von_mises"][0])
    tensor = select_field(frame, "cauchy_stress.yz", beam)
    assert set(tensor.values) == {5.0}
    assert select_field(frame, "cauchy_stress", beam).values[0] == pytest.approx(np.sqrt(204.0))
    assert select_field(frame, "body", beam).categorical


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("strain", "no field 'strain' in this result; it has body, cauchy_stress, displacement, velocity, von_mises"),
        ("velocity.w", "no component 'w'; its components are x, y, z"),
        ("cauchy_stress.x", "no component 'x'; its components are xx, xy"),
        ("von_mises.x", "it has no components"),
    ],
)
def test_unknown_fields_and_components(beam: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        select_field(Result.open(beam).read_frame(0), name, beam)


def test_ranges_leave_out_what_is_not_finite() -> None:
    assert value_range(np.array([np.nan, 2.0, -1.0, np.inf])) == (-1.0, 2.0)
    assert value_range(np.array([np.nan])) == (0.0, 0.0)
    assert value_range(np.zeros(0)) == (0.0, 0.0)
