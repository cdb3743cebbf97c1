"""Goes through the frames of a result for what their pictures share."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from femdeform.errors import InputError
from femdeform.post.bodies import survey_bodies
from femdeform.post.grids import survey_grid
from femdeform.post.particles import survey_particles
from femdeform.post.setting import Setting
from femdeform.run.result import Result

Progress = Callable[[], None]
_SURVEYS: dict[str, Callable[[Result, Iterable[int], str | None, Progress], Setting]] = {
    "deformable": survey_bodies,
    "incompressible_flow": survey_grid,
    "material_points": survey_particles,
}


def survey(result: Result, frames: Iterable[int], field: str | None, progress: Progress | None = None) -> Setting:
    """Go through frames for what they share.

    Parameters
    ----------
    result : Result
        The result.
    frames : iterable of int
        Positions in ``result.frames``; at least one.
    field : str, optional
        Field to colour by; default: that of the kind of simulation.
    progress : callable, optional
        Called after each frame.

    Returns
    -------
    Setting
        Of the kind of the frames; it knows what draws them.

    Raises
    ------
    InputError
        If a frame cannot be read, has no such field, or has nothing to show.
    """
    if result.simulation not in _SURVEYS:
        raise InputError(f"{result.folder}: nothing is known of pictures of a simulation {result.simulation!r}")
    if not result.frames:
        raise InputError(f"{result.folder}: there are no frames in this result")
    return _SURVEYS[result.simulation](result, frames, field, progress or _nothing)


def _nothing() -> None:
    return
