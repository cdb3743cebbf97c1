"""What can be plugged in, by its word in a scene, as lazy ``module:attribute`` strings.

femdeform itself never imports the packages above it; whoever needs a solver, a mesh or a benchmark asks here,
and only then is its module, with the heavy libraries behind it, imported.
"""

from __future__ import annotations

import importlib
from functools import lru_cache
from typing import Any

from femdeform.errors import MissingDependencyError

SOLVERS: dict[str, str] = {
    "projected_newton": "solvers.projected_newton:ProjectedNewton",
    "mixed_fem": "solvers.mixed_variational:MixedVariational",
    "pbng": "solvers.pbng:PBNG",
    "xpbd": "solvers.xpbd:XPBD",
    "pbd": "solvers.xpbd:PBD",
    "xpbd_qs": "solvers.xpbd:XPBDQuasistatic",
    "b_pxpbd": "solvers.pxpbd:BlendedPXPBD",
    "fp_pxpbd": "solvers.pxpbd:FirstPiolaPXPBD",
}

# What a run drives, by the word `simulation` of its scene.
COURSES: dict[str, str] = {
    "deformable": "femdeform.run.deformable:DeformableCourse",
    "incompressible_flow": "femdeform.run.flow_course:FlowCourse",
    "material_points": "femdeform.run.point_course:PointCourse",
}

# Makes makers of what solves for the pressure of a flow.
PRESSURE_SOLVER = "solvers.linear.poisson.make:PressureSolverMaker"
# The path of a file of learned weights, as seen from a folder.
WEIGHTS_PATH = "solvers.linear.poisson.make:weights_path"

LINEAR_SOLVERS: dict[str, str] = {
    "ksp": "solvers.linear.ksp:KSP",
    "scipy_direct": "solvers.linear.scipy_direct:SciPyDirect",
    "block_cg": "solvers.linear.block_cg:BlockCG",
}

MESH: dict[str, str] = {
    "build": "meshes.build:build_mesh",
    "check": "meshes.quality:check_mesh",
    "command": "meshes.info:mesh_command",
    "embed": "meshes.embed:embed_points",
    "boundary": "meshes.boundary:boundary_facets",
}

# Where bodies with incremental potential contact start.
INITIAL_CONTACT = "femdeform.contact.ipc_setup:initial_findings"

# Bodies of material points that start inside of walls or of one another.
POINT_PLACES = "femdeform.run.point_places:place_findings"

# What the geometry of links between bodies does not allow.
LINK_GEOMETRY = "femdeform.run.links:link_findings"

PARTITIONER = "solvers.linear.partition:partition_cells"

BENCHMARKS: dict[str, str] = {
    "run": "verification.benchmarks.run:run_benchmarks",
}

# Says what is wrong with the weights that a pressure solver names.
WEIGHTS_FAULT = "solvers.linear.poisson.make:weights_fault"

TRAIN: dict[str, str] = {
    "settings": "solvers.linear.poisson.training.settings:TrainingSettings",
    "run": "solvers.linear.poisson.training.command:train_command",
    "threads": "torch:set_num_threads",
}

VERIFY: dict[str, str] = {
    "run": "verification.verify:verify_command",
    "list": "verification.verify:list_cases",
}

_PRESET_PACKAGE = "solvers"
_OWN_PACKAGES = frozenset({"femdeform", "solvers", "meshes", "verification"})
_EXTRAS = {"petsc4py": "petsc", "mpi4py": "petsc", "torch": "learned"}


def resolve(spec: str) -> Any:
    """Import what a ``module:attribute`` string names.

    Raises
    ------
    MissingDependencyError
        If a library that the module needs is not installed or cannot be loaded.
    """
    module_name, _, attribute = spec.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in _OWN_PACKAGES:
            raise
        if isinstance(error, ModuleNotFoundError) and missing:
            message = f"{attribute} needs {missing}, which is not installed"
            if missing in _EXTRAS:
                message += f"; install it with: pip install 'femdeform[{_EXTRAS[missing]}]'"
            raise MissingDependencyError(message) from error
        raise MissingDependencyError(f"{attribute} cannot be used here: {error}") from error
    return getattr(module, attribute)


@lru_cache(maxsize=1)
def preset_names() -> tuple[str, ...]:
    """Names that ``linear_solver.preset`` can take, sorted: the files of `solvers/presets`."""
    from importlib.resources import files

    folder = files(_PRESET_PACKAGE) / "presets"
    if not folder.is_dir():
        return ()
    names = [item.name for item in folder.iterdir()]
    return tuple(sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml")))


def saddle_preset(name: str) -> str:
    """``solver.global_solve`` that a preset stands for, ``kkt_minres`` for ``kkt-minres``; empty for any other."""
    return name.replace("-", "_") if name.startswith("kkt-") and name in preset_names() else ""
