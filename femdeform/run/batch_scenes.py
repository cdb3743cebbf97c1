"""The scenes of a study: loaded, hashed and checked before anything runs, faults at the line that causes them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from femdeform.errors import Fault, InputError
from femdeform.run.batch_plan import Plan, PlannedRun, expand
from femdeform.scene.batch_schema import LoadedStudy, varied_keys
from femdeform.scene.checks import check_file, check_loaded
from femdeform.scene.key_path import KeyPath
from femdeform.scene.load import LoadedScene, load_scene, scene_hash, sort_faults
from femdeform.scene.mesh_schema import FileMesh
from femdeform.scene.meshing import MeshSurvey, survey_meshes
from femdeform.scene.overrides import parse_override
from femdeform.scene.wording import did_you_mean

Advance = Callable[[int, int], None]

# What result.json says beside the quantities that can be listed.
FACTS = ("steps", "wall_seconds", "time", "n_dofs", "n_cells", "threads")
DEFAULT_FACTS = ("steps", "wall_seconds")


def plan_runs(loaded: LoadedStudy, advance: Advance) -> Plan:
    """Expand a study, and judge every scene by the schema.

    Parameters
    ----------
    loaded : LoadedStudy
        The study.
    advance : callable
        Called with the number of scenes judged so far, and the number of all.

    Raises
    ------
    InputError
        With every fault of every scene, at the line of the study that brings it about, or of the scene file.
    """
    bare = expand(loaded.study)
    runs: list[PlannedRun] = []
    measured: dict[str, None] = {}
    judged: dict[str, None] = {}
    contents = _FileHashes()
    blame = _Blame(loaded, len(bare))
    for run in bare:
        try:
            scene = load_scene(loaded.scene_path, run.overrides)
        except InputError:
            # With what a check finds in the sound part, so that the user hears of everything at once.
            blame.add(run, check_file(loaded.scene_path, run.overrides))
        else:
            measured.update(dict.fromkeys(scene.scene.measure))
            judged.update(dict.fromkeys(wanted.name for wanted in getattr(scene.scene.expect, "over_time", ())))
            runs.append(PlannedRun(run.number, run.varied, run.fixed, run_hash(scene, contents)))
        advance(run.number, len(bare))
    faults = blame.faults()
    # Without a single sound scene nothing is known about what can be listed.
    scalars: tuple[str, ...] = ()
    expected: tuple[str, ...] = ()
    if runs:
        columns = _Columns(loaded, tuple(measured), tuple(judged))
        scalars, unknown = columns.scalars()
        expected, unlisted = columns.expected(scalars)
        faults += [*unknown, *unlisted]
    if faults:
        raise InputError(sort_faults(faults))
    return Plan(loaded, tuple(varied_keys(loaded.study.sweep)), tuple(runs), scalars, expected)


def check_runs(plan: Plan, runs: Sequence[PlannedRun], advance: Advance) -> None:
    """Check scenes with their meshes, as `femdeform check` does.

    Parameters
    ----------
    plan : Plan
        The study's runs.
    runs : sequence of PlannedRun
        Those of them that are to be checked.
    advance : callable
        Called with the number of runs checked so far, and the number of all.

    Raises
    ------
    InputError
        With every fault, as from `plan_runs`.
    """
    blame = _Blame(plan.study, len(runs))
    surveys = _Surveys()
    for count, run in enumerate(runs, start=1):
        loaded = load_scene(plan.study.scene_path, run.overrides)
        survey = surveys.of(loaded)
        blame.add(run, [*survey.faults, *check_loaded(loaded, survey.meshes, survey.coarse)])
        advance(count, len(runs))
    faults = blame.faults()
    if faults:
        raise InputError(faults)


def run_hash(loaded: LoadedScene, contents: Callable[[Path], str]) -> str:
    """SHA-256 of a scene's data and of the contents of the mesh files that it names.

    Parameters
    ----------
    loaded : LoadedScene
        The scene after the overrides.
    contents : callable
        Hash of a file's contents.
    """
    meshes = {
        name: contents(loaded.base_dir / source.file)
        for name, (_, source) in loaded.scene.mesh_sources().items()
        if isinstance(source, FileMesh)
    }
    return scene_hash([loaded.hash, meshes])


class _FileHashes:
    """Hashes of files, each read once; that of an unreadable file is empty, the check of its scene says why."""

    def __init__(self) -> None:
        self._known: dict[Path, str] = {}

    def __call__(self, path: Path) -> str:
        if path not in self._known:
            try:
                with path.open("rb") as stream:
                    self._known[path] = hashlib.file_digest(stream, "sha256").hexdigest()
            except (OSError, ValueError):
                self._known[path] = ""
        return self._known[path]


class _Surveys:
    """Meshes for checks; scenes that differ in other things only share them."""

    def __init__(self) -> None:
        self._key = ""
        self._survey: MeshSurvey | None = None

    def of(self, loaded: LoadedScene) -> MeshSurvey:
        scene = loaded.scene
        # Selections by place decide how fine a mesh the check needs.
        key = repr((scene.mesh_sources(), getattr(scene, "conditions", None), scene.measure, scene.expect))
        if self._survey is None or key != self._key:
            survey = survey_meshes(loaded)
            # Faults carry the places of this scene, not of the next one.
            self._key, self._survey = key, None if survey.faults else survey
            return survey
        return self._survey


class _Blame:
    """Collects the faults of many scenes, and finds out which line of the study each comes from."""

    def __init__(self, study: LoadedStudy, n_runs: int) -> None:
        self._study = study
        self._n_runs = n_runs
        self._found: dict[tuple[Fault, KeyPath], list[PlannedRun]] = {}

    def add(self, run: PlannedRun, faults: Iterable[Fault]) -> None:
        """Note the faults of one run's scene."""
        places: dict[str, KeyPath] = {}
        for choice in run.choices:
            override, _ = parse_override(choice.override)
            if override is not None:
                places.setdefault(override.source, choice.place)
        for fault in dict.fromkeys(faults):
            place = places.get(fault.file, ())
            if place:
                fault = self._study.fault(place, fault.message) if not fault.key else self._at(place, fault)
            self._found.setdefault((fault, place), []).append(run)

    def _at(self, place: KeyPath, fault: Fault) -> Fault:
        found = self._study.fault(place, fault.message)
        return Fault(found.file, found.line, fault.key, fault.message)

    def faults(self) -> list[Fault]:
        """All faults, each once; those of a sample's values at their range, the first standing for all."""
        result: list[Fault] = []
        samples: dict[tuple[str, int, str], int] = {}
        for (fault, place), runs in self._found.items():
            message = fault.message
            if place[1:2] == ("latin_hypercube",):
                spot = (fault.file, fault.line, fault.key)
                samples[spot] = samples.get(spot, 0) + len(runs)
                if samples[spot] > len(runs):
                    continue
                message = f"{message} (a sample of its range)"
            elif not place and len(runs) < self._n_runs:
                # The scene alone is sound here: only with the values of these runs it is not.
                others = f" and {len(runs) - 1} more" if len(runs) > 1 else ""
                message = f"{message} (in run {runs[0].number}{others}: {runs[0].label})"
            result.append(Fault(fault.file, fault.line, fault.key, message))
        return sort_faults(result)


