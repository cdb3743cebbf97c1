"""From the scene's words to laws, and what compiled code may ask of them."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from femdeform.errors import InputError
from femdeform.jit import TypingError, njit
from femdeform.materials import (
    LAWS,
    batch,
    dispatch,
    lame_parameters,
    law_class,
    law_for,
    supports_codimension,
    with_precision,
)
from femdeform.scene import schema


def material(law: str, E: float = 2.6, nu: float = 0.3) -> SimpleNamespace:
    return SimpleNamespace(law=law, youngs_modulus=E, poisson_ratio=nu)


def test_every_law_of_the_scene_is_here_and_no_other() -> None:
    union = get_args(schema.Material)[0]
    words = {get_args(model.model_fields["law"].annotation)[0] for model in get_args(union)}
    assert words == set(LAWS)


@pytest.mark.parametrize("word", sorted(LAWS))
def test_law_for_a_material_of_the_scene(word: str) -> None:
    union = get_args(schema.Material)[0]
    model = next(m for m in get_args(union) if get_args(m.model_fields["law"].annotation)[0] == word)
    law = law_for(model(law=word, density=1000.0, youngs_modulus=2.6, poisson_ratio=0.3), 3)
    assert type(law) is law_class(word)
    assert law.mu == pytest.approx(1.0)
    assert law.lmbda == pytest.approx(0.0 if word == "arap" else 1.5)
    assert "References" in (type(law).__doc__ or "")
    assert "Limitations" in (type(law).__doc__ or "")


def test_constants_of_the_neo_hookean_laws() -> None:
    assert law_for(material("neo_hookean"), 3) == pytest.approx((1.0, 1.5, 2.5))
    assert law_for(material("stable_neo_hookean"), 3) == pytest.approx((1.0, 1.5, 4.0 / 3.0, 1.5 + 5.0 / 6.0))
    assert law_for(material("stable_neo_hookean"), 2) == pytest.approx((1.0, 1.5, 1.5, 1.5 + 2.0 / 3.0))


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (material("mooney"), "there is no 'mooney'; known are arap"),
        (material("arap", E=-1.0), "youngs_modulus: must be positive and finite, got -1.0"),
        (material("arap", E=np.inf), "youngs_modulus: must be positive and finite, got inf"),
        (material("arap", nu=0.5), "poisson_ratio: must lie between -1 and 0.5"),
        (material("arap", nu=np.nan), "poisson_ratio: must lie between -1 and 0.5"),
    ],
)
def test_bad_materials_are_refused_in_one_line(bad: SimpleNamespace, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        law_for(bad, 3)
    assert "\n" not in str(caught.value)


def test_dimension_must_be_two_or_three() -> None:
    with pytest.raises(ValueError, match="dim must be 2 or 3, got 1"):
        law_for(material("arap"), 1)


def test_lame_parameters() -> None:
    assert lame_parameters(2.0, 0.0) == (1.0, 0.0)
    mu, lmbda = lame_parameters(1.0, 0.25)
    assert (mu, lmbda) == pytest.approx((0.4, 0.4))


def test_only_linear_elasticity_does_not_support_codimension() -> None:
    supported = {word for word in LAWS if supports_codimension(law_for(material(word), 3))}
    assert supported == set(LAWS) - {"linear"}


def test_with_precision_converts_every_parameter() -> None:
    law = with_precision(law_for(material("stable_neo_hookean"), 3), np.float32)
    assert type(law) is law_class("stable_neo_hookean")
    assert all(type(value) is np.float32 for value in law)  # type: ignore[attr-defined]


# ---------------------------------------------------------------------------------------- dispatch

F3 = (1.1, 0.2, -0.1, 0.05, 0.9, 0.0, 0.3, 0.1, 1.2)


@pytest.mark.parametrize("word", sorted(LAWS))
def test_dispatch_from_python_equals_the_batch(word: str) -> None:
    for dim, F in ((3, F3), (2, F3[:4])):
        law = law_for(material(word), dim)
        arrays = np.reshape(F, (1, dim, dim))
        assert dispatch.energy_density(F, law) == pytest.approx(batch.energy_density(arrays, law)[0], rel=1e-13)
        np.testing.assert_allclose(dispatch.pk1(F, law), batch.pk1(arrays, law).ravel(), rtol=1e-13, atol=1e-13)
        H = np.full((dim * dim, dim * dim), np.nan)
        dispatch.tangent(F, law, True, H)
        np.testing.assert_allclose(H.ravel(), batch.tangent(arrays, law, True).ravel(), rtol=1e-12, atol=1e-12)


@njit
def _thickness_energy(s: tuple[float, float, float], law: dispatch.Law) -> float:
    return dispatch.energy_from_stretches(s, law)


@njit
def _energy(F: tuple[float, ...], law: dispatch.Law) -> float:
    return dispatch.energy_density(F, law)


def test_compiled_code_is_told_what_a_law_cannot_do() -> None:
    with pytest.raises(TypingError, match="Linear is not a function of the principal stretches"):
        _thickness_energy((1.1, 1.0, 1.0), law_for(material("linear"), 3))
    with pytest.raises(LookupError, match="Linear is not a function of the principal stretches"):
        dispatch.energy_from_stretches((1.1, 1.0, 1.0), law_for(material("linear"), 3))
    with pytest.raises(TypingError, match="expected a tuple of 4 or 9 floats"):
        _energy((1.0, 1.0), law_for(material("linear"), 3))
    with pytest.raises(TypingError, match="the law must be a named tuple"):
        _energy(F3, 1.0)  # type: ignore[arg-type]


def test_batch_refuses_other_shapes() -> None:
    for shape in ((3, 3), (2, 3, 2), (5, 4, 4)):
        with pytest.raises(ValueError, match="F must have the shape"):
            batch.pk1(np.zeros(shape), law_for(material("arap"), 3))


def test_batch_takes_integers_slices_and_nothing() -> None:
    law = law_for(material("neo_hookean"), 3)
    assert batch.energy_density(np.eye(3, dtype=int)[None], law)[0] == 0.0
    F = np.random.default_rng(0).standard_normal((6, 3, 3))
    np.testing.assert_array_equal(batch.pk1(F[::2], law), batch.pk1(F, law)[::2])
    assert batch.tangent(np.zeros((0, 3, 3)), law).shape == (0, 3, 3, 3, 3)


def test_importing_the_package_does_not_import_numba() -> None:
    code = (
        "import sys, femdeform.jit, femdeform.materials as m; m.LAWS; m.lame_parameters(1.0, 0.3);"
        "sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
