"""Heat in material points: conservative transfer to a grid, implicit conduction, exchange at the surface.

    C_i (T_i' - T_i)/dt = - sum_p K V_p grad N_i . grad T' + sum_p N_i H V_p
                          - sum_r N_i(q_r) [h (T'(q_r) - Tbar) - b] |dA_r|

with heat capacities C, samples r of the surface, their areas |dA_r|, heat transfer h, ambient temperature Tbar, heating
b and sources H. One linear system a step, symmetric and positive definite, by conjugate gradients. Walls may keep the
nodes inside of them at a temperature (`mpm.heat_walls`).

References
----------
J. Chen, dissertation (2024), sections 3.1.3, 3.2.2 and 3.2.3.2; docs/methods/mpm-heat.md says what is different here.

Limitations
-----------
Backward Euler, first order in time. Capacities and conductivities are those at the start of the step. There is no
maximum principle: the transfer extrapolates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.mpm import heat_kernels as kernels
from femdeform.mpm.grid import Grid, Stencils
from femdeform.mpm.heat_matrix import ConductionMatrix
from femdeform.mpm.heat_walls import TemperedWall, hold_temperatures
from femdeform.mpm.particles import Particles, current_volumes
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.types import FloatArray, IntArray

# A number, one number for each sample or material point, or a function of positions (n, dim) [m] and the time [s].
Field = float | FloatArray | Callable[[FloatArray, float], Any]

# Where the exchange of a sample acts: at its owner; at the sample, as in the dissertation; at the hull of the points.
QUADRATURES = ("owner", "literal", "shifted")


@dataclass(frozen=True)
class HeatBoundary:
    """What enters through the surface: ``transfer (ambient - T) + flux`` [W/m^2].

    Attributes
    ----------
    transfer : Field
        Heat transfer coefficient [W/(m^2 K)].
    ambient : Field
        Ambient temperature [K].
    flux : Field
        Heating whatever the temperature [W/m^2].
    """

    transfer: Field = 0.0
    ambient: Field = 0.0
    flux: Field = 0.0


@dataclass(frozen=True)
class HeatReport:
    """What a step of conduction did; ``stored = dt (boundary_power + source_power + wall_power - lost_power)``.

    Attributes
    ----------
    converged : bool
        Whether the linear solve reached its tolerance; if not, nothing was changed.
    iterations : int
        Conjugate gradients.
    residual : float
        Residual over the first one, both in the norm of the diagonal's inverse [-].
    stored : float
        Change of the sum of C_p T_p [J]; in 2D [J/m], as all others.
    boundary_power, source_power : float
        Heat through the surface and from sources [W].
    lost_power : float
        Flux onto grid nodes without mass, which goes nowhere (``literal`` only) [W].
    wall_power : float
        Heat from walls that keep a temperature [W].
    """

    converged: bool
    iterations: int
    residual: float
    stored: float
    boundary_power: float
    source_power: float
    lost_power: float
    wall_power: float = 0.0


def evaluate(field: Field, points: FloatArray, time: float, name: str) -> FloatArray:
    """Values (n,) of a field at positions (n, dim) [m] and a time [s].

    Raises
    ------
    ValueError
        If there are not as many values as positions, or one is not finite.
    """
    values = np.asarray(field(points, time) if callable(field) else field, dtype=np.float64)
    if values.ndim == 0:
        values = np.full(len(points), float(values))
    if values.shape != (len(points),):
        raise ValueError(f"{name}: values of shape {values.shape} for {len(points)} positions")
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: a value is not finite")
    return values


def _sums(numbers: IntArray, values: FloatArray, n: int) -> FloatArray:
    """Sums (n,) of the values of each number."""
    return np.asarray(np.bincount(numbers, values, n), dtype=np.float64)


@dataclass(frozen=True)
class _Carriers:
    """Points that carry the heat of material points to the grid, and points where it is exchanged.

    Attributes
    ----------
    points : (n, dim)
        Positions: carriers first, then places of exchange that are no carriers.
    owner : (n_carriers,)
        Material point of each carrier.
    share : (n_carriers,)
        Part of its mass and volume.
    place : (n_samples,)
        Point at which each sample exchanges heat.
    """

    points: FloatArray
    owner: IntArray
    share: FloatArray
    place: IntArray


class HeatConduction:
    """Steps of conduction on the grid.

    Parameters
    ----------
    grid : Grid
        With quadratic splines.
    quadrature : str
        Where samples exchange heat. ``owner``: at the material point each belongs to. ``literal``: at the sample, half
        a cell outside of all mass, as the dissertation has it; nodes there insulate the body. ``shifted``: at
        ``s - offset n``, the mass spread over point, samples and their mirror images as in the transfer of momentum.
    offset : float, optional
        Of ``shifted`` [m]: the radius of the level set less half the distance of points.
    tolerance : float
        Reduction of the residual by the linear solve [-].
    max_iterations : int
        Conjugate gradients at most.
    """

    def __init__(
        self,
        grid: Grid,
        quadrature: str = "owner",
        offset: float | None = None,
        tolerance: float = 1e-10,
        max_iterations: int = 2000,
    ) -> None:
        if grid.degree != 2:
            raise ValueError("conduction needs quadratic splines")
        if quadrature not in QUADRATURES:
            raise ValueError(f"quadrature {quadrature!r} is none of {', '.join(QUADRATURES)}")
        if (offset is None) == (quadrature == "shifted"):
            raise ValueError("an offset belongs to the quadrature 'shifted', and to no other")
        self.grid, self.quadrature = grid, quadrature
        self.offset = 0.0 if offset is None else offset
        self.tolerance, self.max_iterations = tolerance, max_iterations

    def step(
        self,
        particles: Particles,
        samples: SurfaceSamples | None,
        dt: float,
        time: float,
        capacity: float | FloatArray,
        conductivity: float | FloatArray,
        boundary: HeatBoundary | None = None,
        source: Field = 0.0,
        area_scale: float | FloatArray = 1.0,
        stencils: Stencils | None = None,
        walls: Sequence[TemperedWall] = (),
    ) -> HeatReport:
        """Move the temperatures of material points and their gradients on by a time step.

        Parameters
        ----------
        particles : Particles
            Temperatures and gradients are replaced; positions stay.
        samples : SurfaceSamples, optional
            Of the surface; none where nothing goes through it.
        dt, time : float
            Time step, and the time at its end, at which fields are evaluated [s].
        capacity : float or (n,) float64
            Specific heat [J/(kg K)], positive.
        conductivity : float or (n,) float64
            [W/(m K)], not negative.
        boundary : HeatBoundary, optional
            At the samples; default nothing.
        source : Field
            H at the material points [W/m^3].
        area_scale : float or (n_samples,) float64
            Factor of the samples' areas, for the hull of a body where the contour outside it is known to be larger.
        stencils : Stencils, optional
            Of the material points, where they are at hand; only for the quadrature ``owner``.
        walls : sequence of TemperedWall
            Those that have a temperature keep the nodes inside of them at it.

        Raises
        ------
        ValueError
            If a coefficient is out of range or not finite, or has the wrong number of values.
        """
        n = particles.n
        heat_capacity = particles.mass * evaluate(capacity, particles.x, time, "capacity")
        volumes = current_volumes(particles)
        conduction = evaluate(conductivity, particles.x, time, "conductivity") * volumes
        if not dt > 0.0:
            raise ValueError(f"a time step of {dt} s is not positive")
        if not np.all(heat_capacity > 0.0):
            raise ValueError("a heat capacity is not positive")
        if not np.all(conduction >= 0.0):
            raise ValueError("a conductivity or a volume is negative")
        sources = evaluate(source, particles.x, time, "source") * volumes
        carriers = self._carriers(particles, samples)
        # Stencils cover carriers and places of exchange; the latter have no mass, volume or source.
        extra = len(carriers.points) - carriers.owner.size

        def carried(values: FloatArray) -> FloatArray:
            return np.concatenate([carriers.share * values[carriers.owner], np.zeros(extra)])

        transfer, flux, ambient = self._exchange(samples, boundary, time, area_scale)
        exchange = _sums(carriers.place, transfer, len(carriers.points))
        entering = _sums(carriers.place, transfer * ambient + flux, len(carriers.points))
        if stencils is None or carriers.points is not particles.x:
            stencils = self.grid.stencils(carriers.points)
        C, T = self._to_nodes(stencils, particles, carriers, carried(heat_capacity), samples)
        matrix = ConductionMatrix(stencils, carried(conduction), exchange, C / dt)
        load = stencils.to_nodes((carried(sources) + entering)[:, None])[:, 0]
        # A row of zeros: neither mass nor exchange. What flux puts there is lost.
        is_held = matrix.own > 0.0
        lost = float(load[~is_held].sum())
        kept = hold_temperatures(walls, stencils.positions, self.grid.spacing, is_held, time)
        start = None
        if kept is not None:
            start = np.zeros_like(T)
            start[kept.nodes] = kept.constant + kept.slope @ T - T[kept.nodes]
        b = np.where(is_held, load - matrix.times(T, without_inertia=True), 0.0)
        size = float(np.sqrt(np.einsum("i,i,i->", T, matrix.own, T)))
        change, iterations, residual, converged = matrix.solve(
            b, size, self.tolerance, self.max_iterations, start, kept
        )
        if not converged:
            return HeatReport(False, iterations, residual, 0.0, 0.0, 0.0, 0.0)
        wall_power = 0.0 if kept is None else float((matrix.times(change) - b).sum())
        T = T + change
        values, gradients = np.empty(len(carriers.points)), np.empty(carriers.points.shape)
        kernels.temperature_to_points(T, stencils.nodes, stencils.weights, stencils.gradients, values, gradients)
        at_samples = values[carriers.place]
        particles.temperature = _sums(carriers.owner, carriers.share * values[: carriers.owner.size], n)
        particles.temperature_gradient = gradients[:n].copy()
        return HeatReport(
            True,
            iterations,
            residual,
            float(np.einsum("i,i->", C, change)),
            float((transfer * (ambient - at_samples) + flux).sum()),
            float(sources.sum()),
            lost,
            wall_power,
        )

    def _carriers(self, particles: Particles, samples: SurfaceSamples | None) -> _Carriers:
        everyone, whole = np.arange(particles.n), np.ones(particles.n)
        if samples is None:
            return _Carriers(particles.x, everyone, whole, np.empty(0, dtype=np.int64))
        if self.quadrature == "owner":
            return _Carriers(particles.x, everyone, whole, samples.owner)
        at = samples.points - self.offset * samples.normals
        if self.quadrature == "literal":
            place = particles.n + np.arange(samples.n)
            return _Carriers(np.concatenate([particles.x, at]), everyone, whole, place)
        mirrored = 2.0 * particles.x[samples.owner] - samples.points
        owner = np.concatenate([everyone, samples.owner, samples.owner])
        share = 1.0 / (2.0 * np.bincount(samples.owner, minlength=particles.n) + 1.0)
        place = owner.size + np.arange(samples.n)
        return _Carriers(np.concatenate([particles.x, samples.points, mirrored, at]), owner, share[owner], place)

    @staticmethod
    def _exchange(
        samples: SurfaceSamples | None, boundary: HeatBoundary | None, time: float, area_scale: float | FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Heat transfer [W/K], flux [W] and ambient temperature [K] of each sample."""
        if samples is None:
            return np.empty(0), np.empty(0), np.empty(0)
        boundary = HeatBoundary() if boundary is None else boundary
        area = area_scale * samples.measure
        transfer = evaluate(boundary.transfer, samples.points, time, "heat transfer")
        if not np.all(transfer >= 0.0):
            raise ValueError("a heat transfer coefficient is negative")
        flux = evaluate(boundary.flux, samples.points, time, "flux")
        return transfer * area, flux * area, evaluate(boundary.ambient, samples.points, time, "ambient temperature")

    @staticmethod
    def _to_nodes(
        stencils: Stencils,
        particles: Particles,
        carriers: _Carriers,
        capacity: FloatArray,
        samples: SurfaceSamples | None,
    ) -> tuple[FloatArray, FloatArray]:
        """Heat capacities [J/K] and temperatures [K] of the nodes; those without capacity take the samples' owners'."""
        owner = carriers.owner
        if samples is not None:
            # Beyond the carriers there are the samples' places, in their order, or nothing.
            owner = np.concatenate([owner, samples.owner])[: len(carriers.points)]
        x, gradient = particles.x[owner], particles.temperature_gradient[owner]
        temperature = particles.temperature[owner] + np.einsum("ka,ka->k", gradient, carriers.points - x)
        C, T = np.empty(stencils.n_nodes), np.empty(stencils.n_nodes)
        kernels.temperature_to_nodes(
            carriers.points,
            capacity,
            temperature,
            np.ascontiguousarray(gradient),
            stencils.weights,
            stencils.offsets,
            stencils.entries,
            stencils.positions,
            C,
            T,
        )
        bare = C == 0.0
        if bare.any():
            both = stencils.to_nodes(np.stack([np.ones(owner.size), particles.temperature[owner]], axis=1))
            T[bare] = both[bare, 1] / both[bare, 0]
        return C, T
