"""What a scene measures: from the blocks of `measure:` and `expect:` to numbers of a state."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from femdeform.errors import InputError
from femdeform.fem.fields import cell_field, jacobians, volumes
from femdeform.fem.incremental_potential import State
from femdeform.fem.interpolation import nodal_weights
from femdeform.run.components import component_of
from femdeform.run.setup import Simulation
from femdeform.scene import quantity_schema as schema
from femdeform.scene.point_location import locate_point
from femdeform.scene.selection_schema import Selection
from femdeform.types import FloatArray, IntArray

# Quantities that every result states, whatever its scene measures.
STANDARD = ("volume_ratio", "elastic_energy", "kinetic_energy", "max_displacement", "min_jacobian")


class Snapshot:
    """A state with what several quantities need of it, each evaluated once.

    Parameters
    ----------
    simulation : Simulation
        Its problem holds the loads and the inertia of the step that led to the state.
    state : State
    is_start : bool
        No step led to the state: reactions, which inertia and loads of a step decide, count as zero.
    """

    def __init__(self, simulation: Simulation, state: State, is_start: bool = False) -> None:
        self.simulation = simulation
        self.state = state
        self.is_start = is_start

    @cached_property
    def reactions(self) -> FloatArray:
        """Forces of supports and motions on the nodes (n_local, dim), zero at free degrees of freedom [N]."""
        if self.is_start:
            return np.zeros_like(self.state.x)
        problem = self.simulation.problem
        return np.where(problem.free, 0.0, problem.full_gradient(self.state.x))


Evaluate = Callable[[Snapshot], float]


class Meter:
    """Evaluates the quantities of a scene's `measure` block.

    Parameters
    ----------
    simulation : Simulation

    Raises
    ------
    InputError
        If a point lies in no cell.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._functions = {
            name: make_quantity(simulation, quantity) for name, quantity in simulation.scene.measure.items()
        }

    def evaluate(self, state: State, is_start: bool = False) -> dict[str, float]:
        """Values by name; collective over the ranks.

        Parameters
        ----------
        state : State
            The state that the last step led to.
        is_start : bool
            It is the initial state: no step led to it, reactions count as zero.
        """
        snapshot = Snapshot(self._simulation, state, is_start)
        return {name: function(snapshot) for name, function in self._functions.items()}


def standard_quantities(simulation: Simulation, state: State) -> dict[str, float]:
    """Evaluate `STANDARD`; collective over the ranks."""
    snapshot = Snapshot(simulation, state)
    return {name: scalar_quantity(name, None)(snapshot) for name in STANDARD}


def make_quantity(simulation: Simulation, quantity: schema.Quantity) -> Evaluate:
    """Prepare one block of `measure` for evaluation, which is collective over the ranks.

    Raises
    ------
    InputError
        If a point lies in no cell.
    """
    if isinstance(quantity, schema.MotionQuantity):
        return motion(simulation, quantity, quantity.component, quantity.kind)
    if isinstance(quantity, schema.ReactionQuantity):
        return reaction(simulation, quantity.on, quantity.component)
    if isinstance(quantity, schema.MomentQuantity):
        return _moment(simulation, quantity)
    if isinstance(quantity, schema.MomentumQuantity):
        return _momentum(quantity)
    if isinstance(quantity, (schema.LinkQuantity, schema.LinkForceQuantity)):
        return _link(simulation, quantity)
    return scalar_quantity(quantity.kind, quantity.body if isinstance(quantity, schema.CellQuantity) else None)


# ------------------------------------------------------------------------------------- nodes and points


def motion(simulation: Simulation, place: schema.Place, component: str, kind: str = "displacement") -> Evaluate:
    """Mean displacement or velocity of nodes, or that of a point.

    Raises
    ------
    InputError
        If a point lies in no cell.
    """
    nodes, weights = _weighted_nodes(simulation, place)

    def evaluate(snapshot: Snapshot) -> float:
        state = snapshot.state
        values = state.v[nodes] if kind == "velocity" else state.x[nodes] - simulation.discretization.points[nodes]
        return component_of(_sum_over_ranks(simulation, weights @ values), component)

    return evaluate


