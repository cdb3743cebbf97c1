"""Contact of bodies with one another and with themselves by incremental potential contact, through ipctk.

Energy: ``sum_k w_k b(d_k)`` over all pairs of a vertex and a face, of two edges (in 2D of a vertex and an edge) and of
what they reduce to, that are closer than d_hat and share no vertex; w_k is the area of the pair times the stiffness,
b the barrier of `femdeform.contact.barrier`. Friction: ``sum_k mu N_k f0(|u_k|)`` with the tangential slip u over the
step; the normal forces N and the tangents are those of the last accepted state. Energies are in joule: nothing is
multiplied by dt^2.

The term protects itself. It knows a position that can be (first the accepted state) and evaluates another one only if
continuous collision detection finds the straight way there free; otherwise its energy is infinite. A solver that
bounds its steps by `max_step` pays for one detection an iteration, any other for one an evaluation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from femdeform.contact.surface import CollisionSurface
from femdeform.contact.terms import NodeBlocks
from femdeform.errors import MissingDependencyError
from femdeform.types import BoolArray, FloatArray

# A position this close to the checked way, relative to the size of the coordinates, is on it.
_ON_THE_WAY = 1e-13
# Smallest gap that a step may leave, in d_hat: below it collision detection would be lost in rounding.
_CLOSEST = 1e-6
# Longest step that is searched for collisions, in diagonals of the bodies' bounding box: longer ones are cut.
_LONGEST = 0.5


def _ipctk() -> Any:
    try:
        import ipctk
    except ImportError as error:
        raise MissingDependencyError(
            f"contact between bodies needs ipctk, which cannot be imported: {error}; install it with: pip install ipctk"
        ) from None
    # Its parallel sums depend on how threads share the work; a run has to give the same bits again.
    ipctk.set_num_threads(1)
    # What matters comes back as a value.
    ipctk.set_logger_level(ipctk.LoggerLevel.error)
    return ipctk


def make_collision_mesh(surface: CollisionSurface, may_touch: BoolArray) -> Any:
    """Return ipctk's mesh of a surface with its filter of pairs.

    Parameters
    ----------
    surface : CollisionSurface
        Surfaces of all bodies.
    may_touch : (n_bodies, n_bodies) bool
        Symmetric; the diagonal says whether a body may touch itself.

    Raises
    ------
    MissingDependencyError
        If ipctk cannot be imported.
    """
    ipctk = _ipctk()
    mesh = ipctk.CollisionMesh(np.asfortranarray(surface.rest), surface.edges, surface.faces)
    mesh.vertex_areas = surface.vertex_weight
    mesh.edge_areas = surface.edge_weight
    mesh.can_collide = _pair_filter(ipctk, surface.body, may_touch)
    return mesh


def _pair_filter(ipctk: Any, body: np.ndarray, may_touch: BoolArray) -> Any:
    """Filter of vertex pairs, composed of ipctk's compiled ones: vertices with the same label do not collide."""
    everything = ipctk.CollisionFilter()
    if may_touch.all():
        return everything
    different = ipctk.make_vertex_patches_filter(body.astype(np.int32))
    if not may_touch.diagonal().any():
        chosen = different
    else:
        labels = np.arange(body.size) + len(may_touch)
        alone = ~np.diagonal(may_touch)[body]
        chosen = ipctk.make_vertex_patches_filter(np.where(alone, body, labels).astype(np.int32))
    for first, second in np.argwhere(np.triu(~may_touch, 1)):
        labels = np.arange(body.size) + 1
        apart = ipctk.make_vertex_patches_filter(np.where(np.isin(body, (first, second)), 0, labels).astype(np.int32))
        chosen = chosen & (apart | ~different)
    return chosen


