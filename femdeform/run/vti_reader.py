"""Reads the frames (.vti) of fields in voxels that `femdeform.run.vti` writes, without VTK."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.run.vtk_reader import child, read_arrays, reading, time_of
from femdeform.types import FloatArray


@dataclass(frozen=True)
class GridFrame:
    """A frame of fields in the voxels of a grid; arrays are read-only.

    Attributes
    ----------
    time : float
        Time [s].
    shape : (int, int, int)
        Voxels along x, y, z; one along z for a 2D scene.
    spacing : (3,) float64
        Sides of a voxel [m].
    origin : (3,) float64
        Lower corner of the grid [m].
    cell_data : dict of str to (nx, ny, nz) or (nx, ny, nz, k) arrays
        Fields at the centres of the voxels.
    """

    time: float
    shape: tuple[int, int, int]
    spacing: FloatArray
    origin: FloatArray
    cell_data: dict[str, NDArray[Any]]

    @property
    def dim(self) -> int:
        """Dimension of the scene."""
        return 2 if self.shape[2] == 1 else 3

    @property
    def box(self) -> FloatArray:
        """Lowest and highest corner of the grid, (2, 3) [m]; flat for a 2D scene."""
        high = self.origin + np.array(self.shape) * self.spacing
        if self.dim == 2:
            high[2] = self.origin[2]
        return np.stack([self.origin, high])

    @property
    def solid(self) -> NDArray[np.bool_]:
        """Voxels inside solids, (nx, ny, nz); none where the frame does not say."""
        return np.asarray(self.cell_data.get("solid", np.zeros(self.shape)), dtype=np.bool_)


def read_vti(path: Path) -> GridFrame:
    """Read a file written by `VTIWriter`.

    Parameters
    ----------
    path : Path
        The ``.vti`` file.

    Raises
    ------
    InputError
        If the file is missing, torn, or not of the kind `VTIWriter` writes.
    """
    with reading(path) as root:
        image = child(root, "ImageData")
        extent = [int(word) for word in image.get("WholeExtent", "").split()]
        spacing, origin = (_numbers(image.get(name, "")) for name in ("Spacing", "Origin"))
        shape = extent[1::2]
        if len(extent) != 6 or any(extent[::2]) or min(shape) < 1:
            raise ValueError("the extent of the grid makes no sense")
        if len(spacing) != 3 or len(origin) != 3 or not np.all(np.isfinite([spacing, origin])) or spacing.min() <= 0.0:
            raise ValueError("the place of the grid makes no sense")
        nx, ny, nz = shape
        flat = read_arrays(child(image, "Piece"), "CellData", nx * ny * nz)
        # VTK's first index runs fastest.
        return GridFrame(
            time=time_of(root),
            shape=(nx, ny, nz),
            spacing=spacing,
            origin=origin,
            cell_data={
                name: np.moveaxis(values.reshape(nz, ny, nx, *values.shape[1:]), (0, 1, 2), (2, 1, 0))
                for name, values in flat.items()
            },
        )


def _numbers(text: str) -> FloatArray:
    return np.array([float(word) for word in text.split()], dtype=np.float64)
