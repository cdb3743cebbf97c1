"""Training: the differentiable cycle is the compiled one, steps lower the loss, resumed runs repeat unbroken ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import label

torch = pytest.importorskip("torch")

from femdeform.cli import main  # noqa: E402
from femdeform.flow.pressure_system import SOLID, PressureSystem  # noqa: E402
from solvers.linear.poisson import spd_lmg_network as network  # noqa: E402
from solvers.linear.poisson.dcdm_network import (  # noqa: E402
    Architecture,
    evaluate,
    glorot_parameters,
)
from solvers.linear.poisson.dcdm_operations import CompiledOperations, framed, prepare  # noqa: E402
from solvers.linear.poisson.spd_lmg import LearnedMultigrid  # noqa: E402
from solvers.linear.poisson.training.domains import random_labels  # noqa: E402
from solvers.linear.poisson.training.learn_dcdm import DCDMLearner, TorchOperations  # noqa: E402
from solvers.linear.poisson.training.ritz import ritz_pairs, ritz_right_sides  # noqa: E402
from solvers.linear.poisson.training.settings import TrainingSettings  # noqa: E402
from solvers.linear.poisson.training.torch_cycle import BatchCycle, domain_levels  # noqa: E402
from solvers.linear.poisson.weights_file import load_weights  # noqa: E402

torch.set_num_threads(1)


@pytest.mark.parametrize("dim", [2, 3])
def test_both_evaluations_of_the_network_agree(dim: int) -> None:
    architecture = Architecture(dim, masks=True, channels=6)
    rng = np.random.default_rng(0)
    parameters = glorot_parameters(architecture, rng)
    x = rng.standard_normal((3, *(12, 8, 6)[:dim])).astype(np.float32)
    ours = evaluate(architecture, prepare(parameters), framed(x), CompiledOperations())
    tensors = {name: torch.tensor(values) for name, values in parameters.items()}
    theirs = evaluate(architecture, tensors, torch.tensor(x)[None], TorchOperations())
    inner = ours[(slice(None), *(slice(1, -1),) * dim)]
    np.testing.assert_allclose(theirs[0].numpy(), inner, atol=1e-4 * np.abs(inner).max())


@pytest.mark.parametrize("dim", [2, 3])
def test_both_cycles_agree(dim: int) -> None:
    rng = np.random.default_rng(3)
    parameters = network.start_parameters(dim, rng)
    for name, values in parameters.items():
        if ".heads." in name or name == "factors":
            values[...] = 0.2 * rng.standard_normal(values.shape)
    systems = [PressureSystem(random_labels((16, 12, 10)[:dim], rng)) for _ in range(3)]
    cycle = BatchCycle([domain_levels(s) for s in systems], dim, "cpu")
    residuals = [s.extend(rng.standard_normal(s.n_unknowns)) for s in systems]
    batch = np.stack([r[..., 1] if dim == 2 else r for r in residuals]).astype(np.float32)
    tensors = {name: torch.tensor(values) for name, values in parameters.items()}
    found = cycle.apply(cycle.prepare(tensors), torch.tensor(batch)).numpy()
    for system, r, z in zip(systems, residuals, found, strict=True):
        expected = system.new_field()
        LearnedMultigrid(system, parameters).apply(r, expected)
        ours = expected[..., 1] if dim == 2 else expected
        np.testing.assert_allclose(z, ours, atol=3e-4 * np.abs(ours).max())


def test_ritz_vectors() -> None:
    system = PressureSystem(np.zeros((12, 10), dtype=np.uint8))
    values, vectors = ritz_pairs(system, 200, np.random.default_rng(0))
    A = system.matrix()
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(vectors.shape[1]), atol=1e-5)
    np.testing.assert_allclose(vectors.T @ (A @ vectors), np.diag(values), atol=1e-5)
    np.testing.assert_allclose(A @ vectors[:, :5], vectors[:, :5] * values[:5], atol=1e-5)
    exact = np.unique(np.round(np.linalg.eigvalsh(A.toarray()), 9))[1:]
    np.testing.assert_allclose(values[:5], exact[:5], atol=1e-7)
    sides = ritz_right_sides(vectors, 400, np.random.default_rng(1))
    np.testing.assert_allclose(np.linalg.norm(sides, axis=1), 1.0, rtol=1e-5)
    amplitudes = np.sqrt(((sides @ vectors) ** 2).mean(axis=0))
    low = round(0.55 * vectors.shape[1])
    assert amplitudes[:low].mean() == pytest.approx(9.0 * amplitudes[low:].mean(), rel=0.05)


def test_domains_of_training() -> None:
    """One component; all hard ones have a solid, and only some of the others do."""
    parts = {}
    for hard in (0.0, 1.0):
        rng = np.random.default_rng(4)
        systems = [PressureSystem(random_labels((12, 12, 12), rng, hard)) for _ in range(40)]
        for system in systems:
            assert label(system.unknown)[1] == 1
            assert system.n_unknowns > 0.2 * 12**3
        parts[hard] = sum(bool(np.any(s.labels[1:-1, 1:-1, 1:-1] == SOLID)) for s in systems)
    assert parts[1.0] == 40
    assert 20 < parts[0.0] < 40


def test_a_sample_starts_with_the_error_of_its_right_hand_side(tmp_path: Path) -> None:
    """Errors have no mean where the domain is closed and are zero outside; a step lowers their energy."""
    learner = DCDMLearner(TrainingSettings("dcdm", tmp_path, dim=3, cells=8, batch=48))
    slots = torch.arange(48)
    errors = learner._errors.clone()
    torch.testing.assert_close(learner._domains.project(slots, errors), errors, atol=1e-5, rtol=0.0)

    def energies() -> torch.Tensor:
        e = learner._errors
        return (e * learner._domains.times(slots, e)).flatten(1).sum(dim=1)

    before = energies()
    learner._rng = np.random.default_rng(0)
    loss = learner.loss()
    # Errors were scaled to unit energy before the step, all but those that were made anew.
    kept = learner._energy < 1.0
    assert kept.sum() > 40
    after = energies()[kept]
    assert torch.all(before > 0.0)
    torch.testing.assert_close(after.sqrt(), learner._energy[kept], rtol=1e-3, atol=1e-5)
    assert 0.0 < float(loss) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["spd_lmg", "dcdm", "dcdm --route ritz --lanczos 60 --samples 64 --model narrow --rate 1e-3"]
)
def test_training_learns_and_can_be_resumed(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from solvers.linear.poisson.training import loop

    monkeypatch.setattr(loop, "MOST_ITERATIONS", 12)
    options = "--cells 16 --steps 40 --batch 4 --validations 4 --quiet --name made"
    common = ["train", *kind.split(), *options.split()]
    assert main([*common, "--out", str(tmp_path / "whole")]) == 0
    out = capsys.readouterr().out
    for name in ("made.npz", "made.md", "made-loss.png"):
        assert name in out
        assert (tmp_path / "whole" / name).is_file()
    whole = torch.load(tmp_path / "whole" / loop.CHECKPOINT, weights_only=False)["progress"]
    assert len(whole["losses"]) == 40
    if "dcdm" in kind:
        assert np.mean(whole["losses"][-8:]) < np.mean(whole["losses"][:8])
    assert min(v for _, v in whole["validations"]) <= whole["validations"][0][1]
    # Broken off at the first validation after step 20, and resumed.
    tell_until = loop._validate

    def stop(learner: object, systems: object, progress: loop.Progress) -> None:
        if progress.step > 20:
            raise KeyboardInterrupt
        tell_until(learner, systems, progress)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(loop, "_validate", stop)
        assert main([*common, "--out", str(tmp_path / "broken")]) == 130
    assert main([*common, "--out", str(tmp_path / "broken")]) == 2
    assert main([*common, "--out", str(tmp_path / "broken"), "--resume"]) == 0
    again = torch.load(tmp_path / "broken" / loop.CHECKPOINT, weights_only=False)["progress"]
    np.testing.assert_allclose(again["losses"], whole["losses"], rtol=1e-6)
    method = kind.split()[0]
    ours, theirs = (load_weights(str(tmp_path / f / "made.npz"), method, 2) for f in ("whole", "broken"))
    for name, values in ours.parameters.items():
        np.testing.assert_allclose(theirs.parameters[name], values, atol=1e-7)
    assert main([*common, "--out", str(tmp_path / "broken"), "--resume", "--seed", "3"]) == 2
    # What was trained is where another run starts.
    made = tmp_path / "whole" / "made.npz"
    further = [*common, "--out", str(tmp_path / "further"), "--steps", "1", "--start", str(made)]
    assert main(further) == 0
    start = torch.load(tmp_path / "further" / loop.CHECKPOINT, weights_only=False)["progress"]["start"]
    for name, values in ours.parameters.items():
        np.testing.assert_array_equal(start[name], values)
    assert made.with_name("made.npz.sha256").read_text().split()[0] in (tmp_path / "further/made.md").read_text()


def test_faults_of_the_command(tmp_path: Path) -> None:
    assert main(["train", "dcdm", "--cells", "15", "--out", str(tmp_path)]) == 2
    assert main(["train", "dcdm", "--model", "none", "--out", str(tmp_path)]) == 2
    assert main(["train", "dcdm", "--hard", "1.5", "--out", str(tmp_path)]) == 2
    assert main(["train", "dcdm", "--start", str(tmp_path / "none.npz"), "--out", str(tmp_path / "new")]) == 2
    assert main(["train", "dcdm", "--resume", "--cells", "16", "--out", str(tmp_path)]) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("dcdm --rate -1", "--rate: must be a positive number, not -1"),
        ("dcdm --rate nan", "--rate: must be a positive number, not nan"),
        ("spd_lmg --minutes -1", "--minutes: must be a positive number [min], not -1"),
        ("spd_lmg --minutes inf", "--minutes: must be a positive number [min], not inf"),
        ("spd_lmg --model masks", "--model: is for dcdm, not for spd_lmg"),
        ("spd_lmg --route ritz", "--route: is for dcdm"),
        ("spd_lmg --precision float32", "--precision: is for dcdm"),
        ("spd_lmg --lanczos 1000", "--lanczos: is for dcdm"),
        ("spd_lmg --samples 20000", "--samples: is for dcdm"),
        ("dcdm --samples 20000", "--samples: is for --route ritz"),
    ],
)
def test_options_that_make_no_sense(
    options: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", *options.split(), "--cells", "16", "--steps", "2", "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("at", [0, 5])
def test_a_loss_that_is_no_number_ends_the_training(
    at: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the best weights so far, and the exit code of a solver that failed; validations are told on the way."""
    from solvers.linear.poisson.training import loop
    from solvers.linear.poisson.training.learn_lmg import LMGLearner

    monkeypatch.setattr(loop, "MOST_ITERATIONS", 2)
    loss, count = LMGLearner.loss, [0]

    def broken(self: LMGLearner) -> torch.Tensor:
        count[0] += 1
        return loss(self) * (float("nan") if count[0] > at else 1.0)

    monkeypatch.setattr(LMGLearner, "loss", broken)
    options = ["--cells", "16", "--steps", "8", "--batch", "2", "--validations", "4", "--name", "made"]
    assert main(["train", "spd_lmg", *options, "--out", str(tmp_path)]) == 3
    err = capsys.readouterr().err
    assert f"the loss was no finite number in step {at + 1}" in err
    card = (tmp_path / "made.md").read_text()
    assert f"ended early: the loss was no finite number in step {at + 1}" in card
    # Two iterations are too few for all of them; what is beyond is not told as if it were measured.
    assert "over 2 iterations at the start, over 2 at step" in card
    lines = [line for line in err.splitlines() if line.startswith("step ")]
    assert [line.split(":")[0] for line in lines] == [f"step {k} of 8" for k in (1, 2, 4)[: 3 if at else 0]]
    assert all("validation over 2 iterations" in line for line in lines)
    weights = load_weights(str(tmp_path / "made.npz"), "spd_lmg", 2)
    assert all(np.all(np.isfinite(values)) for values in weights.parameters.values())
