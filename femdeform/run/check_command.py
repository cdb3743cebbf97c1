"""`femdeform check`: scenes, comparison files and study files, each told by its keys."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from femdeform.errors import Fault, InputError
from femdeform.scene.checks import check_file
from femdeform.scene.document import read_document


def faults_of(path: Path, overrides: Sequence[str] = (), notices: list[str] | None = None) -> list[Fault]:
    """Everything wrong with a file that `femdeform run`, `compare` or `batch` is given.

    Of a comparison and of a study, all scenes that they lead to are checked, with their meshes.

    Parameters
    ----------
    path : Path
        The YAML file.
    overrides : sequence of str
        Each ``key=value``, for the scene or for all variants of a comparison.
    notices : list of str, optional
        Gets a line for all that is odd about a scene without being wrong.
    """
    try:
        data = read_document(path, "scene, comparison or study").data
        keys = set(data) if isinstance(data, dict) else set()
        if "variants" in keys:
            _check_comparison(path, overrides)
        elif "sweep" in keys:
            _check_study(path, overrides)
        elif "studies" in keys:
            raise InputError([Fault(str(path), 0, "", "is a verification study: `femdeform verify` checks it")])
        else:
            return check_file(path, overrides, notices)
    except InputError as error:
        return list(error.faults)
    return []


def _check_comparison(path: Path, overrides: Sequence[str]) -> None:
    # Imported here, as below: a check of scenes needs no finite elements.
    from femdeform.run.compare import Plan
    from femdeform.run.compare_variants import Variant, prepare
    from femdeform.scene.comparison_schema import load_comparison

    loaded = load_comparison(path)
    variants = [Variant(label, options) for label, options in loaded.variants()]
    prepared = prepare(loaded.scene_path, variants, [*loaded.overrides, *overrides])
    file = loaded.file
    plan = Plan(
        steps=file.steps,
        start_step=file.start_step,
        repeat=file.repeat,
        iterations=file.iterations,
        seconds=file.seconds,
    )
    plan.check(prepared.base.deformable)


def _check_study(path: Path, overrides: Sequence[str]) -> None:
    from femdeform.run.batch_scenes import check_runs, plan_runs
    from femdeform.scene.batch_schema import load_study

    if overrides:
        raise InputError([Fault("--set", 0, "", f"is not for {path}, a study, which has a `set` of its own")])
    plan = plan_runs(load_study(path), _unseen)
    check_runs(plan, list(plan.distinct.values()), _unseen)


def _unseen(done: int, total: int) -> None:
    """A check of files shows no progress."""
