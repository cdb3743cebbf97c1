"""Deep conjugate directions with functions that need no training, the guard, and the network's shape."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.flow.pressure_system import AIR, FLUID, SOLID, GridArray, PressureSystem
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.dcdm import DeepConjugateDirections, Directions
from solvers.linear.poisson.dcdm_network import (
    Architecture,
    NetworkDirections,
    evaluate,
    glorot_parameters,
    zero_parameters,
)
from solvers.linear.poisson.dcdm_operations import CompiledOperations, framed, prepare
from solvers.linear.poisson.guard import (
    DCDM_LIMITS,
    FasterOf,
    Guarded,
    Limits,
    Noticed,
    SlowNotice,
    SpeedRule,
    Watchdog,
)
from solvers.linear.poisson.interface import PoissonResult
from solvers.linear.poisson.multigrid import Multigrid
from verification.benchmarks.heat_system import HeatSystem


def domain(n: int = 32, dim: int = 2, is_open: bool = False) -> PressureSystem:
    labels: NDArray[np.uint8] = np.full((n,) * dim, FLUID, dtype=np.uint8)
    labels[n // 4 : n // 2, n // 3 : n // 2] = SOLID
    if is_open:
        labels[:, -2:] = AIR
    return PressureSystem(labels)


def right_side(system: PressureSystem) -> GridArray:
    b = system.extend(np.random.default_rng(5).standard_normal(system.n_unknowns))
    system.project(b)
    return b


def identity(r: GridArray) -> GridArray:
    return r.copy()


def v_cycle(system: PressureSystem) -> Directions:
    cycle = Multigrid(system, 1)

    def directions(r: GridArray) -> GridArray:
        z = system.new_field()
        cycle.apply(r, z)
        return z

    return directions


def crooked(system: PressureSystem) -> Directions:
    """Neither linear nor symmetric: a cycle of the residual with its larger values cut."""
    inner = v_cycle(system)

    def directions(r: GridArray) -> GridArray:
        scale = np.abs(r).max()
        return inner(np.tanh(2.0 * r / scale) * scale) + 0.05 * r

    return directions


@pytest.mark.parametrize("kept", [1, 2, 5, None])
@pytest.mark.parametrize("is_open", [False, True])
def test_kept_directions_are_conjugate(kept: int | None, is_open: bool) -> None:
    system = domain(is_open=is_open)
    solver = DeepConjugateDirections(system, crooked(system), kept)
    answer = solver.solve(right_side(system), 1e-8, 9)
    assert answer.iterations >= 6
    assert len(solver.last) == (answer.iterations if kept is None else min(kept, answer.iterations))
    for k, (d, Ad, dAd) in enumerate(solver.last):
        out = system.new_field()
        system.apply(d, out)
        np.testing.assert_allclose(out, Ad, atol=1e-12 * np.abs(Ad).max())
        # With few kept, two that are both kept were made conjugate when the later one was found.
        for other, _, other_energy in solver.last[:k]:
            assert abs(system.dot(other, Ad)) < 1e-10 * np.sqrt(dAd * other_energy)


@pytest.mark.parametrize("is_open", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["cycle", "crooked", "identity"])
def test_it_finds_the_answer(kind: str, dim: int, is_open: bool) -> None:
    system = domain(32 if dim == 2 else 12, dim, is_open)
    f = {"cycle": v_cycle, "crooked": crooked, "identity": lambda system: identity}[kind](system)
    b = right_side(system)
    answer = DeepConjugateDirections(system, f).solve(b, 1e-8, 400)
    assert answer.converged, answer.reason
    r = system.new_field()
    system.apply(answer.x, r)
    assert system.norm(b - r) <= 1.01e-8 * system.norm(b)
    assert answer.residuals[-1] == pytest.approx(system.norm(b - r), rel=0.1)
    again = DeepConjugateDirections(system, f).solve(b, 1e-7, 400, x=answer.x)
    assert again.iterations == 0


def test_with_the_residual_itself_it_is_conjugate_gradients() -> None:
    system = domain()
    b = right_side(system)
    ours = DeepConjugateDirections(system, identity, kept=1).solve(b, 1e-6, 300)
    theirs = ConjugateGradients(system).solve(b, 1e-6, 300)
    assert abs(ours.iterations - theirs.iterations) <= 1
    np.testing.assert_allclose(ours.residuals[:15], theirs.residuals[:15], rtol=1e-9)


def test_keeping_all_directions_never_takes_more_iterations() -> None:
    system = domain()
    b = right_side(system)
    few, many = (DeepConjugateDirections(system, crooked(system), kept).solve(b, 1e-8, 300) for kept in (1, None))
    assert many.converged
    assert many.iterations <= few.iterations


@pytest.mark.parametrize("value", [0.0, np.nan, 1.0])
def test_a_function_that_is_none_is_reported(value: float) -> None:
    """Zero, no number, and a constant, of which the projection leaves nothing."""
    system = domain()
    answer = DeepConjugateDirections(system, lambda r: np.full_like(r, value)).solve(right_side(system), 1e-6, 50)
    assert not answer.converged
    assert answer.iterations <= 3
    assert "direction" in answer.reason or "finite" in answer.reason


# ------------------------------------------------------------------------------------------------ the guard


def test_a_zero_network_falls_back() -> None:
    system = domain()
    b = right_side(system)
    architecture = Architecture(dim=2, left=0, low=1, up=0, channels=2)
    f = NetworkDirections(system, architecture, zero_parameters(architecture))
    events: list[str] = []
    multigrid = ConjugateGradients(system, Multigrid(system), "mg_pcg")
    solver = Guarded(DeepConjugateDirections(system, f), DCDM_LIMITS, lambda: multigrid, events)
    answer = solver.solve(b, 1e-6, 100)
    assert answer.converged
    assert events == ["dcdm stopped (the direction has no energy); mg_pcg went on"]
    assert events[0] in answer.reason
    assert answer.residuals[-1] <= 1e-6 * system.norm(b)


def test_a_slow_function_is_stopped_and_its_answer_is_the_start() -> None:
    system = domain(64)
    b = right_side(system)
    limits = Limits(factor=2.0, iterations=20)
    starts: list[GridArray | None] = []

    class Recorded(ConjugateGradients):
        def solve(self, b, tolerance, max_iterations, x=None, watch=None) -> PoissonResult:  # type: ignore[no-untyped-def]
            starts.append(x)
            return super().solve(b, tolerance, max_iterations, x, watch)

    events: list[str] = []
    solver = Guarded(
        DeepConjugateDirections(system, identity),
        limits,
        lambda: Recorded(system, Multigrid(system), "mg_pcg"),
        events,
    )
    answer = solver.solve(b, 1e-4, 200)
    assert answer.converged
    assert "no answer after 20 iterations" in events[0]
    assert starts[0] is not None
    assert np.any(starts[0])
    assert 20 < answer.iterations < 30
    assert len(answer.residuals) == answer.iterations + 1


@pytest.mark.parametrize("factor", [0.9, np.nan, -30.0])
def test_a_solver_that_says_it_is_done_is_not_believed(factor: float) -> None:
    """The residual is computed anew; an answer that is worse than none is no start."""
    system = domain()
    b = right_side(system)

    class Boaster(ConjugateGradients):
        def solve(self, b, tolerance, max_iterations, x=None, watch=None) -> PoissonResult:  # type: ignore[no-untyped-def]
            answer = super().solve(b, 1e-9, max_iterations)
            return PoissonResult(factor * answer.x, 3, True, "done", [answer.residuals[0], 0.0])

    events: list[str] = []
    boaster = Boaster(system, name="boaster")
    solver = Guarded(boaster, DCDM_LIMITS, lambda: ConjugateGradients(system, Multigrid(system), "mg_pcg"), events)
    answer = solver.solve(b, 1e-6, 300)
    assert answer.converged
    assert answer.residuals[-1] <= 1e-6 * system.norm(b)
    assert len(events) == 1
    assert events[0].startswith("boaster stopped (its residual is ")
    honest = Guarded(ConjugateGradients(system), Limits(9.0, 999), lambda: pytest.fail("not needed"), [])
    assert honest.solve(b, 1e-6, 300).converged


def test_the_guard_serves_other_matrices() -> None:
    """Steps of the heat equation, whose matrix is definite and not that of a pressure."""
    system = HeatSystem(32, 2, 1e3)
    b = system.hot_ball(1e3)
    architecture = Architecture(dim=2, left=0, low=1, up=0, channels=2)
    f = NetworkDirections(system, architecture, zero_parameters(architecture))
    events: list[str] = []
    slow = Guarded(
        DeepConjugateDirections(system, f), DCDM_LIMITS, lambda: ConjugateGradients(system, Multigrid(system)), events
    )
    answer = slow.solve(b, 1e-8, 300)
    assert answer.converged
    assert len(events) == 1
    r = system.new_field()
    system.apply(answer.x, r)
    assert system.norm(b - r) <= 1e-8 * system.norm(b)
    events.clear()
    good = DeepConjugateDirections(system, v_cycle(system))
    assert Guarded(good, DCDM_LIMITS, lambda: pytest.fail("not needed"), events).solve(b, 1e-8, 300).converged
    assert events == []


def test_the_watchdog() -> None:
    dog = Watchdog(Limits(0.5, 12), 1.0, 1e-4, 1e-4)
    assert [dog(k, 0.3**k) for k in (1, 2, 3, 4)] == [""] * 4
    assert dog(5, 0.3**4 * 0.9) == ""
    assert dog(6, 0.3**4 * 0.8) != ""  # (0.3 * 0.8)^(1/3) = 0.62
    assert dog(7, 1e-5) == ""
    # A residual that stays for four iterations and then falls: too slow over three of them, and not over eight.
    norms = [0.5, 0.4, 0.45, 0.42, 0.4, 0.2, 0.1, 0.05, 0.02]
    told = {}
    for window in (3, 8):
        dog = Watchdog(Limits(0.8, 30, window), 1.0, 1e-4, 1e-4)
        told[window] = [dog(k, norm) for k, norm in enumerate(norms, start=1)]
    assert any(told[3])
    assert not any(told[8])
    # More digits, more iterations.
    assert Watchdog(Limits(2.0, 12), 1.0, 1e-8, 1e-8)(23, 0.1) == ""
    assert "24 iterations" in Watchdog(Limits(2.0, 12), 1.0, 1e-8, 1e-8)(24, 0.1)


def test_the_faster_solver_is_used() -> None:
    rule = SpeedRule()
    system = domain()
    b = right_side(system)
    made: list[str] = []

    def make(name: str, preconditioned: bool) -> ConjugateGradients:
        made.append(name)
        return ConjugateGradients(system, Multigrid(system) if preconditioned else None, name)

    solver = FasterOf(lambda: make("learned", False), lambda: make("classical", True), rule)
    assert solver.solve(b, 1e-6, 500).converged
    assert made == ["learned", "learned", "classical", "classical"]
    rule.take(0.95, 1.0, True)
    assert not rule.is_learned
    assert solver.name == "classical"
    count = len(rule.events)
    rule.take(0.5, 1.0, True)
    assert rule.is_learned
    assert solver.name == "learned"
    assert len(rule.events) == count + 1
    rule.take(0.5, 1.0, False)
    assert not rule.is_learned
    assert [rule.is_due() for _ in range(50)].count(True) == 1


def test_multigrid_is_measured_once_beside_a_learned_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the second solve; the answer stays that of the learned solver, and only a slower one is told."""
    from solvers.linear.poisson import guard

    system = domain()
    b = right_side(system)
    times: list[float] = []
    monkeypatch.setattr(guard.time, "perf_counter", lambda: times.pop(0))
    for classical, count in ((0.5, 1), (2.0, 0)):
        rule = SlowNotice()
        made: list[str] = []

        def make(made: list[str] = made) -> ConjugateGradients:
            made.append("classical")
            return ConjugateGradients(system, Multigrid(system), "classical")

        solver = Noticed(ConjugateGradients(system, None, "learned"), make, rule)
        times[:] = [0.0, 1.0, 0.0, 1.0, 0.0, classical, 0.0, 1.0]
        answers = [solver.solve(b, 1e-6, 500) for _ in range(3)]
        assert times == []
        assert made == ["classical"]
        assert len({answer.iterations for answer in answers}) == 1
        np.testing.assert_array_equal(answers[0].x, answers[1].x)
        assert len(rule.notices) == count
        assert all("learned took 1 s for a pressure, multigrid 0.5 s" in text for text in rule.notices)


