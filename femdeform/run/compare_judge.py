"""The one judgement of a comparison: residual, distance to the reference and invariants, from positions alone.

Nothing that a solver says about itself enters: everything is evaluated anew on a problem that no solver touches.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import numpy as np

from femdeform.fem.incremental_potential import State
from femdeform.run.quantities import Snapshot, make_quantity, scalar_quantity
from femdeform.run.setup import Simulation
from femdeform.scene.quantity_schema import MomentumQuantity
from femdeform.scene.schema import DeformableScene
from femdeform.types import FloatArray, Mesh

_SCALARS = (
    "kinetic_energy",
    "elastic_energy",
    "load_potential",
    "contact_energy",
    "total_energy",
    "volume_ratio",
    "min_jacobian",
    "inverted_cells",
)


class Judge:
    """Measures positions against the problem of a step.

    Parameters
    ----------
    simulation : Simulation
        One that no solver uses any more; its problem is the judge's own.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._problem = simulation.problem
        self._mass = simulation.discretization.lumped_mass
        self._momenta = {
            f"{names['kind']}_{names['component']}": make_quantity(simulation, MomentumQuantity.model_validate(names))
            for names in _momenta(simulation.discretization.dim)
        }

    def begin_step(self, state: State, dt: float, x_reference: FloatArray) -> None:
        """Take up the step from a state.

        Parameters
        ----------
        state : State
            Where the judged solver starts.
        dt : float
            Step [s].
        x_reference : (n_nodes, dim) float64
            The reference's positions at the end of the step [m]. Where the start is at rest and nothing but supports
            moves, the forces there stand in for R0: whatever solver is judged, they are the same.
        """
        self._problem.begin_step(state, dt)
        self._problem.place_obstacles(1.0)
        x = self._problem.unknowns_near(x_reference)
        self._problem.arrive_at(x)
        # The level of rounding, by which rest is recognised, is known after a Hessian.
        self._problem.hessian(x, project=True)
        self._problem.settle_force_scale(x)

    def start(self, state: State) -> FloatArray:
        """Positions from which every solver of the step starts [m]: the last ones, with supports moved."""
        return self._problem.initial_guess(self._problem.solver_state(state))

    def roundoff(self, x: FloatArray) -> float:
        """Residual that rounding alone may leave [N]."""
        return self._problem.roundoff_norm(x)

    def residual(self, x: FloatArray) -> dict[str, float]:
        """Residual and objective at positions; not finite where the material is not defined or surfaces intersect.

        Returns
        -------
        dict
            `residual_norm` [N], `force_scale`, which is R0 [N], `relative_residual`, their ratio [-], `residual_max`,
            the largest component [N], and `objective`, Phi [J].
        """
        self._problem.arrive_at(x)
        with np.errstate(all="ignore"):
            r = self._problem.gradient(x)
            norm = self._problem.residual_norm(r)
            objective = self._problem.value(x)
        scale = self._problem.force_scale
        return {
            "residual_norm": norm,
            "relative_residual": norm / scale if scale > 0.0 else (0.0 if norm == 0.0 else math.inf),
            "residual_max": float(np.abs(r).max(initial=0.0)),
            "force_scale": scale,
            "objective": objective,
        }

    def distance(self, x: FloatArray, x_reference: FloatArray) -> dict[str, float]:
        """Mass-weighted root mean square and largest distance of the nodes from where the reference has them [m].

        x are unknowns of the step begun, `x_reference` positions of the nodes of the bodies.
        """
        with np.errstate(all="ignore"):
            away = self._problem.node_positions(x) - x_reference
            squared = np.einsum("ic,ic->i", away, away)
        rms = math.sqrt(float(self._mass @ squared / self._mass.sum()))
        return {"distance": rms, "distance_max": math.sqrt(float(squared.max(initial=0.0)))}

    def invariants(self, state: State) -> dict[str, float]:
        """Energies [J], momenta, volume ratio, smallest det F and inverted cells of an accepted state."""
        snapshot = Snapshot(self._simulation, state)
        values = {name: scalar_quantity(name, None)(snapshot) for name in _SCALARS}
        return values | {name: evaluate(snapshot) for name, evaluate in self._momenta.items()}

    def invariant_names(self) -> tuple[str, ...]:
        """Names of what `invariants` gives."""
        return (*_SCALARS, *self._momenta)


def _momenta(dim: int) -> list[dict[str, str]]:
    turning = "xyz" if dim == 3 else "z"
    linear = [{"kind": "linear_momentum", "component": component} for component in "xyz"[:dim]]
    return linear + [{"kind": "angular_momentum", "component": component} for component in turning]


def stiffness_number(scene: DeformableScene, meshes: Mapping[str, Mesh]) -> float:
    """kappa = h^2 E / (rho dx^2), the largest over bodies and their materials [-].

    It says how far stiffness outweighs inertia over one cell in one step, which decides how many sweeps a
    position-based method needs. dx is the mean length of the edges of a body's cells; an edge counts once for every
    cell it belongs to. A quasistatic scene has no inertia: infinite.
    """
    if scene.time.scheme == "quasistatic":
        return math.inf
    largest = 0.0
    for name, body in scene.bodies.items():
        materials = [material for material in [body.material, *body.regions.values()] if material is not None]
        ratio = max(material.youngs_modulus / material.density for material in materials)
        largest = max(largest, ratio * (scene.time.dt / mean_edge_length(meshes[name])) ** 2)
    return largest


def mean_edge_length(mesh: Mesh) -> float:
    """Mean length of the edges of the cells [m]; an edge counts once for every cell it belongs to."""
    pairs = np.array(list(itertools.combinations(range(mesh.cells.shape[1]), 2)))
    ends = mesh.points[mesh.cells[:, pairs]]
    return float(np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).mean())