class IPCContact:
    """Contact between deformable bodies.

    Parameters
    ----------
    surface : CollisionSurface
        Surfaces of all bodies.
    may_touch : (n_bodies, n_bodies) bool
        Symmetric; the diagonal says whether a body may touch itself.
    reach : float
        Gap at which the barrier starts, d_hat [m].
    offset : float
        Smallest distance of vertices, edges and faces, d_min [m].
    friction : float
        Coulomb's coefficient [-].
    stick_velocity : float
        Slip velocity up to which friction sticks, eps_v [m/s].

    Raises
    ------
    MissingDependencyError
        If ipctk cannot be imported.

    References
    ----------
    M. Li et al., Incremental Potential Contact (2020). M. Li et al., Codimensional Incremental Potential Contact
    (2021), for d_min and additive collision detection. M. Li et al., Convergent Incremental Potential Contact (2023),
    for the weighting by area.

    Limitations
    -----------
    Serial. One thickness d_min for all pairs. Quadratic surfaces are taken as flat between their nodes. A body that
    lies inside another one without touching its surface is not noticed. Friction lags by a step.
    """

    def __init__(
        self,
        surface: CollisionSurface,
        may_touch: BoolArray,
        reach: float,
        offset: float,
        friction: float,
        stick_velocity: float,
    ) -> None:
        self._ipctk = _ipctk()
        self.surface = surface
        self.reach = reach
        self.offset = offset
        self.friction = friction
        self.stick_velocity = stick_velocity
        self.mesh = make_collision_mesh(surface, may_touch)
        # Areas carry the stiffness.
        self._potential = self._ipctk.BarrierPotential(reach, 1.0, True)
        self._broad_phase = self._ipctk.LBVH()
        self._narrow_phase = self._ipctk.AdditiveCCD()
        self._friction_law: Any = None
        self._rubbing: Any = None
        self._start = surface.rest
        # The checked way: every position between `_from` and `_from + _move` can be.
        self._from = surface.rest
        self._move = np.zeros_like(surface.rest)
        # Candidates hold for positions inside their box; collisions for one position.
        self._candidates: Any = None
        self._lowest = self._highest = surface.rest
        self._collisions: Any = None
        self._at = surface.rest

    # ----------------------------------------------------------------------------------------------- the step

    def begin_step(self, x: FloatArray, time: float, dt: float) -> None:
        """Take the accepted state for one that can be, and freeze friction there.

        Nothing from earlier steps is kept, so that a run that goes on from a checkpoint gives the same bits.
        """
        self._start = self._vertices(x)
        self._from, self._move = self._start, np.zeros_like(self._start)
        self._candidates, self._collisions = None, None
        self._rubbing = None
        if self.friction > 0.0:
            scale = max(self.stick_velocity * dt, 1e-300)
            self._friction_law = self._ipctk.FrictionPotential(scale)
            rubbing = self._ipctk.TangentialCollisions()
            rubbing.build(self.mesh, self._start, self._build(self._start), self._potential, self.friction)
            if not rubbing.empty():
                self._rubbing = rubbing

    def _vertices(self, x: FloatArray) -> FloatArray:
        return np.asfortranarray(x[self.surface.nodes])

    def _search(self, start: FloatArray, end: FloatArray) -> Any:
        """Pairs that come near one another somewhere on the straight way between two positions."""
        self._candidates = self._ipctk.Candidates()
        # Boxes of both are inflated: together by the distance that is felt.
        self._candidates.build(self.mesh, start, end, 0.5 * (self.reach + self.offset), self._broad_phase)
        self._lowest, self._highest = np.minimum(start, end), np.maximum(start, end)
        return self._candidates

    def _free_part(self, start: FloatArray, end: FloatArray) -> float:
        closest = self.offset + _CLOSEST * self.reach
        candidates = self._search(start, end)
        return float(candidates.compute_collision_free_stepsize(self.mesh, start, end, closest, self._narrow_phase))

    def _build(self, vertices: FloatArray) -> Any:
        """Active collisions at a position; those of the last one are kept."""
        if self._collisions is not None and np.array_equal(self._at, vertices):
            return self._collisions
        held = self._candidates is not None and bool(
            np.all(vertices >= self._lowest) and np.all(vertices <= self._highest)
        )
        candidates = self._candidates if held else self._search(vertices, vertices)
        collisions = self._ipctk.NormalCollisions()
        collisions.use_area_weighting = True
        collisions.build(candidates, self.mesh, vertices, self.reach, self.offset)
        self._collisions, self._at = collisions, vertices
        return collisions

    def _can_be(self, vertices: FloatArray) -> bool:
        """Whether a position can be reached, and from then on counts as one that can be."""
        offset = vertices - self._from
        length = float(np.vdot(self._move, self._move))
        part = min(max(float(np.vdot(self._move, offset)) / length, 0.0), 1.0) if length > 0.0 else 0.0
        if np.abs(offset - part * self._move).max(initial=0.0) <= _ON_THE_WAY * np.abs(vertices).max(initial=0.0):
            return True
        if not np.isfinite(vertices).all():
            return False
        nearest = np.asfortranarray(self._from + part * self._move)
        for start in (nearest, self._start):
            if self._free_part(start, vertices) == 1.0:
                self._from, self._move = start, vertices - start
                return True
        return False

    def max_step(self, x: FloatArray, step: FloatArray) -> float:
        """Largest part in [0, 1] of a step that is free of collisions; the way is remembered as checked."""
        start, move = self._vertices(x), self._vertices(step)
        if not self._can_be(start):
            return 1.0  # the energy is infinite at `x` already
        longest = float(np.linalg.norm(move, axis=1).max(initial=0.0))
        size = float(np.linalg.norm(np.ptp(start, axis=0)))
        part = min(1.0, _LONGEST * size / longest) if longest > 0.0 else 1.0
        part *= self._free_part(start, np.asfortranarray(start + part * move))
        self._from, self._move = start, part * move
        return part

    # ------------------------------------------------------------------------------------------- the function

    def value(self, x: FloatArray) -> float:
        """Energy of the barrier and work of friction [J]; infinite where the way is not free."""
        vertices = self._vertices(x)
        if not self._can_be(vertices):
            return float("inf")
        energy = float(self._potential(self._build(vertices), self.mesh, vertices))
        if self._rubbing is not None:
            energy += float(self._friction_law(self._rubbing, self.mesh, self._slip(vertices)))
        return energy

    def _slip(self, vertices: FloatArray) -> FloatArray:
        return np.asfortranarray(vertices - self._start)

    def add_gradient(self, x: FloatArray, out: FloatArray) -> None:
        """Add the energy gradient [N] to `out` (n_local, dim); infinite where the way is not free."""
        vertices = self._vertices(x)
        if not self._can_be(vertices):
            out[self.surface.nodes] = np.inf
            return
        force = self._potential.gradient(self._build(vertices), self.mesh, vertices)
        if self._rubbing is not None:
            force = force + self._friction_law.gradient(self._rubbing, self.mesh, self._slip(vertices))
        out[self.surface.nodes] += force.reshape(vertices.shape)

    def hessian_blocks(self, x: FloatArray, project: bool) -> NodeBlocks:
        """Hessian [N/m], each contact's part clamped to positive semi-definite if `project`."""
        import scipy.sparse

        vertices = self._vertices(x)
        d = vertices.shape[1]
        kind = self._ipctk.PSDProjectionMethod
        chosen = kind.CLAMP if project else kind.NONE
        total = self._potential.hessian(self._build(vertices), self.mesh, vertices, chosen)
        if self._rubbing is not None:
            total = total + self._friction_law.hessian(self._rubbing, self.mesh, self._slip(vertices), chosen)
        # Symmetric: its columns are its rows.
        rows = scipy.sparse.csr_matrix((total.data, total.indices, total.indptr), shape=total.shape)
        blocks = rows.tobsr((d, d))
        blocks.sort_indices()
        row = np.repeat(np.arange(len(vertices)), np.diff(blocks.indptr))
        column = blocks.indices
        data = blocks.data.reshape(-1, d * d)
        upper, own = row < column, row == column
        nodes = self.surface.nodes  # increasing, so the order of the pairs stays
        return NodeBlocks(nodes[row[upper]], nodes[column[upper]], data[upper], nodes[row[own]], data[own])

    # --------------------------------------------------------------------------------------------- looking inside

    def smallest_distance(self, x: FloatArray) -> float:
        """Smallest distance of pairs that may touch, as far as it is below d_hat + d_min; infinite otherwise [m]."""
        vertices = self._vertices(x)
        collisions = self._build(vertices)
        if collisions.empty():
            return float("inf")
        return float(np.sqrt(collisions.compute_minimum_distance(self.mesh, vertices)))

    def intersects(self, x: FloatArray) -> bool:
        """Whether surfaces intersect at a position, by a test of its own that knows no way there."""
        return bool(self._ipctk.has_intersections(self.mesh, self._vertices(x)))

    def count(self, x: FloatArray) -> int:
        """Number of active collisions."""
        return len(self._build(self._vertices(x)))


def body_pairs(bodies: Sequence[str], self_contact: bool, between: Sequence[tuple[str, str]] | None) -> BoolArray:
    """Which bodies may touch which, (n, n) bool."""
    n = len(bodies)
    if between is None:
        allowed = np.ones((n, n), dtype=bool)
    else:
        allowed = np.zeros((n, n), dtype=bool)
        for first, second in between:
            i, j = bodies.index(first), bodies.index(second)
            allowed[i, j] = allowed[j, i] = True
    np.fill_diagonal(allowed, self_contact)
    return allowed
