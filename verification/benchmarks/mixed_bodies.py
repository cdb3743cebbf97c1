"""Bodies of the mixed benchmark: the rows of the paper's Table 1, beams and blocks.

Where the meshes that were published with the paper's code are found, in ``meshes/`` of the folder that FEMDEFORM_DATA
names (default ``shared/data`` beside the source tree), they are used; else recipes of about the same size.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter

from femdeform import parallel
from femdeform.run.setup import Simulation, build_simulation
from femdeform.scene.mesh_schema import MeshSource
from femdeform.scene.schema import DeformableScene
from femdeform.types import Mesh
from meshes.boundary import unique_edges
from meshes.build import build_mesh

DATA_VARIABLE = "FEMDEFORM_DATA"
BEAM_DT = 1.0 / 30.0  # [s]
_GRAVITY = 9.81  # [m/s^2]
# A body is held where it is within this part of its extent of its end.
_HELD = 0.05
# A turn about a skew axis, so that nothing is symmetric, and fast enough to strain the body in a few steps [rad/s].
_SPIN = [1.0, 0.5, 3.0]

Times = tuple[float, float, float]
_MESH: TypeAdapter[Any] = TypeAdapter(MeshSource)


@dataclass(frozen=True)
class Body:
    """One body and how it is held.

    Attributes
    ----------
    name : str
    law : str
    density, youngs_modulus, poisson_ratio : float
        [kg/m^3], [Pa], [-].
    recipe : dict
        Shipped mesh, as in a scene.
    file : str
        Published mesh; empty where there is none, or another one than in the paper.
    file_options : dict
        Further keys of its mesh block.
    kind : str
        ``solid``, ``membrane`` or ``rod``.
    measure : float
        Thickness [m] or cross-section [m^2].
    edges : bool
        Rods along all edges of the recipe's mesh.
    held : str
        ``top`` (largest y), ``left`` (smallest x) or ``nowhere``.
    """

    name: str
    law: str
    density: float
    youngs_modulus: float
    poisson_ratio: float
    recipe: Mapping[str, Any]
    file: str = ""
    file_options: Mapping[str, Any] = field(default_factory=dict)
    kind: Literal["solid", "membrane", "rod"] = "solid"
    measure: float = 1.0
    edges: bool = False
    held: Literal["top", "left", "nowhere"] = "nowhere"

    def mesh_block(self) -> dict[str, Any]:
        """The mesh block of a scene: the published file where it is found, else the recipe."""
        path = data_folder() / "meshes" / self.file
        if self.file and path.is_file():
            return {"file": str(path), **self.file_options}
        return dict(self.recipe)

    def small(self, cells: int) -> Body:
        """The same on a block, a cloth or a lattice of so many cells along an edge, for tests."""
        if self.kind == "membrane":
            recipe: dict[str, Any] = {"recipe": "cloth", "cells": [cells, cells], "plane": "xy"}
        else:
            recipe = {"recipe": "block", "cells": [cells, cells, cells]}
        return replace(self, recipe=recipe, file="", edges=self.kind == "rod")

    def case(self) -> dict[str, Any]:
        """What a child process needs to build it, for JSON."""
        mesh = self.mesh_block()
        return {
            "mesh": mesh,
            "edges": self.edges and "file" not in mesh,
            "kind": self.kind,
            "measure": self.measure,
            "held": self.held,
            "material": {
                "law": self.law,
                "density": self.density,
                "youngs_modulus": self.youngs_modulus,
                "poisson_ratio": self.poisson_ratio,
            },
        }


@dataclass(frozen=True)
class TableRow:
    """A row of Table 1.

    Attributes
    ----------
    body : Body
    paper : tuple of float or None
        Assembly, KKT solve, rotations as published: Apple M1, 8 cores [ms].
    reference : tuple of float or None
        The same of the authors' C++ code of that time on one thread of an AMD EPYC [ms], where it was measured.
    """

    body: Body
    paper: Times | None = None
    reference: Times | None = None


def data_folder() -> Path:
    """Folder with published meshes; it need not exist."""
    named = os.environ.get(DATA_VARIABLE, "").strip()
    return Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "data"


# ------------------------------------------------------------------------------------------- Table 1

_CLOTH: dict[str, Any] = {
    "recipe": {"recipe": "cloth", "size": [1.0, 1.0], "cells": [76, 76], "plane": "xy", "diagonals": "right"},
    "file": "square_cloth3.obj",
    "kind": "membrane",
    "measure": 1e-3,
    "held": "top",
}
_CUBE: dict[str, Any] = {
    "recipe": {"recipe": "block", "size": [2.0, 2.0, 2.0], "cells": [18, 18, 18], "translate": [-1.0, -1.0, -1.0]},
    "file": "cube_6k.mesh",
    "held": "left",
}
_SPOT: dict[str, Any] = {
    "recipe": {"recipe": "torus", "radius": 0.6, "tube_radius": 0.25, "element_size": 0.061},
    "file": "spot.mesh",
}
_MILLIMETRES = {"scale": 0.001}
_BUNNY = Body(
    "Tet Bunny",
    "neo_hookean",
    1e3,
    1e5,
    0.45,
    {"recipe": "sphere", "radius": 0.06, "element_size": 0.0126},
    file="coarse_bunny.mesh",
    file_options=_MILLIMETRES,
    held="top",
)

TABLE = (
    TableRow(Body("Square Cloth (soft)", "neo_hookean", 1e2, 1e5, 0.40, **_CLOTH), (5.40, 3.69, 1.95)),
    TableRow(Body("Square Cloth (stiff)", "neo_hookean", 1e3, 1e9, 0.40, **_CLOTH), (3.47, 3.37, 2.03)),
    TableRow(
        Body(
            "Rod Armadillo",
            "neo_hookean",
            1e1,
            1e7,
            0.45,
            {"recipe": "sphere_surface", "radius": 0.5, "element_size": 0.07},
            file="armadillo_low.obj",
            file_options={"cell_type": "edges"},
            kind="rod",
            measure=1e-4,
            edges=True,
        ),
        (1.01, 0.48, 0.73),
    ),
    TableRow(
        # The published octopus.mesh is a finer one than the table's.
        Body(
            "Jelly Octopus",
            "corotated",
            1e3,
            5e5,
            0.45,
            {"recipe": "spherical_shell", "part": "half", "radius": 0.3, "thickness": 0.1, "element_size": 0.058},
        ),
        (0.36, 0.71, 0.29),
    ),
    TableRow(Body("Beam ARAP", "arap", 1e3, 1e5, 0.45, **_CUBE), (8.24, 14.9, 3.06)),
    TableRow(Body("Beam Corot", "corotated", 1e3, 1e5, 0.45, **_CUBE), (4.74, 82.6, 3.24)),
    TableRow(Body("Beam NH", "neo_hookean", 1e3, 1e5, 0.45, **_CUBE), (8.88, 169.0, 3.21), (25.6, 23.8, 8.3)),
    TableRow(_BUNNY, (0.90, 1.47, 0.33), (1.9, 1.2, 0.6)),
    TableRow(
        Body(
            "Cloth Bunny",
            "neo_hookean",
            1e2,
            1e5,
            0.40,
            {"recipe": "sphere_surface", "radius": 0.06, "element_size": 0.0011757},
            kind="membrane",
            measure=1e-3,
            held="top",
        ),
        (17.38, 16.3, 7.18),
    ),
    TableRow(
        Body(
            "Rods Bunny",
            "neo_hookean",
            1e2,
            2e5,
            0.45,
            {"recipe": "sphere", "radius": 0.06, "element_size": 0.0142},
            file="coarser_bunny.mesh",
            file_options={**_MILLIMETRES, "cell_type": "edges"},
            kind="rod",
            measure=1e-6,
            edges=True,
            held="top",
        ),
        (0.95, 1.19, 0.44),
    ),
    TableRow(Body("Spot Drop (soft)", "corotated", 1e3, 1e6, 0.45, **_SPOT), (2.29, 25.0, 1.80), (5.0, 11.6, 3.9)),
    TableRow(Body("Spot Drop (stiff)", "corotated", 1e3, 1e9, 0.45, **_SPOT), (1.28, 4.02, 1.83)),
)

# The row whose saddle system is solved in all ways.
SADDLE_BODY = _BUNNY

# Bodies of which one iteration of either method is timed, neo-Hookean, 1e6 Pa, and the seconds that an iteration of
# Newton's and of the converged mixed method takes in the authors' C++ code, with CHOLMOD, on an AMD EPYC.
ITERATION_BODIES = {
    "spot": (Body("spot", "neo_hookean", 1e3, 1e6, 0.45, **{**_SPOT, "held": "left"}), (0.20, 0.30)),
    "cube": (Body("cube", "neo_hookean", 1e3, 1e6, 0.45, **_CUBE), (0.34, 0.50)),
}


def block(cells: int) -> Body:
    """A cube of a metre with 5 cells^3 tetrahedra, neo-Hookean, 1e6 Pa, held on its left."""
    recipe = {"recipe": "block", "size": [1.0, 1.0, 1.0], "cells": [cells, cells, cells]}
    return Body(f"{cells}^3 cells", "neo_hookean", 1e3, 1e6, 0.45, recipe, held="left")


# ------------------------------------------------------------------------------------------- scenes


def body_mesh(case: Mapping[str, Any]) -> Mesh:
    """Make or read the mesh of `Body.case`."""
    mesh = build_mesh(_MESH.validate_python(case["mesh"]), Path())
    if case["edges"]:
        return Mesh(mesh.points, unique_edges(mesh.cells), "line", {}, {}, {})
    return mesh


def thrown(
    case: Mapping[str, Any], dt: float, solver: Mapping[str, Any], linear_solver: Mapping[str, Any]
) -> Simulation:
    """A body held as it says, spun, under gravity, in steps of `dt` [s]."""
    mesh = body_mesh(case)
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    margin = high - low
    conditions: list[dict[str, Any]] = []
    if case["held"] != "nowhere":
        box = [(low - margin).tolist(), (high + margin).tolist()]
        if case["held"] == "top":
            box[0][1] = float(high[1] - _HELD * margin[1])
        else:
            box[1][0] = float(low[0] + _HELD * margin[0])
        conditions.append({"kind": "fixed", "on": {"box": box}})
    spin = {"kind": "initial_velocity", "on": "body", "angular_velocity": _SPIN}
    measure = {"membrane": {"thickness": case["measure"]}, "rod": {"cross_section": case["measure"]}}
    body = {"mesh": case["mesh"], "kind": case["kind"], "material": case["material"]}
    return _simulation(
        {"body": body | measure.get(case["kind"], {})},
        [*conditions, spin],
        {"scheme": "backward_euler", "dt": dt, "end": 1.0},
        mesh,
        solver,
        linear_solver,
    )


def twisted_beam(
    law: str, modulus: float, cells: tuple[int, int, int], solver: Mapping[str, Any], linear_solver: Mapping[str, Any]
) -> Simulation:
    """A quarter turn of one end of a beam in one step of a thirtieth of a second."""
    turn = {"kind": "rotate", "on": "body.right", "axis": [1.0, 0.0, 0.0], "rate": 0.5 * math.pi / BEAM_DT}
    body = _beam(law, modulus, cells)
    time = {"scheme": "backward_euler", "dt": BEAM_DT, "end": BEAM_DT}
    return _simulation({"body": body}, [_CLAMP, turn], time, None, solver, linear_solver, gravity=False)


def soft_cantilever(
    law: str, modulus: float, cells: tuple[int, int, int], solver: Mapping[str, Any], linear_solver: Mapping[str, Any]
) -> Simulation:
    """A beam that sags under its own weight in one static step."""
    body = _beam(law, modulus, cells)
    return _simulation({"body": body}, [_CLAMP], {"scheme": "quasistatic", "dt": 1.0}, None, solver, linear_solver)


_CLAMP = {"kind": "fixed", "on": "body.left"}


def _beam(law: str, modulus: float, cells: tuple[int, int, int]) -> dict[str, Any]:
    material = {"law": law, "density": 1e3, "youngs_modulus": modulus, "poisson_ratio": 0.45}
    return {"mesh": {"recipe": "block", "size": [1.0, 0.25, 0.25], "cells": list(cells)}, "material": material}


def _simulation(
    bodies: dict[str, Any],
    conditions: list[dict[str, Any]],
    time: dict[str, Any],
    mesh: Mesh | None,
    solver: Mapping[str, Any],
    linear_solver: Mapping[str, Any],
    gravity: bool = True,
) -> Simulation:
    scene = DeformableScene.model_validate(
        {
            "schema_version": 1,
            "title": "Mixed benchmark",
            "simulation": "deformable",
            "bodies": bodies,
            "conditions": conditions,
            "gravity": [0.0, -_GRAVITY if gravity else 0.0, 0.0],
            "time": time,
            "solver": dict(solver),
            "linear_solver": dict(linear_solver),
        }
    )
    if mesh is None:
        mesh = build_mesh(scene.bodies["body"].mesh, Path())
    return build_simulation(scene, {"body": mesh}, parallel.world())
