"""What every picture is drawn on: the plotter, its camera, title and time, legends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from femdeform.post.camera import VIEW_ANGLE, place_camera, vertical_axis
from femdeform.post.obstacles import solid_bounds
from femdeform.post.setting import Setting, around, resolved_or_empty
from femdeform.run.result import Result
from femdeform.types import FloatArray

_COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#ee9944", "#888888")
# Parts of the picture the bodies may fill; the rest is for the legend on the right and for title and time.
_FILL_WIDTH, _FILL_HEIGHT = 0.74, 0.76
_FILL_CENTER = (0.43, 0.485)
_FILL_BARE = 0.92


class Canvas:
    """A plotter, and how things are done on it that all kinds of results share.

    Parameters
    ----------
    pyvista : module
        PyVista, from `load_pyvista`.
    result : Result
        The result.
    setting : Setting
        From `survey`.
    size : (int, int)
        Width and height [pixels].
    off_screen : bool
        Draw into memory, not into a window.
    bare : bool
        Without title, time, axes and legend.
    """

    def __init__(
        self, pyvista: Any, result: Result, setting: Setting, size: tuple[int, int], off_screen: bool, bare: bool
    ) -> None:
        self.pyvista = pyvista
        self.result = result
        self.setting = setting
        self.size = size
        self.is_window = not off_screen
        self.bare = bare
        self.scale = size[1] / 800.0
        self.obstacles = [o for o in result.facts.get("obstacles") or [] if isinstance(o, dict)]
        self.plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(size), lighting="light kit")
        theme = setting.theme
        self.plotter.set_background(theme.ground, top=theme.ground_top if theme.ground_top != theme.ground else None)
        self.plotter.enable_anti_aliasing("msaa", multi_samples=8)

    @property
    def text(self) -> str:
        """Colour of text."""
        return self.setting.theme.text

    def font(self, size: int) -> int:
        """Size of a font in a picture of this size, from that in a picture 800 pixels high."""
        return max(round(size * self.scale), 6)

    def annotate(self) -> None:
        """Add title and axes, unless the picture is bare."""
        if self.bare:
            return
        for bar in self.plotter.scalar_bars.values():
            bar.SetVerticalTitleSeparation(round(10 * self.scale))
        title = self._title()
        if title:
            self.plotter.add_text(title, position=(0.03, 0.93), viewport=True, font_size=self.font(16), color=self.text)
        self.plotter.add_axes(viewport=(0.84, 0.0, 1.0, 0.2), line_width=2, color=self.text)

    def show_time(self, time: float) -> None:
        """Write the time [s] into the picture, and draw it."""
        if self.bare:
            # New text makes the plotter draw again; moved points alone do not.
            self.plotter.render()
            return
        text = f"t = {time:.4g} s"
        self.plotter.add_text(
            text, name="time", position=(0.03, 0.035), viewport=True, font_size=self.font(13), color=self.text
        )

    def scale_options(self, label: str, colours: tuple[float, float], cmap: Any = "viridis") -> dict[str, Any]:
        """Options of ``add_mesh`` for a field with a range of colours and a bar beside the picture.

        Parameters
        ----------
        label : str
            Name and unit of the field.
        colours : (float, float)
            Range.
        cmap : str or colour map
            Colours.
        """
        low, high = colours
        if not high > low:
            # A field that is the same everywhere still needs a range to be drawn and labelled.
            low, high = low - 0.5 * max(abs(low), 1e-12), high + 0.5 * max(abs(high), 1e-12)
        bar = {
            "title": label,
            "vertical": True,
            "position_x": 0.865,
            "position_y": 0.24,
            "width": 0.065,
            "height": 0.58,
            "n_labels": 6,
            "fmt": self._number_format(low, high),
            "title_font_size": self._points(20),
            "label_font_size": self._points(18),
            "color": self.text,
        }
        return {"cmap": cmap, "clim": (low, high), "scalar_bar_args": bar, "show_scalar_bar": not self.bare}

    def category_options(self, n: int) -> dict[str, Any]:
        """Options of ``add_mesh`` for a field that numbers things from 0 to n - 1."""
        n = max(n, 2)
        return {
            "cmap": [category_colour(i) for i in range(n)],
            "clim": (-0.5, n - 0.5),
            "show_scalar_bar": False,
        }

    def add_legend(self, numbers: Sequence[int], label: str, names: Any) -> None:
        """Name the things that a field numbers, unless the picture is bare.

        Parameters
        ----------
        numbers : sequence of int
            Those that are there.
        label : str
            Of the field, for those without a name.
        names : list of str, or anything else
            Names by number.
        """
        if self.bare:
            return
        labels = []
        for number in numbers:
            known = isinstance(names, list | tuple) and 0 <= number < len(names)
            word = str(names[number]) if known else f"{label} {number}"
            labels.append((f" {word}", category_colour(number)))
        # A single label would be too large for the width.
        height = min(0.045 * len(labels), 0.6) if len(labels) > 1 else 0.025
        self.plotter.add_legend(
            labels, bcolor=None, border=False, size=(0.16, height), loc="center right", face="rectangle"
        )

    def aim(self, places: Sequence[FloatArray] = ()) -> None:
        """Point the camera at the box of the setting.

        Parameters
        ----------
        places : sequence of (3,) float64
            Points that the picture should have room for too [m].
        """
        box = self.setting.box
        size = float(np.linalg.norm(box[1] - box[0]))
        fixed = [np.stack([place, place]) for place in places]
        box = around([box, *solid_bounds(self.obstacles, 3.0 * size), *fixed])
        width, height = self.plotter.window_size
        part = (_FILL_BARE, _FILL_BARE) if self.bare else (_FILL_WIDTH, _FILL_HEIGHT)
        center = (0.5, 0.5) if self.bare else _FILL_CENTER
        fill = (part[0] * width) / (part[1] * height)
        vertical = vertical_axis(resolved_or_empty(self.result))
        placed = place_camera(box, dim=self.setting.dim, vertical=vertical, aspect=fill)
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
        title = self.result.facts.get("title") or resolved_or_empty(self.result).get("title")
        return " ".join(str(title).split())[:90] if title else ""

    def _points(self, size: int) -> int:
        return max(round(size * self.scale), 8)


def category_colour(number: int) -> str:
    """Colour of the thing of a number."""
    return _COLOURS[number % len(_COLOURS)]