def _weighted_nodes(simulation: Simulation, place: schema.Place) -> tuple[IntArray, FloatArray]:
    """Owned nodes of a place and their weights, which add up to one over the ranks."""
    discretization = simulation.discretization
    if place.on is not None:
        every = simulation.conditions.nodes(place.on)
        weights = np.full(every.size, 1.0 / every.size)
    else:
        assert place.at is not None
        every, weights = _nodes_around(simulation, np.array(place.at))
    local = discretization.local_numbers[every]
    owned = (local >= 0) & (local < discretization.partition.n_owned)
    return local[owned], weights[owned]


def _nodes_around(simulation: Simulation, point: FloatArray) -> tuple[IntArray, FloatArray]:
    """Nodes of the cell that holds a point, in the whole problem, and their shape functions there."""
    for body, mesh in simulation.meshes.items():
        found = locate_point(mesh, point)
        if found is None:
            continue
        place = simulation.discretization.bodies[body]
        nodes = place.first + place.connectivity[found.cell]
        return nodes, nodal_weights(found.barycentric, mesh.cell_type, nodes.size)
    raise InputError(f"the point {point.tolist()} lies in no cell of the bodies")


def _sum_over_ranks(simulation: Simulation, vector: FloatArray) -> FloatArray:
    partition = simulation.discretization.partition
    return np.array([partition.sum(float(entry)) for entry in vector])


# ------------------------------------------------------------------------------------------- reactions


def reaction(simulation: Simulation, on: Selection, component: str) -> Evaluate:
    """Force that supports and motions exert on the selected nodes [N]."""
    nodes = _owned_nodes(simulation, on)

    def evaluate(snapshot: Snapshot) -> float:
        return component_of(_sum_over_ranks(simulation, snapshot.reactions[nodes].sum(axis=0)), component)

    return evaluate


def _owned_nodes(simulation: Simulation, on: Selection) -> IntArray:
    nodes = simulation.conditions.local_nodes(on)
    return nodes[nodes < simulation.discretization.partition.n_owned]


def _moment(simulation: Simulation, quantity: schema.MomentQuantity) -> Evaluate:
    nodes = _owned_nodes(simulation, quantity.on)
    if quantity.center is not None:
        center = np.array(quantity.center)
    else:
        center = simulation.discretization.all_points[simulation.conditions.nodes(quantity.on)].mean(axis=0)
    axis = np.array([0.0, 0.0, 1.0] if quantity.axis is None else quantity.axis)
    axis /= np.linalg.norm(axis)

    def evaluate(snapshot: Snapshot) -> float:
        moment = _cross(snapshot.state.x[nodes] - center, snapshot.reactions[nodes]).sum(axis=0)
        return float(_sum_over_ranks(simulation, moment) @ axis)

    return evaluate


def _cross(arm: FloatArray, vector: FloatArray) -> FloatArray:
    """Cross products (n, 3) of vectors in space or in the plane."""
    spread = np.zeros((2, len(arm), 3))
    spread[0, :, : arm.shape[1]], spread[1, :, : arm.shape[1]] = arm, vector
    return np.cross(spread[0], spread[1])


def _momentum(quantity: schema.MomentumQuantity) -> Evaluate:
    def evaluate(snapshot: Snapshot) -> float:
        simulation, state = snapshot.simulation, snapshot.state
        owned = slice(simulation.discretization.partition.n_owned)
        density = simulation.problem.apply_mass(state.v)[owned]
        if quantity.kind == "angular_momentum":
            density = _cross(state.x[owned], density)
            spin = simulation.problem.spin(state)
            density = density if spin is None else density + spin[owned]
        return component_of(_sum_over_ranks(simulation, density.sum(axis=0)), quantity.component)

    return evaluate


# ----------------------------------------------------------------------------------------------- links


def _link(simulation: Simulation, quantity: schema.LinkQuantity | schema.LinkForceQuantity) -> Evaluate:
    names = list(simulation.scene.links)
    number = None if quantity.link is None else names.index(quantity.link)

    def evaluate(snapshot: Snapshot) -> float:
        links, x = simulation.problem.links, snapshot.state.x
        assert links is not None
        partition = simulation.discretization.partition
        if isinstance(quantity, schema.LinkForceQuantity):
            assert number is not None
            return component_of(_sum_over_ranks(simulation, links.force(x, number)), quantity.component)
        if quantity.kind == "link_gap":
            return partition.max(links.gap(x, number))
        return partition.sum(links.energy(x, number))

    return evaluate


