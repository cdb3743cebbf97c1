"""Files of learned weights, and the solvers that scenes make of them."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.errors import InputError
from femdeform.flow.pressure_system import AIR, FLUID, SOLID, GridArray, PressureSystem
from femdeform.scene.pressure_schema import DCDMPressureSolver, SPDLMGPressureSolver
from solvers.linear.poisson import spd_lmg_network, weights_file
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.dcdm_network import Architecture, glorot_parameters
from solvers.linear.poisson.make import PressureSolverMaker
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.trained_range import TrainedRange
from solvers.linear.poisson.training.domains import plate_labels, porous_labels
from solvers.linear.poisson.weights_file import Weights, load_weights, save_weights, shipped_weights


def domain(n: int, dim: int, is_open: bool) -> PressureSystem:
    labels: NDArray[np.uint8] = np.full((n,) * dim, FLUID, dtype=np.uint8)
    labels[((np.indices(labels.shape) + 0.5 - 0.45 * n) ** 2).sum(axis=0) < (0.2 * n) ** 2] = SOLID
    if is_open:
        labels[:, -2:] = AIR
    return PressureSystem(labels)


def right_side(system: PressureSystem) -> GridArray:
    from scipy.ndimage import gaussian_filter

    noise = np.random.default_rng(9).standard_normal(system.padded_shape)
    u = gaussian_filter(noise, (3.0, 3.0, 3.0 * (system.dim - 2)))
    b = system.new_field()
    b[system.unknown] = (u - np.roll(u, 1, 1))[system.unknown]
    system.project(b)
    return b


@pytest.fixture
def untrained(tmp_path: Path) -> Path:
    """A network of random kernels: a poor one."""
    options = {"channels": 4, "left": 0, "low": 1, "up": 0}
    architecture = Architecture(2, **options)  # type: ignore[arg-type]
    parameters = glorot_parameters(architecture, np.random.default_rng(0))
    path = tmp_path / "poor.npz"
    save_weights(path, Weights({"kind": "dcdm", "dim": 2, "architecture": options}, parameters))
    return path


def test_files_are_read_as_they_were_written(untrained: Path) -> None:
    weights = load_weights(str(untrained), "dcdm", 2)
    assert weights.meta["architecture"]["channels"] == 4
    expected = glorot_parameters(Architecture(2, channels=4, left=0, low=1, up=0), np.random.default_rng(0))
    assert weights.parameters.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(weights.parameters[name], values)


def test_damaged_files_are_refused(untrained: Path) -> None:
    data = bytearray(untrained.read_bytes())
    data[len(data) // 2] ^= 1
    untrained.write_bytes(bytes(data))
    with pytest.raises(InputError, match="damaged or has changed"):
        load_weights(str(untrained), "dcdm", 2)
    untrained.with_name("poor.npz.sha256").unlink()
    with pytest.raises(InputError, match=r"cannot read .*sha256"):
        load_weights(str(untrained), "dcdm", 2)


@pytest.mark.parametrize(("method", "dim"), [("dcdm", 3), ("spd_lmg", 2)])
def test_files_of_another_kind_are_refused(untrained: Path, method: str, dim: int) -> None:
    with pytest.raises(InputError, match="holds weights of method dcdm in 2 dimensions"):
        load_weights(str(untrained), method, dim)


def test_names_that_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="no weights named nothing"):
        load_weights("nothing", "dcdm", 2)
    monkeypatch.setattr(weights_file, "shipped_weights", list)
    with pytest.raises(InputError, match=r"no weights of method dcdm in 3 dimensions.*femdeform train dcdm --dim 3"):
        load_weights(None, "dcdm", 3)


@pytest.mark.parametrize("name", shipped_weights())
def test_shipped_weights_have_a_card_and_fit(name: str) -> None:
    method, dim = name.rsplit("-", 1)[0].replace("-", "_"), int(name[-2])
    weights = load_weights(None, method, dim)
    shapes = {key: values.shape for key, values in weights.parameters.items()}
    if method == "spd_lmg":
        assert shapes == spd_lmg_network.parameter_shapes(dim)
    else:
        assert shapes == Architecture(dim, **weights.meta["architecture"]).shapes()
    folder = Path(spd_lmg_network.__file__).parent / "weights"
    digest = (folder / f"{name}.npz.sha256").read_text().split()[0]
    card = (folder / f"{name}.md").read_text()
    assert digest in card
    for word in ("command", "seed", "commit", "data", "loss", "validation", "Limits"):
        assert word in card


@pytest.mark.parametrize("is_open", [False, True])
@pytest.mark.parametrize(("dim", "n"), [(2, 64), (2, 128), (3, 16), (3, 32)])
def test_the_shipped_cycle_is_no_worse_than_one_sweep_of_multigrid(dim: int, n: int, is_open: bool) -> None:
    system = domain(n, dim, is_open)
    b = right_side(system)
    options = SPDLMGPressureSolver(method="spd_lmg", fallback="none")
    ours = PressureSolverMaker(options, Path())(system).solve(b, 1e-4, 50)
    classical = ConjugateGradients(system, Multigrid(system, 1)).solve(b, 1e-4, 50)
    assert ours.converged
    assert ours.iterations <= classical.iterations


@pytest.mark.parametrize("sweeps", [1, 2])
@pytest.mark.parametrize(("dim", "n"), [(2, 64), (3, 32)])
def test_the_shipped_cycle_saves_iterations_on_hard_domains(dim: int, n: int, sweeps: int) -> None:
    """Random solids and plates, against multigrid with as many sweeps."""
    shape = (n,) * dim
    for labels in (porous_labels(shape, 0.4 if dim == 2 else 0.5), plate_labels(shape)):
        system = PressureSystem(labels)
        b = right_side(system)
        options = SPDLMGPressureSolver(method="spd_lmg", fallback="none", sweeps=sweeps)
        ours = PressureSolverMaker(options, Path())(system).solve(b, 1e-4, 200)
        classical = ConjugateGradients(system, Multigrid(system, sweeps)).solve(b, 1e-4, 200)
        assert ours.converged
        assert ours.iterations < classical.iterations


@pytest.mark.parametrize("is_open", [False, True])
@pytest.mark.parametrize(("dim", "n", "most"), [(2, 64, 20), (3, 16, 12), (3, 32, 14)])
def test_the_shipped_network_finds_the_answer_alone(dim: int, n: int, most: int, is_open: bool) -> None:
    """A solid ball that it has not seen, closed and open, without multigrid's help."""
    system = domain(n, dim, is_open)
    b = right_side(system)
    alone = PressureSolverMaker(DCDMPressureSolver(method="dcdm", fallback="none"), Path())(system)
    answer = alone.solve(b, 1e-4, 60)
    assert answer.converged
    assert answer.iterations <= most
    r = system.new_field()
    system.apply(answer.x, r)
    assert system.norm(b - r) <= 1.01e-4 * system.norm(b)


