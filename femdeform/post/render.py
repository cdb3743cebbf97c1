"""Pictures, movies and a window on a result."""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import Fault, InputError, MissingDependencyError
from femdeform.post.backend import has_display, load_pyvista
from femdeform.post.stage import Stage
from femdeform.post.survey import survey
from femdeform.run import atomic
from femdeform.run.result import Result

PICTURE_SIZE = (1280, 800)
GIF_SIZE = (800, 500)
_PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
_MOVIE_SUFFIXES = (".mp4", ".gif")


def view(
    result: Path,
    *,
    png: Path | None = None,
    movie: Path | None = None,
    frame: int | None = None,
    field: str | None = None,
) -> list[Path]:
    """Draw a result, coloured by a field.

    Deformable bodies are drawn over the outline of their reference shape, fields of a flow as an image in the plane, as
    smoke or on slices in space, particles as discs or balls.

    With neither `png` nor `movie` a window opens; where there is no display, ``view.png`` is written into the
    result folder instead, and a line on stderr says so.

    Parameters
    ----------
    result : Path
        Result folder.
    png : Path, optional
        Picture to write (``.png`` or ``.jpg``).
    movie : Path, optional
        Movie of all frames to write, ``.mp4`` or ``.gif``. Camera and colours are the same in every frame.
    frame : int, optional
        Frame of the picture or of the window, counted from 0, negative numbers from the end; default: the
        last.
    field : str, optional
        Field to colour by: ``displacement`` (its norm, the default for bodies), ``velocity``, ``displacement.y``,
        ``cauchy_stress.xx``, ``von_mises``, ``body``, ``density`` (the default for flows), ``vorticity``,
        ``temperature``: whatever the frames hold. Flows and particles with a velocity have a ``speed`` too, flows a
        ``vorticity``.

    Returns
    -------
    list of Path
        Files written.

    Raises
    ------
    InputError
        If the folder is not a result, or has no such frame or field, or a name has the wrong suffix.
    MissingDependencyError
        If nothing can be drawn on this machine.
    OutputError
        If a file cannot be written.
    """
    opened = Result.open(result)
    _check_suffix(png, _PICTURE_SUFFIXES, "picture")
    _check_suffix(movie, _MOVIE_SUFFIXES, "movie")
    n_frames = len(opened.frames)
    if n_frames == 0:
        raise InputError([Fault(str(result), 0, "", "there are no frames in this result")])
    chosen = n_frames - 1 if frame is None else frame
    opened.read_frame(chosen)  # an unknown frame is an error before anything is drawn
    if png is None and movie is None:
        if has_display():
            _open_window(opened, chosen % n_frames, field)
            return []
        png = opened.folder / "view.png"
        print(f"no display here: the picture goes to {png}", file=sys.stderr)
    written = []
    if png is not None:
        _make_parent(png)
        _write_picture(png, draw_frames(opened, [chosen], field=field)[0])
        written.append(png)
    if movie is not None:
        _make_parent(movie)
        _write_movie(opened, movie, field)
        written.append(movie)
    return written


def draw_frames(
    result: Result, frames: Sequence[int], *, field: str | None = None, size: tuple[int, int] = PICTURE_SIZE
) -> list[NDArray[np.uint8]]:
    """Pictures of some frames, with one camera and one range of colours for all of them.

    Parameters
    ----------
    result : Result
        The result.
    frames : sequence of int
        Positions in ``result.frames``.
    field : str, optional
        Field to colour by, as in `view`.
    size : (int, int)
        Width and height [pixels].

    Returns
    -------
    list of (height, width, 3) uint8
        A picture per frame.

    Raises
    ------
    InputError
        If a frame or the field cannot be read.
    MissingDependencyError
        If nothing can be drawn on this machine.
    """
    pyvista = load_pyvista()
    setting = survey(result, frames, field)
    with contextlib.closing(Stage(pyvista, result, setting, field, size=size)) as stage:
        pictures = []
        for index in frames:
            stage.show(index)
            pictures.append(stage.picture())
    return pictures


