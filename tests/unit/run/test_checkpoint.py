"""Checkpoints: what is written comes back to the bit. Damaged ones: tests/robustness."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from femdeform.errors import InputError
from femdeform.run.checkpoint import FILE_NAME, Checkpoint, is_unsaved, read_checkpoint, write_checkpoint


@pytest.fixture
def checkpoint() -> Checkpoint:
    rng = np.random.default_rng(0)
    x, v = rng.standard_normal((50, 3)), rng.standard_normal((50, 3))
    x[0, 0], v[0, 0] = 0.1 + 0.2, 5e-324
    return Checkpoint({"x": x, "v": v}, 0.1 + 0.2, 7, 0.0125, 2, 3, 12.5, "abc", {"beam": "0f"})


def test_round_trip(tmp_path: Path, checkpoint: Checkpoint) -> None:
    write_checkpoint(tmp_path, checkpoint)
    again = read_checkpoint(tmp_path, "abc")
    assert set(again.fields) == set(checkpoint.fields)
    for name, values in checkpoint.fields.items():
        np.testing.assert_array_equal(again.fields[name], values)
        assert again.fields[name].dtype == np.float64
    for name, value in vars(checkpoint).items():
        if name != "fields":
            assert getattr(again, name) == value


def test_a_new_one_replaces_the_old_one(tmp_path: Path, checkpoint: Checkpoint) -> None:
    write_checkpoint(tmp_path, checkpoint)
    write_checkpoint(tmp_path, replace(checkpoint, step=8))
    assert read_checkpoint(tmp_path).step == 8
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]


def test_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no checkpoint to resume from"):
        read_checkpoint(tmp_path)


def test_of_another_scene(tmp_path: Path, checkpoint: Checkpoint) -> None:
    write_checkpoint(tmp_path, checkpoint)
    with pytest.raises(InputError, match="another version of this scene"):
        read_checkpoint(tmp_path, "xyz")


def test_a_run_that_ended_before_its_first_checkpoint(tmp_path: Path, checkpoint: Checkpoint) -> None:
    assert not is_unsaved(tmp_path)  # nothing was run there
    result = tmp_path / "result.json"
    for status in ("running", "interrupted", "failed"):
        result.write_text(json.dumps({"status": status}))
        assert is_unsaved(tmp_path)
    result.write_text(json.dumps({"status": "done"}))
    assert not is_unsaved(tmp_path)
    result.write_text("{")
    assert not is_unsaved(tmp_path)
    result.write_text(json.dumps({"status": "running"}))
    write_checkpoint(tmp_path, checkpoint)
    assert not is_unsaved(tmp_path)
