"""What a case will compute: its studies, taken apart into levels, each a scene with everything that belongs to it.

Made by `verification.case`; nothing here computes anything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from femdeform.errors import Fault, InputError
from femdeform.scene.key_path import KeyPath
from femdeform.scene.load import LoadedScene, Source
from verification.expressions import VectorField
from verification.study_schema import Band, Quantity

if TYPE_CHECKING:
    from femdeform.run.compare import Plan
    from femdeform.run.compare_variants import Prepared

Integrator = Literal["backward_euler", "trapezoidal"]
NORMS = ("l2", "h1")


@dataclass(frozen=True)
class FieldSet:
    """The fields of a study, ready to be evaluated.

    Attributes
    ----------
    displacement, initial_velocity, move_mesh : VectorField or None
    manufactured : bool
        The displacement is kept in equilibrium by body forces and tractions.
    source : Source
        Lines of the study file.
    path : KeyPath
        Where the fields are in it.
    """

    source: Source
    path: KeyPath
    displacement: VectorField | None = None
    initial_velocity: VectorField | None = None
    move_mesh: VectorField | None = None
    manufactured: bool = False

    def fault(self, name: str, message: str) -> Fault:
        """Return a fault at one of the fields."""
        return self.source.fault((*self.path, name), message)

    def error(self, name: str, message: str) -> InputError:
        """Return the error for one of the fields."""
        return InputError([self.fault(name, message)])


@dataclass(frozen=True)
class Problem:
    """One run: a scene and what the scene cannot say."""

    loaded: LoadedScene
    fields: FieldSet
    integrator: Integrator


@dataclass(frozen=True)
class Target:
    """What a quantity is compared with: a number, a finer run or another level; all None for an exact field."""

    value: float | None = None
    run: Problem | None = None
    level: Literal["first", "last", "previous"] | None = None


@dataclass(frozen=True)
class MeasuredQuantity:
    """A quantity of a study.

    Attributes
    ----------
    name : str
        As in the study file.
    function, measure : str
        What to make of the history of which measured quantity; of a norm ``("", "")``.
    spec : Quantity
    path : KeyPath
        Where it is in the study file.
    """

    name: str
    function: str
    measure: str
    spec: Quantity
    path: KeyPath

    @property
    def is_norm(self) -> bool:
        """Whether it is a norm of the displacement's error."""
        return self.name in NORMS

    def band(self, full: bool) -> Band:
        """Bands of the full or the quick run."""
        return self.spec if full or self.spec.coarse is None else self.spec.coarse


@dataclass(frozen=True)
class Level:
    """One run of a study and what its quantities are compared with.

    Attributes
    ----------
    label : str
    size : float
        Element size, time step or value of the parameter; NaN where there is none.
    problem : Problem
    targets : dict of str to Target
        By quantity; a quantity that is only reported may have none.
    """

    label: str
    size: float
    problem: Problem
    targets: Mapping[str, Target] = field(default_factory=dict)


@dataclass(frozen=True)
class StudyPlan:
    """A study of runs.

    Attributes
    ----------
    name : str
        ``study`` or ``study/variation``.
    kind, about : str
    axis : str
        What `Level.size` is, with its unit.
    levels : sequence of Level
    n_quick : int
        How many of them the quick run computes; 0 leaves the study out.
    quantities : sequence of MeasuredQuantity
    """

    name: str
    kind: str
    about: str
    axis: str
    levels: Sequence[Level]
    n_quick: int
    quantities: Sequence[MeasuredQuantity]

    @property
    def is_refinement(self) -> bool:
        """Whether the levels approach a limit, so that the finest is the one to be judged."""
        return self.kind in ("mesh_refinement", "time_step_refinement")

    def chosen(self, full: bool) -> Sequence[Level]:
        """Levels of the full or the quick run."""
        return self.levels if full else self.levels[: self.n_quick]


@dataclass(frozen=True)
class IterationPlan:
    """A study of single iterations.

    Attributes
    ----------
    name, about : str
    prepared : Prepared
        The scene and the variants that are compared on it.
    budget : Plan
        Iterations and steps of each.
    quantities : dict of str to dict of str to Quantity
        What is asked of each variant, by its label.
    full_only : bool
        The quick run leaves the study out.
    """

    name: str
    about: str
    prepared: Prepared
    budget: Plan
    quantities: Mapping[str, Mapping[str, Quantity]]
    full_only: bool
    kind: str = "iteration_sweep"


@dataclass(frozen=True)
class CasePlan:
    """A case.

    Attributes
    ----------
    name : str
        Name of its folder.
    folder : Path
    title : str
    readme : str
        Text of its README.md; empty if there is none.
    studies : sequence of StudyPlan or IterationPlan
    """

    name: str
    folder: Path
    title: str
    readme: str
    studies: Sequence[StudyPlan | IterationPlan]

    def chosen(self, full: bool) -> list[StudyPlan | IterationPlan]:
        """Studies of the full or the quick run."""
        return [study for study in self.studies if full or not _is_left_out(study)]

    def n_runs(self, full: bool) -> int:
        """Number of runs, for progress."""
        counts = []
        for study in self.chosen(full):
            if isinstance(study, IterationPlan):
                counts.append(1)
            else:
                levels = study.chosen(full)
                runs = {id(t.run) for level in levels for t in level.targets.values() if t.run is not None}
                counts.append(len(levels) + len(runs))
        return int(np.sum(counts, dtype=int))


def _is_left_out(study: StudyPlan | IterationPlan) -> bool:
    return study.full_only if isinstance(study, IterationPlan) else study.n_quick == 0
