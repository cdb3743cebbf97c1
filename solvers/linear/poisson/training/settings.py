"""What a training run is told."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

Kind = Literal["dcdm", "spd_lmg"]


@dataclass(frozen=True)
class TrainingSettings:
    """A training run.

    Attributes
    ----------
    kind : str
        ``dcdm`` or ``spd_lmg``.
    out : Path
        Folder.
    dim, cells : int
        Of the grids that it learns on: `cells` along each axis.
    steps : int
        Optimiser's steps.
    batch : int
        Samples a step.
    rate : float
        Learning rate, that of the first step.
    seed : int
    minutes : float or None
        After which it ends, with what it has.
    device : str
        ``cpu`` or ``cuda``.
    route : str
        DCDM only: ``on_policy`` or ``ritz``, the source's.
    model : str
        DCDM only: a key of `MODELS`.
    lanczos : int
        Steps of Lanczos on the route of Ritz vectors.
    samples : int
        Right-hand sides on that route.
    start : Path or None
        Weights to start from; None for random ones.
    precision : str
        DCDM only: of the network while it is trained, ``float32`` or ``bfloat16``. Parameters stay in the former.
    hard : float or None
        Part of the domains with solids that are porous or have thin plates; None for a tenth (DCDM) or three tenths.
    validations : int
        After as many equal parts of the steps, each with a checkpoint; there is one at the start too.
    """

    kind: Kind
    out: Path
    dim: int = 2
    cells: int = 64
    steps: int = 2000
    batch: int = 8
    rate: float = 2e-3
    seed: int = 0
    minutes: float | None = None
    device: str = "cpu"
    route: Literal["on_policy", "ritz"] = "on_policy"
    model: str = "masks"
    lanczos: int = 1000
    samples: int = 20000
    start: Path | None = None
    precision: Literal["float32", "bfloat16"] = "float32"
    hard: float | None = None
    validations: int = 8

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the grid."""
        return (self.cells,) * self.dim

    @property
    def hard_part(self) -> float:
        """Part of the domains with solids that are hard."""
        if self.hard is not None:
            return self.hard
        return {"dcdm": 0.1, "spd_lmg": 0.3}[self.kind]

    def facts(self) -> dict[str, Any]:
        """For files that say how weights came about: all but the folder."""
        facts = asdict(self) | {"start": None if self.start is None else str(self.start)}
        del facts["out"]
        return facts


# Options of the network, by the word of `--model`.
MODELS: dict[str, dict[str, Any]] = {
    "source-64": {},
    "source-128": {"left": 2, "low": 5, "up": 3},
    "no-bias": {"bias": False},
    "masks": {"bias": False, "masks": True},
    "no-residual": {"residual": False},
    "no-pooling": {"pooled": False, "residual": False},
    "no-skip": {"skip": False},
    "narrow": {"channels": 8},
}
