"""Gets PyVista ready to draw, with a display or without one, or says in one line why it cannot."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from functools import lru_cache
from typing import Any

from femdeform.errors import MissingDependencyError

# VTK does not report that no OpenGL can be had: it crashes. So the question is put to another process.
_PROBE = """
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except (ImportError, ValueError, OSError):
    pass
from vtkmodules.vtkCommonCore import vtkLogger
vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderWindow
window = vtkRenderWindow()
window.SetOffScreenRendering(True)
window.SetSize(16, 16)
window.Render()
raise SystemExit(0 if window.SupportsOpenGL() else 3)
"""

_ADVICE = (
    "pictures need OpenGL, which cannot be started here: install the Debian packages libegl1 and "
    "libgl1-mesa-dri (software rendering, no display needed), or look at the frames in ParaView"
)


def has_display() -> bool:
    """Whether a window can be opened here."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def load_pyvista() -> Any:
    """Import PyVista, after making sure that it can draw.

    Raises
    ------
    MissingDependencyError
        If PyVista is not installed, or there is no OpenGL for it.
    """
    if not has_display():
        # Spares VTK the search for an X server, and its complaints. It still falls back to OSMesa by itself.
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    try:
        pyvista = importlib.import_module("pyvista")
    except ImportError as error:
        raise MissingDependencyError(f"pictures need pyvista, which cannot be imported ({error})") from error
    if not _can_draw():
        raise MissingDependencyError(_ADVICE)
    # Reasons why one backend is passed over are of no use once another has been found.
    logger = importlib.import_module("vtkmodules.vtkCommonCore").vtkLogger
    logger.SetStderrVerbosity(logger.VERBOSITY_ERROR)
    return pyvista


@lru_cache(maxsize=1)
def _can_draw() -> bool:
    try:
        probe = subprocess.run(
            [sys.executable, "-P", "-c", _PROBE],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
            timeout=60,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return probe.returncode == 0
