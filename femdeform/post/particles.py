"""Pictures of particles: discs in the plane, balls in space, as large as the particles are apart at first."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from femdeform.errors import InputError
from femdeform.post.canvas import Canvas
from femdeform.post.fields import Field, default_field, select_field, value_range
from femdeform.post.setting import Setting, around, bounds, whole_range
from femdeform.run.frames import ParticleFrame, of_kind
from femdeform.run.result import Result
from femdeform.types import FloatArray

_PHASES = ["solid", "liquid"]
# Particles that are looked at to find how far apart they are.
_SAMPLE = 4000
# Diameters over distances: so large that there are no gaps in a lattice.
_OVERLAP = {2: 1.5, 3: 1.3}
# Sprites with a sharp rim; what VTK has by default fades out from its middle.
_DISC = """//VTK::Color::Impl
float r2 = dot(offsetVCVSOutput.xy, offsetVCVSOutput.xy);
if (r2 > 1.0) { discard; }
"""
# Where the light comes from: to the right, up and to the eye.
_LIGHT = np.array([-0.35, 0.55, 0.75]) / np.linalg.norm([-0.35, 0.55, 0.75])
# Each ball is lit a little, and more so the whole that they make up.
_BALL = (
    _DISC
    + f"""float lit = 0.8 + 0.2 * max(0.0, dot(vec3({", ".join(map(str, _LIGHT))}),
                                         vec3(offsetVCVSOutput.xy, sqrt(1.0 - r2))));
ambientColor *= lit; diffuseColor *= lit;
"""
)
_DARKEST = 0.5
_MAX_BINS = 160  # along a side of the box, to find which way the surface of the whole looks


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
    """How far particles (n, 3) are apart [m]: a low one of the mean distances to their closest 2 dim others.

    In a lattice that is its side: those on its rim, which lack neighbours, are further from others. Zero for a single
    particle.
    """
    from scipy.spatial import KDTree

    n_neighbours = min(2 * dim, len(positions) - 1)
    if n_neighbours < 1:
        return 0.0
    chosen = positions[:: max(1, len(positions) // _SAMPLE)]
    distances, _ = KDTree(positions).query(chosen, k=n_neighbours + 1)
    return float(np.quantile(distances[:, 1:].mean(axis=1), 0.3))


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
        self._table: Any = None

    def show(self, index: int) -> ParticleFrame:
        """Show a frame."""
        frame = _read(self._canvas.result, index)
        field = select_field(frame, self._setting.field, self._canvas.result.folder)
        if self._table is None:
            self._add_scale(field)
            self._canvas.annotate()
            self._canvas.aim()
        if len(frame.positions):
            self._add(frame, field)
        else:
            self._canvas.plotter.remove_actor("particles", render=False)
        return frame

    def finish(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """All is drawn."""
        return picture

    def _add_scale(self, field: Field) -> None:
        """The colours, and the bar or legend that explains them."""
        canvas, setting = self._canvas, self._setting
        if field.categorical:
            names = canvas.result.facts.get("bodies") if field.label == "body" else _PHASES
            # A movie may begin without some of them.
            n = max(len(names) if isinstance(names, list) else 0, int(setting.colours[1]) + 1)
            canvas.add_legend(range(n), field.label, names)
            options = canvas.category_options(n)
        else:
            colours = "plasma" if setting.field == "temperature" else "viridis"
            options = canvas.scale_options(field.label, setting.colours, colours)
        # The balls have colours and shades of their own; a point that nobody sees has the bar.
        point = canvas.pyvista.PolyData(setting.box.mean(axis=0)[None])
        point.point_data["field"] = np.zeros(1)
        actor = canvas.plotter.add_mesh(point, scalars="field", **options)
        actor.visibility = False
        self._table = actor.mapper.lookup_table

    def _add(self, frame: ParticleFrame, field: Field) -> None:
        """Put the particles of a frame on the canvas; there may be more or fewer than before."""
        canvas, setting = self._canvas, self._setting
        cloud = canvas.pyvista.PolyData(frame.positions)
        colours = _mapped(self._table, field.values)
        if setting.dim == 3:
            colours = colours * self._shades(frame)[:, None]
        cloud.point_data["colours"] = np.rint(colours).astype(np.uint8)
        actor = canvas.plotter.add_mesh(
            cloud,
            name="particles",
            scalars="colours",
            rgb=True,
            style="points_gaussian",
            emissive=False,
            lighting=False,
            reset_camera=False,
        )
        # VTK takes sprites for translucent, and draws those behind over those in front.
        actor.ForceOpaqueOn()
        actor.mapper.SetScaleFactor(setting.radius)
        # What is drawn for each particle is no larger than it has to be; older VTK has another name for it.
        getattr(actor.mapper, "SetBoundScale", lambda factor: None)(1.0)
        actor.mapper.SetSplatShaderCode(_DISC if setting.dim == 2 else _BALL)

    def _shades(self, frame: ParticleFrame) -> FloatArray:
        """How bright each particle is, (n,), as part of the surface of the whole."""
        camera = self._canvas.plotter.camera
        back = np.array(camera.position) - np.array(camera.focal_point)
        back /= np.linalg.norm(back)
        right = np.cross(np.array(camera.up), back)
        right /= np.linalg.norm(right)
        light = _LIGHT @ np.stack([right, np.cross(back, right), back])
        facing = outward(frame.positions, 2.0 * self._setting.radius) @ light
        return np.asarray(_DARKEST + (1.0 - _DARKEST) * np.clip(0.55 + 0.6 * facing, 0.0, 1.0))


def outward(positions: FloatArray, size: float) -> FloatArray:
    """Vectors (n, 3), no longer than one, out of a cloud of particles: unit ones on its surface, short ones inside.

    Parameters
    ----------
    positions : (n, 3) float64
        Particles [m].
    size : float
        Distance between them [m]; the cloud is looked at on twice this scale.
    """
    low, high = bounds(positions)
    side = max(2.0 * size, float((high - low).max()) / _MAX_BINS)
    place = (positions - low) / side + 2.0
    shape = tuple(((high - low) / side).astype(np.int64) + 5)
    counts = np.bincount(np.ravel_multi_index(tuple(place.astype(np.int64).T), shape), minlength=int(np.prod(shape)))
    filling = gaussian_filter(counts.reshape(shape).astype(np.float64), 1.0)
    slopes = np.stack([map_coordinates(slope, place.T - 0.5, order=1) for slope in np.gradient(filling)], axis=1)
    length = np.linalg.norm(slopes, axis=1)
    typical = float(np.quantile(length, 0.9))
    return np.asarray(-slopes / np.maximum(length, max(0.5 * typical, 1e-300))[:, None])


def _mapped(table: Any, values: FloatArray) -> FloatArray:
    """Colours (n, 3) from 0 to 255 of values."""
    entries = np.asarray(table.values, dtype=np.float64)[:, :3]
    low, high = table.scalar_range
    with np.errstate(invalid="ignore"):
        rows = (np.nan_to_num((values - low) / (high - low)) * len(entries)).astype(np.int64)
    return np.asarray(entries[np.clip(rows, 0, len(entries) - 1)])


def _read(result: Result, index: int) -> ParticleFrame:
    return of_kind(result.read_frame(index), ParticleFrame, result.frames[index].path)


def _dimension(result: Result, frame: ParticleFrame) -> int:
    """Dimension of space as the run tells it; else 2 where all lies in the plane."""
    told: Any = result.facts.get("dim")
    if told in (2, 3):
        return int(told)
    return 3 if np.any(frame.positions[:, 2]) else 2