def encode_picture(picture: NDArray[np.uint8], suffix: str = ".png") -> bytes:
    """A picture as the bytes of a ``.png`` or ``.jpg`` file."""
    return bytes(_imageio().imwrite("<bytes>", picture, extension=suffix))


def _write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    atomic.write_bytes(path, encode_picture(picture, path.suffix.lower()))


def _write_movie(result: Result, path: Path, field: str | None) -> None:
    pyvista = load_pyvista()
    gif = path.suffix.lower() == ".gif"
    n_frames = len(result.frames)
    # Short runs are slowed down so that there is something to see, long ones play at the rate of films.
    rate = float(np.clip(n_frames / 6.0, 4.0, 30.0))
    frames = range(n_frames)
    with _progress(2 * n_frames, f"drawing {path.name}") as advance, atomic.replacing(path) as temporary:
        setting = survey(result, frames, field, advance)
        size = GIF_SIZE if gif else PICTURE_SIZE
        with (
            contextlib.closing(Stage(pyvista, result, setting, field, size=size)) as stage,
            contextlib.closing(_movie_writer(temporary, rate, gif)) as writer,
        ):
            for index in frames:
                stage.show(index)
                writer.append_data(stage.picture())
                advance()


def _movie_writer(path: Path, rate: float, gif: bool) -> Any:
    imageio = _imageio_v2()
    if gif:
        return imageio.get_writer(path, mode="I", duration=1000.0 / rate, loop=0)
    try:
        # Most players want the colour format yuv420p, which needs even sizes; ours are multiples of 16.
        return imageio.get_writer(
            path,
            format="FFMPEG",
            fps=rate,
            codec="libx264",
            quality=8,
            macro_block_size=16,
            ffmpeg_log_level="error",
        )
    except (ImportError, RuntimeError, ValueError) as error:
        message = f"mp4 movies need imageio-ffmpeg, .gif works without it ({error})"
        raise MissingDependencyError(message) from error


def _open_window(result: Result, index: int, field: str | None) -> None:
    pyvista = load_pyvista()
    n_frames = len(result.frames)
    setting = survey(result, range(n_frames), field)
    stage = Stage(pyvista, result, setting, field, size=PICTURE_SIZE, off_screen=False)
    stage.show(index)
    if n_frames > 1:
        add_frame_slider(stage, index, n_frames)
    stage.plotter.show(title=f"femdeform: {result.folder}")


def add_frame_slider(stage: Stage, index: int, n_frames: int) -> None:
    """Put a slider over the frames into a window.

    Parameters
    ----------
    stage : Stage
        A stage that shows a frame already.
    index : int
        The frame it shows.
    n_frames : int
        Number of frames.
    """
    shown = [index]

    def move(value: float) -> None:
        wanted = round(value)
        if wanted != shown[0]:
            shown[0] = wanted
            stage.show(wanted)

    stage.plotter.add_slider_widget(
        move,
        rng=(0, n_frames - 1),
        value=index,
        title="frame",
        pointa=(0.25, 0.08),
        pointb=(0.75, 0.08),
        color="#202020",
        fmt="%.0f" if tuple(stage.pyvista.vtk_version_info) < (9, 6) else "{:.0f}",
        style="modern",
    )


@contextlib.contextmanager
def _progress(total: int, label: str) -> Iterator[Callable[[], None]]:
    if not sys.stderr.isatty():
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total)
        yield lambda: bar.advance(task)


def _check_suffix(path: Path | None, suffixes: tuple[str, ...], kind: str) -> None:
    if path is not None and path.suffix.lower() not in suffixes:
        raise InputError([Fault(str(path), 0, "", f"a {kind} has to end in {' or '.join(suffixes)}")])


def _make_parent(path: Path) -> None:
    atomic.make_folder(path.parent)


def _imageio() -> Any:
    try:
        return importlib.import_module("imageio.v3")
    except ImportError as error:
        raise MissingDependencyError(f"pictures need imageio, which cannot be imported ({error})") from error


def _imageio_v2() -> Any:
    _imageio()
    return importlib.import_module("imageio.v2")