@pytest.mark.parametrize(
    ("dim", "n", "is_open"),
    [(2, 64, False), (2, 64, True), (3, 16, False), (3, 16, True), (3, 32, False), (3, 32, True)],
)
def test_the_guard_lets_the_shipped_network_work(dim: int, n: int, is_open: bool) -> None:
    system = domain(n, dim, is_open)
    make = PressureSolverMaker(DCDMPressureSolver(method="dcdm"), Path())
    assert make(system).solve(right_side(system), 1e-4, 60).converged
    assert make.events == []


@pytest.mark.parametrize("compare_times", [False, True])
def test_a_poor_network_is_replaced(untrained: Path, compare_times: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """By multigrid, with a line that says so; the file is named from the folder of the scene."""
    # Work of this process, not what else the machine does.
    monkeypatch.setattr(time, "perf_counter", time.process_time)
    options = DCDMPressureSolver(method="dcdm", weights="poor.npz", compare_times=compare_times)
    make = PressureSolverMaker(options, untrained.parent)
    system = domain(64, 2, False)
    solver = make(system)
    answer = solver.solve(right_side(system), 1e-6, 200)
    assert answer.converged
    assert any("mg_pcg went on" in text for text in make.events)
    if compare_times:
        assert any("multigrid from here" in text for text in make.events)
        assert make(system).name == "mg_pcg"
        make.reset()
    solver.destroy()
    alone = PressureSolverMaker(
        DCDMPressureSolver(method="dcdm", weights="poor.npz", fallback="none", kept="all"), untrained.parent
    )(system)
    assert not alone.solve(right_side(system), 1e-6, 5).converged


def test_options_that_do_not_fit() -> None:
    with pytest.raises(ValueError, match="needs a fallback"):
        SPDLMGPressureSolver(method="spd_lmg", fallback="none", compare_times=True)
    with pytest.raises(ValueError, match="at least one direction"):
        DCDMPressureSolver(method="dcdm", kept=0)


def test_a_layer_of_voxels_is_a_grid_of_two_dimensions() -> None:
    """Flows hand over labels of three dimensions."""
    flat = np.zeros((16, 12), dtype=np.uint8)
    assert PressureSystem(flat).dim == PressureSystem(flat[..., None]).dim == 2
    assert PressureSystem(np.zeros((4, 4, 2), dtype=np.uint8)).dim == 3


# ------------------------------------------------------------------------------------- what weights are for


@pytest.mark.parametrize(
    ("known", "refusal"),
    [
        (TrainedRange(16, True, 0.2), ""),
        (TrainedRange(15, True, 0.2), "32 voxels along an edge, tried on 15"),
        (TrainedRange(16, False, 0.2), "there is air, trained without"),
        (TrainedRange(16, True, 0.95), "of the voxels are fluid, trained on 0.95 to 1.00"),
        (TrainedRange(16, True, 0.2, 0.5), "of the voxels are fluid, trained on 0.20 to 0.50"),
    ],
)
def test_grids_outside_of_the_range(known: TrainedRange, refusal: str) -> None:
    system = domain(32, 2, True)
    found = known.refusal(system)
    assert found.endswith(refusal)
    assert bool(found) == bool(refusal)
    assert TrainedRange.of(known.as_meta()) == known
    assert TrainedRange.of({"kind": "dcdm"}) is None


def test_what_is_outside_goes_to_multigrid(tmp_path: Path) -> None:
    """With one line for a run of such grids, and one when the weights are used again."""
    weights = load_weights(None, "spd_lmg", 2)
    save_weights(
        tmp_path / "closed.npz", Weights(weights.meta | TrainedRange(64, False, 0.2).as_meta(), weights.parameters)
    )
    options = SPDLMGPressureSolver(method="spd_lmg", weights="closed.npz")
    make = PressureSolverMaker(options, tmp_path)
    names = [make(domain(32, 2, is_open)).name for is_open in (False, True, True, False, True)]
    assert names == ["spd_lmg", "mg_pcg", "mg_pcg", "spd_lmg", "mg_pcg"]
    refused = "spd_lmg not used (there is air, trained without); mg_pcg instead"
    assert make.events == [refused, "spd_lmg used again", refused]
    make.reset()
    make(domain(32, 2, True))
    assert len(make.events) == 4
    alone = PressureSolverMaker(options.model_copy(update={"fallback": "none"}), tmp_path)
    assert alone(domain(32, 2, True)).name == "spd_lmg"
    assert alone.events == []


@pytest.mark.parametrize("name", shipped_weights())
def test_shipped_weights_say_what_they_are_for(name: str) -> None:
    weights = load_weights(None, name.rsplit("-", 1)[0].replace("-", "_"), int(name[-2]))
    known = TrainedRange.of(weights.meta)
    assert known is not None
    assert known.cells >= 32
