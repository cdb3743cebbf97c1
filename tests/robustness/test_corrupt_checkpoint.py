"""A checkpoint that is damaged, or of another run: exit 2, one line, and nothing in the folder changes."""

from __future__ import annotations

import hashlib
import io
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from running import Said, assert_same_result, contents, rolling
from scenario import write

from femdeform.errors import InputError, OutputError
from femdeform.run import atomic, checkpoint
from femdeform.run.checkpoint import Checkpoint, read_checkpoint, write_checkpoint

Say = Callable[..., Said]


def sealed(data: bytes) -> bytes:
    """Contents with the checksum that a checkpoint ends with."""
    return data + checkpoint._SEAL + hashlib.sha256(data).hexdigest().encode() + b"\n"


def edited(data: bytes, edit: Callable[[h5py.File], None]) -> bytes:
    """A checkpoint changed by somebody who knows how to seal it."""
    image = io.BytesIO(data[: data.rfind(checkpoint._SEAL)])
    with h5py.File(image, "a") as file:
        edit(file)
    return sealed(image.getvalue())


def flipped(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :]


DAMAGES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda data: b"", "the checkpoint is damaged (its end is missing"),
    "cut": (lambda data: data[: len(data) // 2], "the checkpoint is damaged (its end is missing"),
    "cut by one": (lambda data: data[:-1], "the checkpoint is damaged (its checksum is wrong)"),
    "a flipped bit": (lambda data: flipped(data, len(data) // 2), "the checkpoint is damaged (its checksum is wrong)"),
    "text": (lambda data: b"not HDF5", "the checkpoint is damaged (its end is missing"),
    "sealed text": (lambda data: sealed(b"not HDF5"), "the checkpoint is damaged ("),
    "no positions": (lambda data: edited(data, lambda file: file.__delitem__("x")), "the checkpoint is damaged ("),
    "no time": (lambda data: edited(data, lambda file: file.attrs.pop("time")), "the checkpoint is damaged ("),
    "the future": (
        lambda data: edited(data, lambda file: file.attrs.__setitem__("version", 99)),
        "checkpoint version 99 is not known here, only 4",
    ),
    "another scene": (
        lambda data: edited(data, lambda file: file.attrs.__setitem__("scene_hash", "0f")),
        "the checkpoint belongs to another version of this scene",
    ),
    "another mesh": (
        lambda data: edited(data, lambda file: (file.pop("x"), file.create_dataset("x", data=np.zeros((3, 3))))),
        "the checkpoint is of another mesh",
    ),
}


@pytest.fixture
def interrupted(unbroken: tuple[Path, Path], tmp_path: Path) -> Path:
    """The folder of the unbroken run as a killed one leaves it: with nothing said about its end."""
    out = tmp_path / "out"
    shutil.copytree(unbroken[1], out)
    (out / "result.json").write_text((out / "result.json").read_text().replace('"done"', '"running"'))
    return out


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage(damage: str, unbroken: tuple[Path, Path], interrupted: Path, say: Say) -> None:
    harm, message = DAMAGES[damage]
    path = interrupted / "checkpoint.h5"
    path.write_bytes(harm(path.read_bytes()))
    before = contents(interrupted)
    said = say("run", unbroken[0], "--out", interrupted, "--trace", "--resume")
    assert (said.code, said.out) == (2, "")
    assert said.err.count("\n") == 1
    assert message in said.err
    assert str(interrupted) in said.err
    assert "--overwrite or into another folder (--out)" in said.err
    assert contents(interrupted) == before
    # The way out that the message names.
    assert say("run", unbroken[0], "--out", interrupted, "--trace", "--overwrite").code == 0
    assert_same_result(unbroken[1], interrupted)


def test_no_flipped_byte_goes_unnoticed(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    fields = {"x": rng.random((20, 3)), "v": rng.random((20, 3))}
    write_checkpoint(tmp_path, Checkpoint(fields, 0.5, 7, 0.1, 0, 3, 1.0, "abc"))
    path = tmp_path / "checkpoint.h5"
    data = path.read_bytes()
    for place in range(0, len(data), 7):
        path.write_bytes(flipped(data, place))
        with pytest.raises(InputError, match="damaged"):
            read_checkpoint(tmp_path)
    for length in range(0, len(data), 97):
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match="damaged"):
            read_checkpoint(tmp_path)
    path.write_bytes(data)
    assert read_checkpoint(tmp_path).step == 7


def test_other_programs_can_read_it(unbroken: tuple[Path, Path]) -> None:
    """What stands behind the end of the HDF5 part does not trouble HDF5."""
    with h5py.File(unbroken[1] / "checkpoint.h5", "r") as file:
        np.testing.assert_array_equal(file["x"][()], read_checkpoint(unbroken[1]).fields["x"])


def test_a_failed_write_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However far the writing has come: under its name there is always a whole checkpoint."""
    fields = {"x": np.zeros((4, 2)), "v": np.ones((4, 2))}
    first, second = (Checkpoint(fields, 0.1, step, 0.1, 0, 1, 1.0, "abc") for step in (1, 2))
    write_checkpoint(tmp_path, first)
    for name in ("write_bytes", "replace", "fsync"):

        def full(*_: object) -> None:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(Path if name == "write_bytes" else atomic.os, name, full)
            with pytest.raises(OutputError, match=r"cannot write .*checkpoint\.h5: the disk is full"):
                write_checkpoint(tmp_path, second)
        assert read_checkpoint(tmp_path).step == 1
        assert list(contents(tmp_path)) == ["checkpoint.h5"]


# ------------------------------------------------------------------------------------------- another run


def test_another_scene_or_none(unbroken: tuple[Path, Path], interrupted: Path, tmp_path: Path, say: Say) -> None:
    scene, _ = unbroken
    said = say("run", scene, "--out", tmp_path / "none", "--resume")
    assert said.code == 2
    assert said.err == f"{tmp_path / 'none' / 'checkpoint.h5'}: no checkpoint to resume from; run without --resume\n"
    assert not (tmp_path / "none").exists()
    before = contents(interrupted)
    said = say("run", scene, "--out", interrupted, "--resume", "--set", "time.dt=0.005")
    assert said.code == 2
    assert "checkpoint.h5: the checkpoint belongs to another version of this scene; run without" in said.err
    assert contents(interrupted) == before


def test_a_mesh_file_that_has_changed(tmp_path: Path, say: Say) -> None:
    """Same name, same size, same number of nodes: the scene is another one all the same."""
    assert say("mesh", "block", "--out", tmp_path / "part.mesh", "--set", "cells=[2, 1, 1]").code == 0
    data = rolling(steps=4)
    data["bodies"]["b"]["mesh"] = {"file": "part.mesh", "translate": [0.0, 0.1, 0.0]}
    scene, out = write(data, tmp_path / "s.yaml"), tmp_path / "out"
    assert say("run", scene, "--out", out, "--quiet").code == 0
    whole = tmp_path / "whole"
    shutil.copytree(out, whole)
    assert read_checkpoint(out).mesh_files == {"b": hashlib.sha256((tmp_path / "part.mesh").read_bytes()).hexdigest()}
    text = (tmp_path / "part.mesh").read_text()
    row = next(line for line in text.splitlines() if line.startswith("1 "))
    (tmp_path / "part.mesh").write_text(text.replace(row, row.replace("1 ", "2 ", 1), 1))
    assert len(text) == (tmp_path / "part.mesh").stat().st_size
    before = contents(out)
    said = say("run", scene, "--out", out, "--resume")
    assert said.code == 2
    assert said.err.count("\n") == 1
    assert said.err.startswith(f"{scene}:")
    assert "bodies.b.mesh.file: the mesh file has changed since the checkpoint was written; run without" in said.err
    assert contents(out) == before
    (tmp_path / "part.mesh").write_text(text)
    assert say("run", scene, "--out", out, "--resume").code == 0
    assert_same_result(whole, out)
