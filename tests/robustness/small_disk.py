"""A file system of its own, small enough to be filled."""

from __future__ import annotations

import errno
import subprocess
from pathlib import Path


class Disk:
    """A small file system; to make one takes the right to mount.

    Parameters
    ----------
    folder : Path
        Where to mount it; created.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        _mount("-t", "tmpfs", "-o", "size=4m", "none", str(folder))

    def resize(self, size: str) -> None:
        """Change the size; what lies there stays."""
        _mount("-o", f"remount,size={size}", str(self.folder))

    def fill(self) -> None:
        """Use up all room there is."""
        with (self.folder / "filler").open("ab", buffering=0) as file:
            for size in (65536, 4096, 1):
                try:
                    while True:
                        file.write(bytes(size))
                except OSError as error:
                    assert error.errno == errno.ENOSPC  # noqa: PT017

    def make_room(self) -> None:
        """Give it back."""
        (self.folder / "filler").unlink()

    def remove(self) -> None:
        """Unmount it."""
        subprocess.run(["umount", "--lazy", str(self.folder)], check=True)


def _mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True, capture_output=True, text=True)
