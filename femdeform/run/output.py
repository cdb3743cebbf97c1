"""From the state of a simulation to frames: the mesh of the whole problem and its fields, gathered on rank 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.fem.fields import CELL_FIELDS, cell_field
from femdeform.fem.incremental_potential import State
from femdeform.run.setup import Simulation
from femdeform.run.vtu import FrameMesh
from femdeform.types import FloatArray

_BLOCK_NAMES = {
    ("line", 2): "line",
    ("triangle", 3): "triangle",
    ("triangle", 6): "triangle6",
    ("tetra", 4): "tetra",
    ("tetra", 10): "tetra10",
}


class FrameSource:
    """Gathers what a frame holds.

    Parameters
    ----------
    simulation : Simulation

    Attributes
    ----------
    mesh : FrameMesh
        All bodies in the reference state, one block per body; the same on every rank.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        discretization = simulation.discretization
        blocks = []
        bodies: list[np.ndarray] = []
        regions: list[np.ndarray] = []
        for number, (name, mesh) in enumerate(simulation.meshes.items()):
            place = discretization.bodies[name]
            connectivity = place.connectivity
            blocks.append((_BLOCK_NAMES[mesh.cell_type, connectivity.shape[1]], place.first + connectivity))
            bodies.append(np.full(mesh.n_cells, number, dtype=np.int64))
            region = np.zeros(mesh.n_cells, dtype=np.int64)
            for label, group in enumerate(simulation.scene.bodies[name].regions, start=1):
                region[mesh.cell_groups[group]] = label
            regions.append(region)
        self.mesh = FrameMesh(discretization.all_points, blocks, {"body": bodies, "region": regions})

    def point_data(self, state: State, reactions: FloatArray | None = None) -> dict[str, FloatArray] | None:
        """Displacement [m] and whatever else the scene asks for at all nodes; None off rank 0.

        Parameters
        ----------
        state : State
            The state to show.
        reactions : (n_local, dim) float64, optional
            Forces of supports and motions [N]; zero where there are none yet.
        """
        discretization = self._simulation.discretization
        fields = {"displacement": state.x - discretization.points}
        if "velocity" in self._simulation.scene.output.fields:
            fields["velocity"] = state.v
        if "reaction" in self._simulation.scene.output.fields:
            fields["reaction"] = np.zeros_like(state.x) if reactions is None else reactions
        if "contact" in self._simulation.scene.output.fields:
            pushed = self._simulation.problem.contact_forces(state.x).any(axis=1, keepdims=True)
            fields["contact"] = np.asarray(pushed, dtype=np.float64)
        gathered = {name: discretization.partition.gather(values) for name, values in fields.items()}
        return {name: values for name, values in gathered.items() if values is not None} or None

    def cell_data(self, state: State) -> dict[str, list[FloatArray]] | None:
        """Cell fields that the scene asks for, one array per body; None off rank 0."""
        simulation = self._simulation
        comm = simulation.discretization.partition.comm
        result: dict[str, list[FloatArray]] = {}
        for name in simulation.scene.output.fields:
            if name not in CELL_FIELDS:
                continue
            parts: list[tuple[str, Any, FloatArray]] = [
                (term.group.body, term.group.cell_ids, np.array(cell_field(name, term, state.x)))
                for term in simulation.problem.elastic
            ]
            everyone = [parts] if comm is None else comm.gather(parts, root=0)
            if everyone is None:
                continue
            width = 9 if name in ("cauchy_stress", "pk1") else 1
            whole = {
                body: np.zeros((mesh.n_cells, 9) if width == 9 else mesh.n_cells)
                for body, mesh in simulation.meshes.items()
            }
            for body, cells, values in (part for rank in everyone for part in rank):
                whole[body][cells] = values
            result[name] = list(whole.values())
        return result if comm is None or comm.Get_rank() == 0 else None
