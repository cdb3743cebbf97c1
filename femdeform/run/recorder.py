"""Writes the result folder of a run, so that every moment of it can be read, resumed and drawn.

The folder holds ``resolved.yaml``, ``result.json``, ``history.csv``, ``iterations.csv`` (traced runs only),
``frames/frame_00000.vtu`` and on, ``frames.pvd`` and ``final.vtu``; frames of other kinds have other endings. Tables
grow by whole rows that are flushed at once; every other file is replaced atomically. A run killed at any moment leaves
a folder that can be read, and a resumed one leaves the files that an unbroken run would have left (but for wall times).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run import atomic, result_folder
from femdeform.run.course import FrameWriter
from femdeform.run.plain import to_yaml
from femdeform.run.table import Table, Value, last_step, time_of_step, truncate_table
from femdeform.run.vtk_reader import read_pvd, read_time
from femdeform.run.vtk_xml import write_pvd
from femdeform.run.vtu import CellData

ITERATION_COLUMNS = (
    "step",
    "iteration",
    "residual_norm",
    "relative_residual",
    "objective",
    "step_length",
    "linear_iterations",
    "seconds",
)


class Recorder:
    """Writes one result folder.

    Per step, call `step`, then `frame` where one is due, then `sync` and only then write the checkpoint:
    whatever a checkpoint stands for is then already in the folder.

    Parameters
    ----------
    folder : Path
        Result folder; created where it is missing.
    writer : FrameWriter
        Writes the frames.
    columns : sequence of str
        First columns of ``history.csv``.
    resume_from_step : int, optional
        Step of the checkpoint the run goes on from; rows and frames after it are dropped.
    trace : bool
        Write ``iterations.csv``; without it `iteration` does nothing.
    overwrite : bool
        Remove a result that lies in the folder, instead of refusing to start. Other files stay.

    Raises
    ------
    InputError
        If a fresh run would land on another result, or a resumed one finds no result to go on from.
    OutputError
        If the folder cannot be written to.
    """

    def __init__(
        self,
        folder: Path,
        writer: FrameWriter,
        columns: Sequence[str],
        *,
        resume_from_step: int | None = None,
        trace: bool = False,
        overwrite: bool = False,
    ) -> None:
        self.folder = folder
        self._writer = writer
        self._facts: dict[str, Any] = {}
        self._last_step = 0 if resume_from_step is None else resume_from_step
        self._last_time = 0.0
        self._frames: dict[str, float] = {}
        atomic.make_folder(folder)
        if resume_from_step is None:
            if not overwrite:
                result_folder.check_vacant(folder)
            result_folder.clear(folder, results=overwrite)
        atomic.make_folder(folder / "frames")
        if resume_from_step is not None:
            self._return_to(resume_from_step)
        self._history = Table(folder / "history.csv", columns)
        self._iterations = Table(folder / "iterations.csv", ITERATION_COLUMNS) if trace else None

    def start(self, resolved: Mapping[str, Any], facts: Mapping[str, Any]) -> None:
        """Write ``resolved.yaml``, and ``result.json`` with the status ``running``.

        Parameters
        ----------
        resolved : mapping
            The scene with every default and override in place; it can be run again.
        facts : mapping
            What is known before the first step: number of dofs, ranks, versions, scene hash, title.

        Raises
        ------
        OutputError
            If a file cannot be written.
        """
        self._facts = dict(facts)
        result_folder.reserve(self.folder, facts)
        self._write_result("running", "")
        atomic.write_text(self.folder / "resolved.yaml", to_yaml(resolved))

    def step(self, row: Mapping[str, Value]) -> None:
        """Add a row to ``history.csv``.

        Parameters
        ----------
        row : mapping
            Values by column. The first row fixes the columns: the first ones given and whatever else it holds. A
            later row may leave columns out (an empty cell), not add any.

        Raises
        ------
        OutputError
            If the row cannot be written.
        ValueError
            If the row has no `step`, or a column the first row did not have.
        """
        self._history.append(row)
        self._last_step = int(row["step"])
        self._last_time = float(row.get("time", self._last_time))

    def iteration(self, row: Mapping[str, Value]) -> None:
        """Add a row to ``iterations.csv`` of a traced run; as `step`, with `ITERATION_COLUMNS`."""
        if self._iterations is not None:
            self._iterations.append(row)

    def frame(
        self,
        index: int,
        time: float,
        point_data: Mapping[str, NDArray[Any]],
        cell_data: CellData | None = None,
    ) -> Path:
        """Write a frame and add it to ``frames.pvd``.

        Parameters
        ----------
        index : int
            Number in the file name; a frame of the same number is replaced.
        time : float
            Time of the frame [s].
        point_data : dict of str to (n_points,) or (n_points, k) arrays
            As the writer of the frames wants them.
        cell_data : dict of str to list of arrays, optional
            Likewise.

        Returns
        -------
        Path
            The file written.

        Raises
        ------
        OutputError
            If a file cannot be written.
        ValueError
            If the data are not what the writer wants.
        """
        file = f"frames/frame_{index:05d}{self._writer.suffix}"
        self._write_mesh(self.folder / file, time, point_data, cell_data)
        self._frames[file] = float(time)
        self._write_pvd()
        return self.folder / file

    def sync(self) -> None:
        """Flush the tables to the disk itself: a power cut then leaves the rows before a checkpoint."""
        self._history.sync()
        if self._iterations is not None:
            self._iterations.sync()

    def finish(
        self,
        status: str,
        reason: str,
        facts: Mapping[str, Any],
        final_point_data: Mapping[str, NDArray[Any]],
        final_cell_data: CellData | None = None,
    ) -> None:
        """Write the last frame (``final.vtu``) and the final ``result.json``, and close the tables.

        Parameters
        ----------
        status : str
            One word: ``done``, ``not_converged``, ``failed``, ...
        reason : str
            Why the run ended, one line; empty when it simply reached its end.
        facts : mapping
            Added to, or over, the facts given to `start`: wall seconds, verdicts of `expect`.
        final_point_data, final_cell_data
            The last accepted state, as in `frame`.

        Raises
        ------
        OutputError
            If a file cannot be written.
        """
        self._write_mesh(
            self.folder / f"final{self._writer.suffix}", self._last_time, final_point_data, final_cell_data
        )
        self._facts.update(facts)
        self.sync()
        self._write_result(status, reason)
        result_folder.release(self.folder)
        self.close()

    def close(self) -> None:
        """Close the tables; for a run that ends without `finish`. May be called twice."""
        self._history.close()
        if self._iterations is not None:
            self._iterations.close()

    def _write_mesh(
        self, path: Path, time: float, point_data: Mapping[str, NDArray[Any]], cell_data: CellData | None
    ) -> None:
        self._writer.write(path, float(time), point_data, cell_data or {})

    def _write_pvd(self) -> None:
        entries = sorted((time, file) for file, time in self._frames.items())
        write_pvd(self.folder / "frames.pvd", entries)

    def _write_result(self, status: str, reason: str) -> None:
        head = {"status": status, "reason": reason, "steps": self._last_step}
        facts = {**head, **self._facts, "status": status, "reason": reason}
        result_folder.write_facts(self.folder, facts)

    def _return_to(self, step: int) -> None:
        """Drop what was recorded after a checkpoint."""
        history = self.folder / "history.csv"
        if not (self.folder / "result.json").exists():
            raise InputError([Fault(str(self.folder), 0, "", "no result to resume: result.json is missing")])
        for folder in (self.folder, self.folder / "frames"):
            atomic.remove_leftovers(folder)
        recorded = last_step(history)
        if recorded < step:
            message = f"ends at step {recorded}, the checkpoint is of step {step}: run again without --resume"
            raise InputError([Fault(str(history), 0, "", message)])
        truncate_table(history, step)
        truncate_table(self.folder / "iterations.csv", step)
        time = time_of_step(history, step)
        # The frames carry no step, their times do: later steps have later times. A run resumed from its
        # initial state has no row to take the time from, and keeps the first frame only.
        entries = sorted(self._listed_frames())
        if time is None:
            entries = entries[:1]
        else:
            self._last_time = time
            entries = [entry for entry in entries if entry[0] <= time + 1e-12 * abs(time)]
        self._frames = {file: moment for moment, file in entries if (self.folder / file).exists()}
        with atomic.writing(self.folder / "frames"):
            for path in (self.folder / "frames").glob(f"frame_*{self._writer.suffix}"):
                if f"frames/{path.name}" not in self._frames:
                    path.unlink()
            (self.folder / f"final{self._writer.suffix}").unlink(missing_ok=True)
        if self._frames or (self.folder / "frames.pvd").exists():
            self._write_pvd()

    def _listed_frames(self) -> list[tuple[float, str]]:
        if (self.folder / "frames.pvd").exists():
            return read_pvd(self.folder / "frames.pvd")
        # The list is lost, the frames are not: each knows its time.
        files = [f"frames/{path.name}" for path in (self.folder / "frames").glob(f"frame_*{self._writer.suffix}")]
        return [(read_time(self.folder / file), file) for file in files]
