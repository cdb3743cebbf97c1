"""The matrix of the pressure on a MAC grid with solids and air, and its null space."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.flow import grid_kernels
from femdeform.types import FloatArray, IntArray

FLUID, SOLID, AIR = 0, 1, 2

GridArray = NDArray[np.floating[Any]]

# A sum per component and plane of the grid is kept for no more components than this.
_MANY_COMPONENTS = 64


class PressureSystem:
    """A q = b for the pressure of the fluid voxels of a grid.

    A row of A has the number of neighbours that are no solid on its diagonal and -1 for each neighbour that is fluid;
    air has q = 0. The unknown is q = dt p / (rho h) [m/s], b the negative divergence times h [m/s]. A is symmetric and
    positive semi-definite: a connected component of fluid that air does not touch knows its pressure up to a constant.
    Fluid voxels between solids on all sides are no unknowns.

    All fields are padded by one layer, and zero where there is no unknown: (nx + 2, ny + 2, nz + 2), with nz = 1 in two
    dimensions.

    Parameters
    ----------
    labels : (nx, ny) or (nx, ny, nz) uint8
        `FLUID`, `SOLID` or `AIR` of each voxel. What lies outside of the grid is solid.
    reaction : float
        Added to the diagonal of each unknown [-]; not negative, and 0 for a pressure. A step of the heat equation has
        one, and then no component knows its values up to a constant only.

    Attributes
    ----------
    dim : int
        2 for a grid of one layer, however `labels` came.
    shape : tuple of int
        Of the grid without padding, (nx, ny, nz).
    labels : (nx + 2, ny + 2, nz + 2) uint8
    diagonal : (nx + 2, ny + 2, nz + 2) uint8, or float64 with a reaction
        Of A; 0 where there is no unknown.
    reaction : float
    n_unknowns : int

    References
    ----------
    R. Bridson, Fluid Simulation for Computer Graphics (2015), chapter 5.

    Limitations
    -----------
    Faces are open or closed as a whole: no cut cells. Voxels are cubes of one size, the fluid has one density.
    Air begins at the centre of its voxel, whatever the surface.
    """

    def __init__(self, labels: NDArray[np.uint8], reaction: float = 0.0) -> None:
        if labels.ndim not in (2, 3):
            raise ValueError(f"labels have {labels.ndim} dimensions, not 2 or 3")
        if labels.size == 0 or int(labels.max()) > AIR:
            raise ValueError(f"labels are {FLUID} (fluid), {SOLID} (solid) and {AIR} (air)")
        if not reaction >= 0.0:
            raise ValueError(f"a reaction of {reaction} leaves the matrix indefinite")
        whole = labels.reshape(*labels.shape, 1) if labels.ndim == 2 else labels
        self.dim = 2 if whole.shape[2] == 1 else 3
        self.shape = (int(whole.shape[0]), int(whole.shape[1]), int(whole.shape[2]))
        self.labels = np.pad(whole.astype(np.uint8), 1, constant_values=SOLID)
        fluid, passable = self.labels == FLUID, self.labels != SOLID
        neighbours = sum(shifted(passable, axis, side).astype(np.uint8) for axis in range(3) for side in (-1, 1))
        self.diagonal: NDArray[Any] = np.where(fluid, neighbours, 0).astype(np.uint8)
        self.reaction = reaction
        if reaction:
            self.diagonal = np.where(self.diagonal > 0, self.diagonal + reaction, 0.0)
        self.n_unknowns = int(np.count_nonzero(self.diagonal))
        self._sums = np.empty(self.padded_shape[0])

    @property
    def padded_shape(self) -> tuple[int, int, int]:
        """Shape of fields."""
        return self.shape[0] + 2, self.shape[1] + 2, self.shape[2] + 2

    @cached_property
    def unknown(self) -> NDArray[np.bool_]:
        """Voxels that have an unknown, padded."""
        return self.diagonal > 0

    @cached_property
    def _components(self) -> tuple[NDArray[np.int32], IntArray]:
        from scipy.ndimage import label

        number, n = label(self.unknown)
        air = self.labels == AIR
        touches = np.zeros(self.padded_shape, dtype=bool)
        for axis in range(3):
            for side in (-1, 1):
                touches |= shifted(air, axis, side)
        is_open = np.full(n + 1, self.reaction > 0.0)
        is_open[0] = True
        is_open[np.unique(number[touches & self.unknown])] = True
        renumbered = np.where(is_open, -1, np.cumsum(~is_open) - 1).astype(np.int32)
        component = renumbered[number]
        return component, np.bincount(component[component >= 0], minlength=int(np.count_nonzero(~is_open)))

    @property
    def component(self) -> NDArray[np.int32]:
        """Number of the closed component of each voxel, padded; -1 where there is none."""
        return self._components[0]

    @property
    def n_closed(self) -> int:
        """Number of components that air does not touch, the dimension of the null space."""
        return int(self._components[1].size)

    def new_field(self, dtype: type[np.floating[Any]] = np.float64) -> GridArray:
        """Return a field of zeros."""
        return np.zeros(self.padded_shape, dtype=dtype)

    def apply(self, x: GridArray, out: GridArray) -> None:
        """Write A x to `out`; x is zero where there is no unknown."""
        grid_kernels.apply_operator(self.diagonal, x, out)

    def dot(self, x: GridArray, y: GridArray) -> float:
        """Inner product in double precision; the same for any number of threads."""
        return float(grid_kernels.dot(x, y, self._sums))

    def norm(self, x: GridArray) -> float:
        """Euclidean norm in double precision."""
        return float(np.sqrt(self.dot(x, x)))

    def project(self, x: GridArray) -> None:
        """Subtract the mean of each closed component in place: what is left is orthogonal to the null space."""
        component, counts = self._components
        if counts.size:
            blocks = self.padded_shape[0] if counts.size <= _MANY_COMPONENTS else 1
            grid_kernels.subtract_means(component, counts, np.empty((blocks, counts.size)), x)

    def restrict(self, x: GridArray) -> FloatArray:
        """Values at the unknowns in the order of the voxels, (n_unknowns,)."""
        return np.asarray(x[self.unknown], dtype=np.float64)

    def extend(self, values: FloatArray) -> GridArray:
        """A field from values at the unknowns."""
        x = self.new_field()
        x[self.unknown] = values
        return x

    def matrix(self) -> Any:
        """A over the unknowns as a SciPy CSR matrix (n_unknowns, n_unknowns), for solvers that want one."""
        import scipy.sparse

        number = np.full(self.padded_shape, -1, dtype=np.int64)
        number[self.unknown] = np.arange(self.n_unknowns)
        rows, columns = [number[self.unknown]], [number[self.unknown]]
        values = [self.diagonal[self.unknown].astype(np.float64)]
        for axis in range(3):
            for side in (-1, 1):
                other = shifted(number, axis, side, fill=-1)
                pairs = self.unknown & (other >= 0)
                rows.append(number[pairs])
                columns.append(other[pairs])
                values.append(np.full(rows[-1].size, -1.0))
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return scipy.sparse.csr_matrix(entries, shape=(self.n_unknowns,) * 2)


def shifted(values: NDArray[Any], axis: int, side: int, fill: int = 0) -> NDArray[Any]:
    """The neighbour's value of each voxel: that at index + `side` along an axis; `fill` outside of the array."""
    out = np.full_like(values, fill)
    to, source = [slice(None)] * values.ndim, [slice(None)] * values.ndim
    to[axis], source[axis] = (slice(0, -1), slice(1, None)) if side > 0 else (slice(1, None), slice(0, -1))
    out[tuple(to)] = values[tuple(source)]
    return out
