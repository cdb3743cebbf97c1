"""What a run needs of the simulation that it drives, whatever kind that is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from femdeform.run.time_loop import M, R, Stepper
from femdeform.run.vtu import CellData

Columns = Mapping[str, NDArray[Any]]
Fields = Mapping[str, NDArray[Any]]
# Point data and cell data of a frame.
FrameData = tuple[Fields, CellData]


class FrameWriter(Protocol):
    """Writes frames of one kind of file."""

    suffix: str  # ending of the files, with its dot

    def write(self, path: Path, time: float, point_data: Fields, cell_data: CellData) -> None:
        """Write one frame atomically.

        Raises
        ------
        ValueError
            If the data are not what a frame of this kind holds.
        """


class Course(Stepper[M, R], Protocol[M, R]):
    """A simulation of one kind, from its first state to what is told of its last one.

    Where there are several ranks every one has a course and calls all methods; what is gathered is None off rank 0.

    Attributes
    ----------
    start : Moment
        The initial state.
    notices : list of str
        What the user should be told.
    columns : tuple of str
        First columns of ``history.csv``.
    writer : FrameWriter
        Writes the frames.
    """

    start: M
    notices: list[str]
    columns: tuple[str, ...]
    writer: FrameWriter

    def row(self, state: M, report: R) -> dict[str, float | int | str]:
        """Columns of ``history.csv`` that only this kind of simulation knows, after an accepted step."""

    def frame(self, state: M) -> FrameData | None:
        """What a frame shows of a state."""

    def fields(self, state: M) -> Fields | None:
        """What a state is made of, for a checkpoint."""

    def restored(self, fields: Fields, time: float, step: int) -> M:
        """The state of a checkpoint.

        Raises
        ------
        InputError
            If it is not one of this simulation.
        KeyError
            If a field is missing.
        """

    def quantities(self, state: M) -> dict[str, float]:
        """Numbers of a state that ``result.json`` holds."""

    def verdicts(self, state: M, history: Columns | None) -> list[dict[str, Any]]:
        """What became of the scene's `expect` at the last state."""

    def facts(self) -> dict[str, Any]:
        """What ``result.json`` tells beside what every run tells."""

    def resolve(self, resolved: dict[str, Any]) -> None:
        """Complete a scene with all defaults, in place, so that it can be run from anywhere."""

    def write_beside(self, folder: Path) -> list[str]:
        """Write files that pictures need, on rank 0; returns notices."""

    def reset(self) -> None:
        """Forget what was learnt from earlier steps: the next one depends on its state alone."""

    def destroy(self) -> None:
        """Free what Python does not."""
