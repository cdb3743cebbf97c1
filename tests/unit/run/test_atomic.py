"""Files are old or new, never half of each, and what goes wrong is said in one line."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from femdeform.errors import FemdeformError, OutputError
from femdeform.run import atomic


def test_text_and_bytes_are_written_as_given(tmp_path: Path) -> None:
    atomic.write_text(tmp_path / "a.txt", "line\nÄ")
    atomic.write_bytes(tmp_path / "b.bin", b"\x00\xff")
    assert (tmp_path / "a.txt").read_bytes() == "line\nÄ".encode()
    assert (tmp_path / "b.bin").read_bytes() == b"\x00\xff"
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "b.bin"]


def test_an_exception_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "data.h5"
    target.write_text("old")

    def write_half() -> None:
        with atomic.replacing(target) as temporary:
            temporary.write_text("half of the ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["data.h5"]


def test_the_old_file_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "data.h5"
    target.write_text("old")
    with atomic.replacing(target) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".h5"
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"


def test_permissions_follow_the_umask(tmp_path: Path) -> None:
    old = os.umask(0o027)
    try:
        atomic.write_text(tmp_path / "a", "x")
    finally:
        os.umask(old)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (errno.ENOSPC, "the disk is full"),
        (errno.EDQUOT, "quota"),
        (errno.EACCES, "no permission"),
        (errno.EROFS, "read-only"),
        (errno.EIO, os.strerror(errno.EIO)),
    ],
)
def test_system_errors_become_one_line(tmp_path: Path, number: int, text: str) -> None:
    target = tmp_path / "a"
    target.write_text("old")

    def write() -> None:
        with atomic.replacing(target):
            raise OSError(number, os.strerror(number))

    with pytest.raises(OutputError, match=text) as caught:
        write()
    assert str(target) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert target.read_text() == "old"


def test_an_error_of_a_library_keeps_its_first_line(tmp_path: Path) -> None:
    def write() -> None:
        with atomic.replacing(tmp_path / "a"):
            raise OSError("cannot extend the file\nlong trace\nof the library")

    with pytest.raises(OutputError) as caught:
        write()
    assert str(caught.value).endswith("cannot extend the file")


def test_output_errors_have_the_exit_code_of_the_environment() -> None:
    assert issubclass(OutputError, FemdeformError)
    assert OutputError.exit_code == 4


def test_a_folder_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="a file, not a folder"):
        atomic.make_folder(tmp_path / "file" / "results")
    with pytest.raises(OutputError, match="cannot write"):
        atomic.write_text(tmp_path / "missing" / "a.txt", "x")


def test_leftovers_are_removed_and_nothing_else(tmp_path: Path) -> None:
    for name in (".frame-00ff.part.vtu", ".noext-00ff.part", ".hidden", "frame.vtu", "part.vtu"):
        (tmp_path / name).write_text("")
    atomic.remove_leftovers(tmp_path)
    assert sorted(os.listdir(tmp_path)) == [".hidden", "frame.vtu", "part.vtu"]


_ENDLESS = """
import sys
from pathlib import Path
from femdeform.run import atomic
target = Path(sys.argv[1])
for k in range(10**9):
    atomic.write_text(target, str(k % 10) * 300_000)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kill -9")
def test_a_killed_writer_leaves_a_whole_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    for wait in (0.02, 0.05, 0.09):
        writer = subprocess.Popen([sys.executable, "-c", _ENDLESS, str(target)])
        target.unlink(missing_ok=True)
        while not target.exists():
            assert writer.poll() is None
            time.sleep(0.005)
        time.sleep(wait)
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        text = target.read_text()
        assert text == text[0] * 300_000
    atomic.remove_leftovers(tmp_path)
    assert os.listdir(tmp_path) == ["a.txt"]
