"""What the incremental potential needs of contact: terms on single nodes, and terms that couple nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from femdeform.types import FloatArray, IntArray


class ContactTerm(Protocol):
    """An energy of contact; a term of the incremental potential."""

    def begin_step(self, x: FloatArray, time: float, dt: float) -> None:
        """Freeze what a step from the accepted state `x` to `time` freezes."""

    def value(self, x: FloatArray) -> float:
        """Energy over this rank's nodes [J]; infinite where contact cannot be."""

    def add_gradient(self, x: FloatArray, out: FloatArray) -> None:
        """Add the energy gradient [N] to `out` (n_local, dim); infinite where contact cannot be."""


class NodeContact(ContactTerm, Protocol):
    """Contact of single nodes with a rigid obstacle."""

    def add_hessian(self, x: FloatArray, project: bool, diagonal: FloatArray) -> None:
        """Add node blocks [N/m] to `diagonal` (n_local, dim*dim), each positive semi-definite if `project`."""


@dataclass(frozen=True)
class NodeBlocks:
    """A symmetric matrix over nodes by its blocks.

    Attributes
    ----------
    rows, columns : (n,) int64
        Local nodes, rows < columns, sorted by row, then column, each pair once.
    blocks : (n, dim*dim) float64
        Blocks of the pairs [N/m], row-major; the transposed ones are implied.
    nodes : (m,) int64
        Nodes with a diagonal block.
    diagonal : (m, dim*dim) float64
        Their diagonal blocks [N/m].
    """

    rows: IntArray
    columns: IntArray
    blocks: FloatArray
    nodes: IntArray
    diagonal: FloatArray


class CouplingContact(ContactTerm, Protocol):
    """Contact that couples nodes which share no cell; which ones changes from state to state."""

    def hessian_blocks(self, x: FloatArray, project: bool) -> NodeBlocks:
        """Hessian [N/m], each contact's part positive semi-definite if `project`."""

    def max_step(self, x: FloatArray, step: FloatArray) -> float:
        """Largest part in [0, 1] of a step that is free of collisions."""
