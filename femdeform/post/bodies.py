"""Pictures of deformable bodies: in colour, their reference shape in outline, links."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import InputError
from femdeform.post.canvas import Canvas
from femdeform.post.fields import Field, select_field, value_range
from femdeform.post.links import link_segments, places_in_space
from femdeform.post.setting import Setting, around, bounds, resolved_or_empty, whole_range
from femdeform.post.skin import DrawnFrames
from femdeform.post.surface import Part, Surface, extract_surface, vertex_normals
from femdeform.run.frames import BodyFrame
from femdeform.run.result import Result
from femdeform.types import FloatArray

MAX_FACES_WITH_EDGES = 50_000

_MARKED, _UNMARKED = "#d01818", "#c4ccd6"
_OUTLINE = "#a8a8a8"
_LINK = "#444444"


@dataclass(frozen=True)
class BodySetting(Setting):
    """What the pictures of deformable bodies share; `box` holds every frame and the reference shape.

    Attributes
    ----------
    surface : Surface
        Visible part of the mesh.
    """

    surface: Surface

    def drawing(self, canvas: Canvas, field: str | None) -> BodyDrawing:
        """What draws the bodies."""
        return BodyDrawing(canvas, self, field)


def survey_bodies(
    result: Result, frames: Iterable[int], field: str | None, progress: Callable[[], None]
) -> BodySetting:
    """Go through frames of bodies for what they share; see `femdeform.post.survey.survey`."""
    surface: Surface | None = None
    corners: list[FloatArray] = []
    ranges: list[tuple[float, float]] = []
    drawn = DrawnFrames(result)
    for index in frames:
        frame = drawn.read(index)
        if surface is None:
            surface = extract_surface(frame.points, frame.blocks)
            if not len(surface.nodes):
                raise InputError(f"{result.folder}: there is nothing to show, the frames have no cells")
            corners.append(bounds(frame.points[surface.nodes]))
        corners.append(bounds(frame.positions[surface.nodes]))
        if not np.all(np.isfinite(corners[-1])):
            raise InputError(f"{result.frames[index].path}: the displacements are not finite")
        selected = select_field(frame, field, result.folder)
        ranges.append(value_range(_visible_values(selected, surface)))
        if selected.is_norm:
            ranges.append((0.0, 0.0))
        progress()
    if surface is None:
        raise InputError(f"{result.folder}: there are no frames in this result")
    box = around(corners)
    gravity = resolved_or_empty(result).get("gravity")
    flat = box[1, 2] == box[0, 2] and not (isinstance(gravity, list) and len(gravity) == 3)
    return BodySetting(box, whole_range(ranges), 2 if flat else 3, surface)


class BodyDrawing:
    """Draws deformable bodies; see `femdeform.post.setting.Drawing`.

    Parameters
    ----------
    canvas : Canvas
        Where to.
    setting : BodySetting
        What the frames share.
    field : str, optional
        Field to colour by.
    """

    def __init__(self, canvas: Canvas, setting: BodySetting, field: str | None) -> None:
        self._canvas = canvas
        self._setting = setting
        self._field = field
        self._drawn = DrawnFrames(canvas.result)
        self._meshes: list[tuple[Any, Part, bool]] = []  # mesh, its nodes, whether it carries the colours
        self._lines = link_segments(canvas.result.facts.get("link_lines"))

    def show(self, index: int) -> BodyFrame:
        """Show a frame."""
        frame = self._drawn.read(index)
        field = select_field(frame, self._field, self._canvas.result.folder)
        if not self._meshes:
            self._build(frame, field)
        for mesh, part, coloured in self._meshes:
            mesh.points = frame.positions[part.nodes]
            if coloured:
                self._colour(mesh, part, field)
        self._show_links(frame)
        if field.is_mark:
            self._show_marks(frame, field)
        return frame

    def finish(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """All is drawn."""
        return picture

    def _build(self, frame: BodyFrame, field: Field) -> None:
        surface = self._setting.surface
        faces = self._mesh(frame, surface.faces, with_faces=True)
        lines = self._mesh(frame, surface.lines, with_faces=False)
        options = self._colour_options(field)
        thick = 5.0 * self._canvas.scale
        for mesh, part in ((faces, surface.faces), (lines, surface.lines)):
            if not len(part.cells):
                continue
            self._colour(mesh, part, field)
            actor = self._canvas.plotter.add_mesh(
                mesh,
                scalars="field",
                lighting=self._setting.dim == 3,
                render_lines_as_tubes=part is surface.lines,
                line_width=thick,
                ambient=0.25,
                diffuse=0.8,
                specular=0.12,
                specular_power=20,
                **options,
            )
            if part is surface.faces:
                # Pushes the faces back in depth, so that the element edges on them are not half hidden.
                actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
                actor.mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(1.0, 2.0)
                if self._setting.dim == 3:
                    actor.prop.interpolation = "Phong"
            options = {**options, "show_scalar_bar": False}
        if 0 < surface.n_faces < MAX_FACES_WITH_EDGES:
            edges = self._mesh(frame, surface.edges, with_faces=False)
            self._canvas.plotter.add_mesh(
                edges, color="#101820", opacity=0.28, line_width=1.0 * self._canvas.scale, lighting=False
            )
            self._meshes.append((edges, surface.edges, False))
        self._add_reference(frame)
        if field.categorical:
            names = self._canvas.result.facts.get("bodies" if field.label == "body" else "regions")
            self._canvas.add_legend(np.unique(field.values).astype(int).tolist(), field.label, names)
        self._canvas.annotate()
        self._canvas.aim(places_in_space(self._canvas.result.facts.get("link_lines")))

    def _show_marks(self, frame: BodyFrame, field: Field) -> None:
        """Marked nodes as dots in a surface that is drawn as glass."""
        nodes = np.unique(self._setting.surface.faces.nodes)
        dots = frame.positions[nodes[field.values[nodes] > 0.0]]
        self._canvas.plotter.remove_actor("marks", render=False)
        if len(dots):
            self._canvas.plotter.add_mesh(
                self._canvas.pyvista.PolyData(dots),
                name="marks",
                color=_MARKED,
                lighting=False,
                render_points_as_spheres=True,
                point_size=8.0 * self._canvas.scale,
                reset_camera=False,
            )

    def _mesh(self, frame: BodyFrame, part: Part, *, with_faces: bool) -> Any:
        mesh = self._canvas.pyvista.PolyData(frame.positions[part.nodes])
        if with_faces:
            mesh = self._canvas.pyvista.PolyData.from_regular_faces(frame.positions[part.nodes], part.cells)
        elif len(part.cells):
            mesh.verts = np.zeros(0, dtype=np.int64)
            mesh.lines = np.insert(part.cells, 0, 2, axis=1).ravel()
        if with_faces or part is self._setting.surface.lines:
            self._meshes.append((mesh, part, True))
        return mesh

    def _colour(self, mesh: Any, part: Part, field: Field) -> None:
        surface = self._setting.surface
        if not len(part.cells):
            return
        if field.on_cells:
            owners = surface.face_cells if part is surface.faces else surface.line_cells
            mesh.cell_data["field"] = field.values[owners]
        else:
            mesh.point_data["field"] = field.values[part.nodes]
        if part is surface.faces:
            mesh.point_data.active_normals = vertex_normals(np.asarray(mesh.points, np.float64), part.cells)

    def _colour_options(self, field: Field) -> dict[str, Any]:
        preference = {"preference": "cell" if field.on_cells else "point"}
        if field.categorical:
            return self._canvas.category_options(int(self._setting.colours[1]) + 1) | preference
        if field.is_mark:
            return {"cmap": [_UNMARKED], "clim": (0.0, 1.0), "show_scalar_bar": False, "opacity": 0.35}
        return self._canvas.scale_options(field.label, self._setting.colours) | preference

    def _add_reference(self, frame: BodyFrame) -> None:
        surface, width = self._setting.surface, 1.6 * self._canvas.scale
        for part in (surface.outline, surface.lines):
            if len(part.cells):
                mesh = self._canvas.pyvista.PolyData(frame.points[part.nodes])
                mesh.verts = np.zeros(0, dtype=np.int64)
                mesh.lines = np.insert(part.cells, 0, 2, axis=1).ravel()
                self._canvas.plotter.add_mesh(mesh, color=_OUTLINE, line_width=width, lighting=False)
        if self._setting.dim == 3 and surface.n_faces:
            # Round bodies have no sharp edges: what outlines them depends on where one looks from.
            shape = self._canvas.pyvista.PolyData.from_regular_faces(
                frame.points[surface.faces.nodes], surface.faces.cells
            )
            self._canvas.plotter.add_silhouette(shape.clean(), color=_OUTLINE, line_width=width)

    def _show_links(self, frame: BodyFrame) -> None:
        segments = [segment(frame.positions, frame.time) for segment in self._lines]
        for number, ends in enumerate(segments):
            self._canvas.plotter.add_mesh(
                self._canvas.pyvista.Line(*ends),
                name=f"link {number}",
                color=_LINK,
                line_width=2.5 * self._canvas.scale,
                reset_camera=False,
            )


def _visible_values(field: Field, surface: Surface) -> FloatArray:
    if field.on_cells:
        return field.values.take(np.concatenate([surface.face_cells, surface.line_cells]))
    return field.values.take(surface.nodes)
