"""`femdeform info`: what is installed here, and what of it femdeform can use."""

from __future__ import annotations

import os
import platform
import re
import sys
from importlib import metadata

_OPTIONAL = {
    "petsc4py": "parallel and iterative linear solvers",
    "mpi4py": "runs on several ranks",
    "torch": "learned linear solvers",
}
_PETSC_PACKAGES = ("mumps", "hypre", "superlu_dist", "ptscotch", "parmetis", "suitesparse")


def own_version() -> str:
    """Version of femdeform, or ``unknown`` where it is run without being installed."""
    return _version("femdeform") or "unknown"


def versions() -> dict[str, str]:
    """Versions that decide a run's numbers: femdeform, Python and the libraries that are installed."""
    names = [*_required(), *_OPTIONAL]
    found = {name: version for name in names if (version := _version(name)) is not None}
    return {"femdeform": own_version(), "python": platform.python_version(), **found}


def describe() -> str:
    """Return the whole text of `femdeform info`."""
    sections = {
        "femdeform": [("version", own_version()), ("Python", _python()), ("platform", platform.platform())],
        "libraries": [(name, _version(name) or "MISSING") for name in _required()],
        "linear solvers": _linear_solvers(),
        "MPI": _mpi(),
        "threads": _threads(),
        "optional parts": [*_optional_parts(), ("ffmpeg", _ffmpeg())],
    }
    lines = []
    for title, rows in sections.items():
        lines.append(title)
        lines += [f"  {name:<16} {value}" for name, value in rows]
    return "\n".join(lines)


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _required() -> list[str]:
    """Names of the libraries that femdeform's own metadata asks for, extras left out."""
    try:
        wanted = metadata.requires("femdeform") or []
    except metadata.PackageNotFoundError:
        wanted = ["numpy", "scipy", "numba", "scikit-fem"]
    names = [re.match(r"[\w.-]+", line) for line in wanted if "extra ==" not in line]
    return [name[0] for name in names if name]


def _python() -> str:
    return f"{platform.python_version()} ({sys.executable})"


def _linear_solvers() -> list[tuple[str, str]]:
    rows = [("SciPy direct", "serial, always there" if _version("scipy") else "MISSING")]
    try:
        from petsc4py import PETSc
    except ImportError as error:
        return [*rows, ("PETSc", _reason(error, "petsc4py"))]
    version = ".".join(map(str, PETSc.Sys.getVersion()))
    scalars = "complex" if PETSc.ScalarType().dtype.kind == "c" else "real"
    bits = 8 * PETSc.IntType().dtype.itemsize
    rows.append(("PETSc", f"{version} ({scalars}, {bits}-bit indices)"))
    there = {name: PETSc.Sys.hasExternalPackage(name) for name in _PETSC_PACKAGES}
    rows.append(("  with", ", ".join(name for name in there if there[name]) or "no external packages"))
    without = [name for name in there if not there[name]]
    if without:
        rows.append(("  without", ", ".join(without)))
    return rows


def _mpi() -> list[tuple[str, str]]:
    from femdeform.parallel import launched_ranks

    try:
        # Asking for the library does not need MPI to be started, and starting it can fail outside a launcher.
        import mpi4py

        mpi4py.rc.initialize = False
        from mpi4py import MPI
    except ImportError as error:
        return [("library", _reason(error, "mpi4py")), ("ranks", str(launched_ranks()))]
    library = " ".join(MPI.Get_library_version().split("\n")[0].split())
    standard = ".".join(map(str, MPI.Get_version()))
    return [("library", f"{library.split(',')[0]} (MPI {standard})"), ("ranks", str(launched_ranks()))]


def _reason(error: ImportError, name: str) -> str:
    """Why an import failed: the library is absent, or there and broken."""
    if isinstance(error, ModuleNotFoundError) and error.name == name:
        return f"not found ({name} is not installed)"
    return f"not usable: {' '.join(str(error).split())}"


def _threads() -> list[tuple[str, str]]:
    from femdeform import jit
    from femdeform.kernel_cache import cache_folder

    rows = [
        ("cores", str(jit.n_available_cores())),
        ("threads a rank", f"{jit.default_threads()} (cores divided by ranks on this machine)"),
    ]
    return [*rows, ("kernel cache", str(cache_folder()))]


def _optional_parts() -> list[tuple[str, str]]:
    return [
        (name, f"{_version(name)}, {purpose}" if _version(name) else f"not found, needed for {purpose}")
        for name, purpose in _OPTIONAL.items()
    ]


def _ffmpeg() -> str:
    purpose = "movies"
    if os.environ.get("IMAGEIO_FFMPEG_EXE"):
        return f"{os.environ['IMAGEIO_FFMPEG_EXE']}, {purpose}"
    bundled = _version("imageio-ffmpeg")
    if bundled:
        return f"bundled with imageio-ffmpeg {bundled}, {purpose}"
    import shutil

    found = shutil.which("ffmpeg")
    return f"{found}, {purpose}" if found else f"not found, needed for {purpose}"
