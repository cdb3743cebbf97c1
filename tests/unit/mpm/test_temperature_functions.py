"""Functions of temperature and phase."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.mpm.temperature_functions import Constant, Linear, Table

T = np.array([250.0, 300.0, 350.0, 400.0])


def test_values() -> None:
    np.testing.assert_array_equal(Constant(3.0)(T), 3.0)
    np.testing.assert_allclose(Linear(2.0, 0.01, 300.0)(T), [1.5, 2.0, 2.5, 3.0])
    np.testing.assert_allclose(Linear(2.0, 0.01, 300.0, lowest=1.8, highest=2.6)(T), [1.8, 2.0, 2.5, 2.6])
    np.testing.assert_allclose(Table((300.0, 400.0), (1.0, 5.0))(T), [1.0, 1.0, 3.0, 5.0])
    np.testing.assert_array_equal(Table((300.0,), (4.0,))(T), 4.0)


def test_bad_input() -> None:
    with pytest.raises(ValueError, match="lowest"):
        Linear(0.0, 1.0, 0.0, lowest=2.0, highest=1.0)
    with pytest.raises(ValueError, match="no table"):
        Table((1.0, 2.0), (1.0,))
    with pytest.raises(ValueError, match="no table"):
        Table((), ())
    with pytest.raises(ValueError, match="ascend"):
        Table((1.0, 1.0), (1.0, 2.0))
