"""What a run starts from: a checked scene, its meshes, a folder to write to and a checkpoint to go on from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from femdeform.errors import FemdeformError, InputError
from femdeform.run.atomic import check_writable
from femdeform.run.checkpoint import START_ANEW, Checkpoint, is_unsaved, read_checkpoint
from femdeform.run.failure import end_all_ranks
from femdeform.run.result import Result
from femdeform.run.result_folder import check_vacant
from femdeform.run.threads import THREADED_CELLS, THREADED_VOXELS
from femdeform.scene.checks import check_file, check_loaded
from femdeform.scene.load import LoadedScene, load_scene
from femdeform.scene.mesh_files import mesh_file_hashes
from femdeform.scene.meshing import load_meshes
from femdeform.scene.skins import load_skins
from femdeform.types import Mesh

# Exit codes of runs that have reached their end, by the status in their result.
_ENDED = {"done": 0, "expectation_failed": 1}


@dataclass(frozen=True)
class RunInput:
    """What a run starts from: the scene, its meshes, the result folder and what is to go on from there."""

    loaded: LoadedScene
    meshes: dict[str, Mesh]
    mesh_files: dict[str, str]
    folder: Path
    checkpoint: Checkpoint | None
    overwrite: bool
    skins: dict[str, Mesh] = field(default_factory=dict)
    ended: int | None = None  # exit code of a run that has nothing left to do

    @property
    def n_cells(self) -> int:
        """How many cells a step goes through, which decides how many threads it is worth."""
        scene = self.loaded.scene
        if scene.simulation == "deformable":
            return sum(mesh.n_cells for mesh in self.meshes.values())
        return scene.n_cells

    @property
    def threaded_cells(self) -> int:
        """Cells from which on a second thread is worth it: voxels are done sooner than what is else stepped through."""
        return THREADED_VOXELS if self.loaded.scene.simulation == "incompressible_flow" else THREADED_CELLS


def read_together(
    path: Path, out: Path | None, overrides: Sequence[str], resume: bool, overwrite: bool, comm: Any | None
) -> RunInput:
    """Read, check and mesh on rank 0; give all ranks the same answer, or the same error.

    Parameters
    ----------
    path, out, overrides, resume, overwrite
        As for `femdeform.run.runner.run_scene`.
    comm : mpi4py communicator or None
        Every rank calls.

    Raises
    ------
    FemdeformError
        If the scene, its meshes or the result folder are not fit for a run.
    """
    answer: RunInput | FemdeformError | None = None
    if comm is None or comm.Get_rank() == 0:
        try:
            answer = _read(path, out, overrides, resume, overwrite, 1 if comm is None else comm.Get_size())
        except FemdeformError as error:
            answer = error
        except BaseException as error:
            if comm is not None:
                end_all_ranks(comm, error)
            raise
    if comm is not None:
        answer = comm.bcast(answer, root=0)
    if isinstance(answer, FemdeformError):
        raise answer
    assert answer is not None
    return answer


def _read(
    path: Path, out: Path | None, overrides: Sequence[str], resume: bool, overwrite: bool, ranks: int
) -> RunInput:
    try:
        loaded = load_scene(path, overrides)
    except InputError as error:
        # With what a check finds in the sound part, so that the user hears of everything at once.
        raise InputError(check_file(path, overrides) or error.faults) from None
    if ranks > 1:
        _check_ranks(loaded, ranks)
    folder = out if out is not None else Path("results") / loaded.path.stem
    # A run that was killed before its first checkpoint has nothing to go on from: it begins again.
    begin_again = resume and is_unsaved(folder)
    if not (resume or overwrite):
        check_vacant(folder)
    checkpoint = read_checkpoint(folder, loaded.hash) if resume and not begin_again else None
    if checkpoint is not None:
        _check_mesh_files(loaded, checkpoint)
        status = Result.open(folder).facts["status"]
        if status in _ENDED:
            return RunInput(loaded, {}, {}, folder, checkpoint, False, ended=_ENDED[status])
    meshes = load_meshes(loaded)
    skins = load_skins(loaded)
    faults = check_loaded(loaded, meshes)
    if faults:
        raise InputError(faults)
    # Told before the work of setting up, not after it.
    check_writable(folder)
    return RunInput(loaded, meshes, mesh_file_hashes(loaded), folder, checkpoint, overwrite or begin_again, skins)


def _check_ranks(loaded: LoadedScene, ranks: int) -> None:
    scene = loaded.scene
    alone = f"on one rank, with threads, not on {ranks}"
    if scene.simulation == "incompressible_flow":
        raise InputError([loaded.fault(("simulation",), f"{scene.simulation} runs {alone}")])
    if scene.simulation == "material_points" and scene.time.scheme == "explicit":
        raise InputError([loaded.fault(("time", "scheme"), f"explicit steps of material points run {alone}")])
    if scene.linear_solver.method == "scipy_direct":
        key = ("linear_solver", "method")
        raise InputError([loaded.fault(key, f"scipy_direct is serial; use ksp on {ranks} ranks")])
    if scene.simulation == "deformable" and scene.contact.method == "ipc":
        key = ("contact", "method")
        raise InputError([loaded.fault(key, f"ipc is serial; run on one rank, not {ranks}, or use penalty")])


def _check_mesh_files(loaded: LoadedScene, checkpoint: Checkpoint) -> None:
    hashes = mesh_file_hashes(loaded)
    changed = [name for name, digest in hashes.items() if checkpoint.mesh_files.get(name) != digest]
    if changed:
        sources = loaded.scene.mesh_sources()
        message = f"the mesh file has changed since the checkpoint was written; {START_ANEW}"
        raise InputError([loaded.fault((*sources[name][0], "file"), message) for name in changed])
