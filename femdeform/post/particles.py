"""Pictures of particles: discs in the plane, balls in space, as large as the particles are apart at first."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import InputError
from femdeform.post.canvas import Canvas
from femdeform.post.fields import Field, default_field, select_field, value_range
from femdeform.post.setting import Setting, around, bounds, resolved_or_empty, whole_range
from femdeform.run.frames import ParticleFrame, of_kind
from femdeform.run.result import Result
from femdeform.types import FloatArray

_PHASES = ["solid", "liquid"]
# Particles that are looked at to find how far apart they are.
_SAMPLE = 4000
# Diameters over distances: so large that there are no gaps in a lattice.
_OVERLAP = {2: 1.42, 3: 1.3}
# A sprite with a soft rim; what VTK has by default fades out from its middle.
_DISC = """//VTK::Color::Impl
float r2 = dot(offsetVCVSOutput.xy, offsetVCVSOutput.xy);
if (r2 > 1.0) { discard; }
"""
_BALL = (
    _DISC
    + """float height = sqrt(1.0 - r2);
float lit = 0.38 + 0.62 * max(0.0, dot(normalize(vec3(-0.35, 0.55, 0.75)), vec3(offsetVCVSOutput.xy, height)));
ambientColor *= lit; diffuseColor *= lit;
"""
)


@dataclass(frozen=True)
class ParticleSetting(Setting):
    """What the pictures of particles share; `box` is around all of them in every frame.

    Attributes
    ----------
    field : str
        Field to colour by.
    radius : float
        Of a particle as it is drawn [m].
    """

    field: str
    radius: float

    def drawing(self, canvas: Canvas, field: str | None) -> ParticleDrawing:
        """What draws the particles."""
        return ParticleDrawing(canvas, self)


def survey_particles(
    result: Result, frames: Iterable[int], field: str | None, progress: Callable[[], None]
) -> ParticleSetting:
    """Go through frames of particles for what they share; see `femdeform.post.survey.survey`."""
    name = field or default_field(_read(result, len(result.frames) - 1))
    corners, ranges = [], []
    dim = 0
    for index in frames:
        frame = _read(result, index)
        if not np.all(np.isfinite(frame.positions)):
            raise InputError(f"{result.frames[index].path}: the positions are not finite")
        dim = dim or _dimension(result, frame)
        if len(frame.positions):
            corners.append(bounds(frame.positions))
        selected = select_field(frame, name, result.folder)
        ranges.append(value_range(selected.values))
        if selected.is_norm:
            ranges.append((0.0, 0.0))
        progress()
    if not corners:
        raise InputError(f"{result.folder}: there is nothing to show, the frames have no particles")
    box = around(corners)
    first = next(f for f in (_read(result, i) for i in range(len(result.frames))) if len(f.positions))
    size = float(np.linalg.norm(box[1] - box[0]))
    radius = 0.5 * _OVERLAP[dim] * (spacing(first.positions, dim) or 0.02 * size or 1.0)
    margin = radius * (np.arange(3) < dim)
    return ParticleSetting(np.stack([box[0] - margin, box[1] + margin]), whole_range(ranges), dim, name, radius)


def spacing(positions: FloatArray, dim: int) -> float:
    """How far particles (n, 3) are apart [m]: the middle one of the mean distances to their closest 2 dim others.

    In a lattice that is its side. Zero for a single particle.
    """
    from scipy.spatial import KDTree

    n_neighbours = min(2 * dim, len(positions) - 1)
    if n_neighbours < 1:
        return 0.0
    chosen = positions[:: max(1, len(positions) // _SAMPLE)]
    distances, _ = KDTree(positions).query(chosen, k=n_neighbours + 1)
    return float(np.median(distances[:, 1:].mean(axis=1)))


class ParticleDrawing:
    """Draws particles; see `femdeform.post.setting.Drawing`.

    Parameters
    ----------
    canvas : Canvas
        Where to.
    setting : ParticleSetting
        What the frames share.
    """

    def __init__(self, canvas: Canvas, setting: ParticleSetting) -> None:
        self._canvas = canvas
        self._setting = setting
        self._is_set = False

    def show(self, index: int) -> ParticleFrame:
        """Show a frame."""
        frame = _read(self._canvas.result, index)
        field = select_field(frame, self._setting.field, self._canvas.result.folder)
        self._canvas.plotter.remove_actor("particles", render=False)
        if len(frame.positions):
            self._add(frame, field)
        if not self._is_set:
            self._is_set = True
            if field.categorical:
                names = self._canvas.result.facts.get("bodies") if field.label == "body" else _PHASES
                # A movie may begin without some of them.
                numbers = range(max(len(names) if isinstance(names, list) else 0, int(self._setting.colours[1]) + 1))
                self._canvas.add_legend(numbers, field.label, names)
            self._canvas.annotate()
            self._canvas.aim()
        return frame

    def finish(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """All is drawn."""
        return picture

    def _add(self, frame: ParticleFrame, field: Field) -> None:
        """Put the particles of a frame on the canvas; there may be more or fewer than before."""
        canvas, setting = self._canvas, self._setting
        cloud = canvas.pyvista.PolyData(frame.positions)
        cloud.point_data["field"] = field.values
        if field.categorical:
            options = canvas.category_options(int(setting.colours[1]) + 1)
        else:
            colours = "inferno" if setting.field == "temperature" else "viridis"
            options = canvas.scale_options(field.label, setting.colours, colours)
        actor = canvas.plotter.add_mesh(
            cloud,
            name="particles",
            scalars="field",
            style="points_gaussian",
            emissive=False,
            lighting=False,
            reset_camera=False,
            **options,
        )
        actor.mapper.SetScaleFactor(setting.radius)
        # What is drawn for each particle is no larger than it has to be; older VTK has another name for it.
        getattr(actor.mapper, "SetBoundScale", lambda factor: None)(1.0)
        actor.mapper.SetSplatShaderCode(_DISC if setting.dim == 2 else _BALL)


def _read(result: Result, index: int) -> ParticleFrame:
    return of_kind(result.read_frame(index), ParticleFrame, result.frames[index].path)


def _dimension(result: Result, frame: ParticleFrame) -> int:
    """2 where all lies in the plane and the scene does not say that it is one in space."""
    gravity: Any = resolved_or_empty(result).get("gravity")
    if isinstance(gravity, list) and len(gravity) in (2, 3):
        return len(gravity)
    return 3 if np.any(frame.positions[:, 2]) else 2