class _Columns:
    """Columns of the index that a study asks for, and what is wrong with what it asks for.

    Parameters
    ----------
    loaded : LoadedStudy
        The study.
    measured : sequence of str
        What its scenes measure.
    judged : sequence of str
        Names of what they expect over time: the computed numbers are those of the verdicts.
    """

    def __init__(self, loaded: LoadedStudy, measured: Sequence[str], judged: Sequence[str]) -> None:
        # Imported here: it brings the finite elements with it.
        from femdeform.run.quantities import STANDARD

        self._loaded = loaded
        self._quantities = [*(f"measure.{name}" for name in measured), *STANDARD]
        self._known = [*FACTS, *self._quantities, *judged]

    def _column(self, name: str) -> str:
        plain = name.removeprefix("quantities.")
        return plain if plain in self._known else f"measure.{plain}"

    def scalars(self) -> tuple[tuple[str, ...], list[Fault]]:
        """Columns of `scalars`."""
        loaded = self._loaded
        if loaded.study.scalars is None:
            return (*self._quantities, *DEFAULT_FACTS), []
        columns: dict[str, None] = {}
        faults = []
        for index, name in enumerate(loaded.study.scalars):
            column = self._column(name)
            if column not in self._known:
                hint = did_you_mean(name.removeprefix("quantities."), self._known)
                faults.append(loaded.fault(("scalars", index), f"`{name}` is not a number of a result; {hint}"))
            elif column in columns:
                faults.append(loaded.fault(("scalars", index), f"`{name}` is listed twice"))
            columns[column] = None
        return tuple(columns), faults

    def expected(self, scalars: Sequence[str]) -> tuple[tuple[str, ...], list[Fault]]:
        """Columns that `expect` is about."""
        columns, faults = [], []
        for index, wanted in enumerate(self._loaded.study.expect):
            columns.append(self._column(wanted.scalar))
            if columns[-1] not in scalars:
                message = f"`{wanted.scalar}` is not one of `scalars`; {did_you_mean(wanted.scalar, scalars)}"
                faults.append(self._loaded.fault(("expect", index, "scalar"), message))
        return tuple(columns), faults