# --------------------------------------------------------------------------------------------- scalars


def scalar_quantity(kind: str, body: str | None) -> Evaluate:
    """A quantity without a place, of the whole scene or, where it belongs to cells, of one body."""
    if kind in ("volume_ratio", "min_jacobian"):
        return lambda snapshot: _volume(snapshot, kind, body)
    if kind in _OF_CELLS:
        return lambda snapshot: _OF_CELLS[kind](snapshot, body)
    return _OF_THE_SYSTEM[kind]


def _terms(snapshot: Snapshot, body: str | None) -> list[Any]:
    """Elastic energies of this rank's cells of a body, or of all."""
    return [term for term in snapshot.simulation.problem.elastic if body in (None, term.group.body)]


def _volume(snapshot: Snapshot, kind: str, body: str | None) -> float:
    partition = snapshot.simulation.discretization.partition
    groups = [term.group for term in _terms(snapshot, body)]
    reference, deformed, smallest = volumes(groups, snapshot.state.x)
    if kind == "min_jacobian":
        return partition.min(smallest)
    return partition.sum(deformed) / partition.sum(reference)


def _elastic_energy(snapshot: Snapshot, body: str | None) -> float:
    energy = sum(term.value(snapshot.state.x) for term in _terms(snapshot, body))
    return snapshot.simulation.discretization.partition.sum(energy)


def _max_von_mises(snapshot: Snapshot, body: str | None) -> float:
    solids = [term for term in _terms(snapshot, body) if term.group.kind == "solid"]
    stresses = [float(cell_field("von_mises", term, snapshot.state.x).max(initial=-np.inf)) for term in solids]
    largest = snapshot.simulation.discretization.partition.max(max(stresses, default=-np.inf))
    return largest if largest >= 0.0 else float("nan")


def _inverted_cells(snapshot: Snapshot, body: str | None) -> float:
    groups = [term.group for term in _terms(snapshot, body)]
    count = sum(int((jacobians(group, snapshot.state.x) <= 0.0).any(axis=1).sum()) for group in groups)
    return snapshot.simulation.discretization.partition.sum(float(count))


def _kinetic_energy(snapshot: Snapshot) -> float:
    return snapshot.simulation.problem.kinetic_energy(snapshot.state.v)


def _load_potential(snapshot: Snapshot) -> float:
    return snapshot.simulation.problem.load_potential(snapshot.state.x)


def _contact_energy(snapshot: Snapshot) -> float:
    return snapshot.simulation.problem.contact_energy(snapshot.state.x)


def _total_energy(snapshot: Snapshot) -> float:
    problem, x = snapshot.simulation.problem, snapshot.state.x
    inside = _kinetic_energy(snapshot) + _elastic_energy(snapshot, None) + problem.link_energy(x)
    return inside + _load_potential(snapshot) + _contact_energy(snapshot)


def _max_displacement(snapshot: Snapshot) -> float:
    discretization = snapshot.simulation.discretization
    length = np.linalg.norm(snapshot.state.x - discretization.points, axis=1)
    return discretization.partition.max(float(length.max(initial=0.0)))


def _penetration(snapshot: Snapshot) -> float:
    contact = snapshot.simulation.problem.weak_contact
    return 0.0 if contact is None else contact.penetration(snapshot.state.x)


def _contacts(snapshot: Snapshot) -> float:
    contact = snapshot.simulation.problem.weak_contact
    return 0.0 if contact is None else float(contact.count(snapshot.state.x))


_OF_CELLS: dict[str, Callable[[Snapshot, str | None], float]] = {
    "elastic_energy": _elastic_energy,
    "max_von_mises": _max_von_mises,
    "inverted_cells": _inverted_cells,
}
_OF_THE_SYSTEM: dict[str, Evaluate] = {
    "kinetic_energy": _kinetic_energy,
    "load_potential": _load_potential,
    "contact_energy": _contact_energy,
    "total_energy": _total_energy,
    "max_displacement": _max_displacement,
    "penetration": _penetration,
    "contacts": _contacts,
}
