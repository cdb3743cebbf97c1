"""The picture of a result: deformed bodies in colour, their reference shape in outline, obstacles, legend,
time.

A `Stage` is set up once for all the frames it will show, so that neither the camera nor the colours jump;
showing a frame then only moves points.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.post.camera import VIEW_ANGLE, place_camera, vertical_axis
from femdeform.post.fields import Field, select_field
from femdeform.post.links import link_segments, places_in_space
from femdeform.post.obstacles import obstacle_shapes, solid_bounds
from femdeform.post.skin import DrawnFrames
from femdeform.post.surface import Part, vertex_normals
from femdeform.post.survey import Setting, resolved_or_empty
from femdeform.run.frames import BodyFrame
from femdeform.run.result import Result

MAX_FACES_WITH_EDGES = 50_000

_COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#ee9944", "#888888")
_MARKED, _UNMARKED = "#d01818", "#c4ccd6"
_OUTLINE = "#a8a8a8"
_OBSTACLE = "#8c9aa8"
_LINK = "#444444"
_TEXT = "#202020"
# Parts of the picture the bodies may fill; the rest is for the legend on the right and for title and time.
_FILL_WIDTH, _FILL_HEIGHT = 0.74, 0.76
_FILL_CENTER = (0.43, 0.485)
_FILL_BARE = 0.92


class Stage:
    """A plotter with everything on it that stays, ready to show frames.

    Parameters
    ----------
    pyvista : module
        PyVista, from `load_pyvista`.
    result : Result
        The result.
    setting : Setting
        From `survey`.
    field : str, optional
        Field to colour by.
    size : (int, int)
        Width and height [pixels].
    off_screen : bool
        Draw into memory, not into a window.
    bare : bool
        Only the bodies and obstacles: for pictures that share a legend with others.
    """

    def __init__(
        self,
        pyvista: Any,
        result: Result,
        setting: Setting,
        field: str | None,
        *,
        size: tuple[int, int],
        off_screen: bool = True,
        bare: bool = False,
    ) -> None:
        self.pyvista = pyvista
        self._result = result
        self._drawn = DrawnFrames(result)
        self._setting = setting
        self._field = field
        self._bare = bare
        self._scale = size[1] / 800.0
        self._meshes: list[tuple[Any, Part, bool]] = []  # mesh, its nodes, whether it carries the colours
        self._obstacles = [o for o in result.facts.get("obstacles") or [] if isinstance(o, dict)]
        self._lines = link_segments(result.facts.get("link_lines"))
        self.plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(size), lighting="light kit")
        self.plotter.set_background("white")
        self.plotter.enable_anti_aliasing("msaa", multi_samples=8)

    def show(self, index: int) -> BodyFrame:
        """Show a frame; the first call sets the stage.

        Parameters
        ----------
        index : int
            Position in ``result.frames``.

        Returns
        -------
        BodyFrame
            The frame shown.
        """
        frame = self._drawn.read(index)
        field = select_field(frame, self._field, self._result.folder)
        if not self._meshes:
            self._build(frame, field)
        for mesh, part, coloured in self._meshes:
            mesh.points = frame.positions[part.nodes]
            if coloured:
                self._colour(mesh, part, field)
        self._show_obstacles(frame.time)
        self._show_links(frame)
        if field.is_mark:
            self._show_marks(frame, field)
        if self._bare:
            # New text makes the plotter draw again; moved points alone do not.
            self.plotter.render()
            return frame
        text = f"t = {frame.time:.4g} s"
        self.plotter.add_text(
            text, name="time", position=(0.03, 0.035), viewport=True, font_size=self._font(13), color=_TEXT
        )
        return frame

    def picture(self) -> NDArray[np.uint8]:
        """The picture of the frame shown last, (height, width, 3)."""
        return np.asarray(self.plotter.screenshot(None, return_img=True), dtype=np.uint8)

    def close(self) -> None:
        """Free the plotter."""
        self.plotter.close()

    def _build(self, frame: BodyFrame, field: Field) -> None:
        surface = self._setting.surface
        faces = self._mesh(frame, surface.faces, with_faces=True)
        lines = self._mesh(frame, surface.lines, with_faces=False)
        options = self._colour_options(field)
        thick = 5.0 * self._scale
        for mesh, part in ((faces, surface.faces), (lines, surface.lines)):
            if not len(part.cells):
                continue
            self._colour(mesh, part, field)
            actor = self.plotter.add_mesh(
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
            self.plotter.add_mesh(edges, color="#101820", opacity=0.28, line_width=1.0 * self._scale, lighting=False)
            self._meshes.append((edges, surface.edges, False))
        self._add_reference(frame)
        if not self._bare:
            self._annotate(field)
        self._aim()

    def _show_marks(self, frame: BodyFrame, field: Field) -> None:
        """Marked nodes as dots in a surface that is drawn as glass."""
        nodes = np.unique(self._setting.surface.faces.nodes)
        dots = frame.positions[nodes[field.values[nodes] > 0.0]]
        self.plotter.remove_actor("marks", render=False)
        if len(dots):
            self.plotter.add_mesh(
                self.pyvista.PolyData(dots),
                name="marks",
                color=_MARKED,
                lighting=False,
                render_points_as_spheres=True,
                point_size=8.0 * self._scale,
                reset_camera=False,
            )

    def _annotate(self, field: Field) -> None:
        if field.categorical:
            self._add_legend(field)
        for bar in self.plotter.scalar_bars.values():
            bar.SetVerticalTitleSeparation(round(10 * self._scale))
        title = self._title()
        if title:
            self.plotter.add_text(title, position=(0.03, 0.93), viewport=True, font_size=self._font(16), color=_TEXT)
        self.plotter.add_axes(viewport=(0.84, 0.0, 1.0, 0.2), line_width=2, color=_TEXT)

    def _mesh(self, frame: BodyFrame, part: Part, *, with_faces: bool) -> Any:
        mesh = self.pyvista.PolyData(frame.positions[part.nodes])
        if with_faces:
            mesh = self.pyvista.PolyData.from_regular_faces(frame.positions[part.nodes], part.cells)
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
        low, high = self._setting.colours
        if field.categorical:
            n = int(high) + 1
            return {
                "cmap": [_COLOURS[i % len(_COLOURS)] for i in range(max(n, 2))],
                "clim": (-0.5, max(n, 2) - 0.5),
                "show_scalar_bar": False,
                "preference": "cell" if field.on_cells else "point",
            }
        if field.is_mark:
            return {"cmap": [_UNMARKED], "clim": (0.0, 1.0), "show_scalar_bar": False, "opacity": 0.35}
        if not high > low:
            # A field that is the same everywhere still needs a range to be drawn and labelled.
            low, high = low - 0.5 * max(abs(low), 1e-12), high + 0.5 * max(abs(high), 1e-12)
        bar = {
            "title": field.label,
            "vertical": True,
            "position_x": 0.865,
            "position_y": 0.24,
            "width": 0.065,
            "height": 0.58,
            "n_labels": 6,
            "fmt": self._number_format(low, high),
            "title_font_size": self._points(20),
            "label_font_size": self._points(18),
            "color": _TEXT,
        }
        return {
            "cmap": "viridis",
            "clim": (low, high),
            "scalar_bar_args": bar,
            "show_scalar_bar": not self._bare,
            "preference": "cell" if field.on_cells else "point",
        }

    def _add_reference(self, frame: BodyFrame) -> None:
        surface, width = self._setting.surface, 1.6 * self._scale
        for part in (surface.outline, surface.lines):
            if len(part.cells):
                mesh = self.pyvista.PolyData(frame.points[part.nodes])
                mesh.verts = np.zeros(0, dtype=np.int64)
                mesh.lines = np.insert(part.cells, 0, 2, axis=1).ravel()
                self.plotter.add_mesh(mesh, color=_OUTLINE, line_width=width, lighting=False)
        if self._setting.dim == 3 and surface.n_faces:
            # Round bodies have no sharp edges: what outlines them depends on where one looks from.
            shape = self.pyvista.PolyData.from_regular_faces(frame.points[surface.faces.nodes], surface.faces.cells)
            self.plotter.add_silhouette(shape.clean(), color=_OUTLINE, line_width=width)

    def _show_obstacles(self, time: float) -> None:
        if not self._obstacles:
            return
        shapes = obstacle_shapes(self.pyvista, self._obstacles, self._setting.box, self._setting.dim, time)
        for number, shape in enumerate(shapes):
            is_line = shape.n_lines > 0
            self.plotter.add_mesh(
                shape,
                name=f"obstacle {number}",
                color=_OBSTACLE,
                opacity=1.0 if is_line else 0.3,
                line_width=3.0 * self._scale,
                reset_camera=False,
            )

    def _show_links(self, frame: BodyFrame) -> None:
        segments = [segment(frame.positions, frame.time) for segment in self._lines]
        for number, ends in enumerate(segments):
            self.plotter.add_mesh(
                self.pyvista.Line(*ends),
                name=f"link {number}",
                color=_LINK,
                line_width=2.5 * self._scale,
                reset_camera=False,
            )

    def _add_legend(self, field: Field) -> None:
        names: Any = self._result.facts.get("bodies" if field.label == "body" else "regions")
        present = np.unique(field.values).astype(int)
        labels = []
        for number in present:
            known = isinstance(names, list) and 0 <= number < len(names)
            label = str(names[number]) if known else f"{field.label} {number}"
            labels.append((f" {label}", _COLOURS[number % len(_COLOURS)]))
        height = min(0.045 * len(labels), 0.6)
        self.plotter.add_legend(
            labels, bcolor=None, border=False, size=(0.16, height), loc="center right", face="rectangle"
        )

    def _aim(self) -> None:
        box = self._setting.box
        size = float(np.linalg.norm(box[1] - box[0]))
        fixed = [np.stack([place, place]) for place in places_in_space(self._result.facts.get("link_lines"))]
        shown = np.stack([box, *solid_bounds(self._obstacles, 3.0 * size), *fixed])
        box = np.stack([shown[:, 0].min(axis=0), shown[:, 1].max(axis=0)])
        width, height = self.plotter.window_size
        part = (_FILL_BARE, _FILL_BARE) if self._bare else (_FILL_WIDTH, _FILL_HEIGHT)
        center = (0.5, 0.5) if self._bare else _FILL_CENTER
        fill = (part[0] * width) / (part[1] * height)
        vertical = vertical_axis(resolved_or_empty(self._result))
        placed = place_camera(box, dim=self._setting.dim, vertical=vertical, aspect=fill)
        camera = self.plotter.camera
        camera.focal_point = placed.focal_point
        camera.up = placed.up
        camera.view_angle = VIEW_ANGLE
        if placed.parallel_scale is not None:
            camera.parallel_projection = True
            camera.parallel_scale = placed.parallel_scale / part[1]
            camera.position = placed.position
        else:
            # Stepping back by the fraction to be filled leaves the margins.
            back = placed.position - placed.focal_point
            camera.position = placed.focal_point + back / part[1]
        camera.SetWindowCenter(1.0 - 2.0 * center[0], 1.0 - 2.0 * center[1])
        self.plotter.reset_camera_clipping_range()
        self.plotter.camera_set = True

    def _number_format(self, low: float, high: float) -> str:
        # A narrow range far from zero needs the digits in which its ends differ.
        digits = int(np.clip(2 + np.ceil(np.log10(max(abs(low), abs(high)) / (high - low))), 3, 9))
        # VTK 9.6 went over from printf formats to those of std::format.
        return f"{{:.{digits}g}}" if tuple(self.pyvista.vtk_version_info) >= (9, 6) else f"%.{digits}g"

    def _title(self) -> str:
        title = self._result.facts.get("title") or resolved_or_empty(self._result).get("title")
        return " ".join(str(title).split())[:90] if title else ""

    def _font(self, size: int) -> int:
        return max(round(size * self._scale), 6)

    def _points(self, size: int) -> int:
        return max(round(size * self._scale), 8)