# ------------------------------------------------------------------------------------------------ the network


@pytest.mark.parametrize(
    ("architecture", "count"),
    [
        (Architecture(), 97_457),
        (Architecture(bias=False), 97_216),
        (Architecture(left=2, low=5, up=3), 152_881),
        (Architecture(dim=2), 32_657),
        (Architecture(residual=False), 97_457),
        (Architecture(pooled=False, residual=False), 97_457),
        (Architecture(skip=False), 97_457),
        (Architecture(channels=8), 24_537),
    ],
)
def test_numbers_of_parameters(architecture: Architecture, count: int) -> None:
    assert architecture.n_parameters == count


@pytest.mark.parametrize(("architecture", "reach"), [(Architecture(), 21), (Architecture(left=2, low=5, up=3), 33)])
def test_reach(architecture: Architecture, reach: int) -> None:
    assert architecture.reach == reach


@pytest.mark.parametrize("shape", [(8, 10), (40, 70), (6, 4, 8), (4, 34, 36)])
@pytest.mark.parametrize("outputs", [2, 7])
def test_convolution(shape: tuple[int, ...], outputs: int) -> None:
    """Against SciPy's correlation, channel by channel; planes shorter and longer than what is summed at a time."""
    from scipy.ndimage import correlate

    rng = np.random.default_rng(0)
    dim = len(shape)
    x = rng.standard_normal((3, *shape))
    kernel = rng.standard_normal((3,) * dim + (3, outputs))
    bias = rng.standard_normal(outputs)
    made = prepare({"a.kernel": kernel, "a.bias": bias})
    plus = np.zeros((made["a.bias"].size, *(n + 2 for n in shape)), dtype=np.float32)
    plus[(slice(None), *(slice(1, -1),) * dim)] = rng.standard_normal((plus.shape[0], *shape))
    operations = CompiledOperations()
    inner = (slice(0, outputs), *(slice(1, -1),) * dim)
    for is_cut, added in ((False, None), (True, None), (True, plus)):
        found = operations.convolve(framed(x), made["a.kernel"], made["a.bias"], is_cut, added)
        for o in range(outputs):
            expected = sum(correlate(x[i], kernel[..., i, o], mode="constant") for i in range(3)) + bias[o]
            expected = np.maximum(expected, 0.0) if is_cut else expected
            np.testing.assert_allclose(
                found[inner][o], expected if added is None else expected + added[inner][o], atol=1e-4
            )
        framed_zeros = found.copy()
        framed_zeros[(slice(None), *inner[1:])] = 0.0
        assert not np.any(framed_zeros)
    alone = operations.convolve(framed(x), made["a.kernel"], None, False, None)
    first = sum(correlate(x[i], kernel[..., i, 0], mode="constant") for i in range(3))
    np.testing.assert_allclose(alone[inner][0], first, atol=1e-4)


