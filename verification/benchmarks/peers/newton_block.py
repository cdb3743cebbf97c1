"""The block in Newton (the physics engine, on Warp), and how its scripts are run."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def make_block(block: Any, colored: bool = False) -> tuple[Any, int]:
    """Return the model of the block, clamped at x = 0, on the processor, and its colours if asked for.

    Parameters
    ----------
    block : npz file
        As written by `verification.benchmarks.pbng_case.dump`.
    colored : bool
        Colour the nodes.
    """
    import newton
    import numpy as np
    import warp as wp

    wp.config.quiet = True
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
    points = block["points"]
    builder.add_soft_mesh(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0, 0.0, 0.0),
        vertices=[wp.vec3(*point) for point in points],
        indices=block["cells"].ravel().astype(int).tolist(),
        density=float(block["density"]),
        k_mu=float(block["mu"]),
        k_lambda=float(block["lmbda"]),
        k_damp=0.0,
        particle_radius=0.0,  # by default nodes are balls of 10 cm that push each other away
        add_surface_mesh_edges=False,
        validate_mesh=False,
    )
    colors = 0
    if colored:
        builder.color()
        colors = len(builder.particle_color_groups)
    for node in np.flatnonzero(points[:, 0] == 0.0):
        builder.particle_mass[int(node)] = 0.0
    return builder.finalize(device="cpu"), colors


def serve(compare: Callable[[Any], dict[str, Any]]) -> None:
    """Read the case, measure, write the result; skipped where Newton is not installed."""
    # Behind everything else, so that nothing of this environment is hidden.
    sys.path.append(str(Path(__file__).resolve().parents[3]))
    answer: dict[str, Any]
    if find_spec("newton") is None or find_spec("warp") is None:
        answer = {"skipped": "Newton and Warp are not in the environment with the peers"}
    else:
        import numpy as np

        with np.load(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["block"]) as arrays:
            answer = compare(arrays)
    Path(sys.argv[2]).write_text(json.dumps(answer), encoding="utf-8")