@pytest.mark.parametrize("shape", [(8, 6), (4, 6, 8)])
def test_halving_and_doubling(shape: tuple[int, ...]) -> None:
    x = np.random.default_rng(1).standard_normal((3, *shape)).astype(np.float32)
    dim = len(shape)
    inner = (slice(None), *(slice(1, -1),) * dim)
    operations = CompiledOperations()
    half = operations.halve(framed(x))
    split = x.reshape(3, *(m for n in shape for m in (n // 2, 2)))
    np.testing.assert_allclose(half[inner], split.mean(axis=tuple(range(2, 2 * dim + 1, 2))), atol=1e-6)
    whole = half[inner]
    for axis in range(dim):
        whole = np.repeat(whole, 2, axis=axis + 1)
    np.testing.assert_array_equal(operations.double(half, None)[inner], whole)
    np.testing.assert_allclose(operations.double(half, framed(x))[inner], whole + x, atol=1e-6)


@pytest.mark.parametrize("dim", [2, 3])
def test_what_the_network_reaches(dim: int) -> None:
    """A voxel moves the answer within the reach and not beyond it."""
    architecture = Architecture(dim=dim, left=0, low=1, up=0, channels=3, bias=False)
    parameters = glorot_parameters(architecture, np.random.default_rng(2))
    x = np.zeros((1, 32) + (4,) * (dim - 1), dtype=np.float32)
    x[0, 15, 2] = 1.0
    answer = evaluate(architecture, prepare(parameters), framed(x), CompiledOperations())[0, 1:-1]
    moved = np.flatnonzero(np.abs(answer).reshape(32, -1).max(axis=1))
    assert moved.min() >= 15 - architecture.reach
    assert moved.max() <= 15 + architecture.reach + 1
    assert moved.size > 8


@pytest.mark.parametrize("masks", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_directions_of_a_network(dim: int, masks: bool) -> None:
    """Odd sizes, solids and air; the scale of the residual does not matter."""
    labels: NDArray[np.uint8] = np.full((9, 7, 5)[:dim], FLUID, dtype=np.uint8)
    labels[3:5, 2:4] = SOLID
    labels[:, -1] = AIR
    system = PressureSystem(labels)
    architecture = Architecture(dim=dim, channels=4, masks=masks)
    f = NetworkDirections(system, architecture, glorot_parameters(architecture, np.random.default_rng(1)))
    b = right_side(system)
    z = f(b)
    assert np.all(z[~system.unknown] == 0.0)
    assert np.any(z)
    np.testing.assert_allclose(f(1e-7 * b), z, rtol=1e-4, atol=1e-6)
    assert not np.any(f(system.new_field()))
    with pytest.raises(ValueError, match="dimension"):
        NetworkDirections(domain(8, 5 - dim), architecture, {})
