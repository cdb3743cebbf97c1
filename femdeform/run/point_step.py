"""One step of material points: surface, heat, transfer, forces or a solve, transfer back, change of phase."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from femdeform.errors import InputError
from femdeform.mpm.crowding import uncrowded
from femdeform.mpm.crushed_points import count_crushed
from femdeform.mpm.explicit import ExplicitPoints
from femdeform.mpm.explicit_laws import Laws
from femdeform.mpm.grid import Grid, Stencils
from femdeform.mpm.group_step import advance, explicit_step
from femdeform.mpm.groups import Groups
from femdeform.mpm.heat import HeatConduction, HeatReport
from femdeform.mpm.implicit_step import solve_step
from femdeform.mpm.node_walls import NodeWall
from femdeform.mpm.particles import Particles
from femdeform.mpm.phase_change import change_phase
from femdeform.mpm.point_potential import PointPotential
from femdeform.mpm.point_terms import SurfaceTension
from femdeform.mpm.rigid_walls import RigidWall
from femdeform.mpm.surface_coefficient import surface_coefficients, wall_distance
from femdeform.mpm.surface_forces import surface_forces
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.mpm.surface_sampling import SurfaceSampler
from femdeform.run.heated_places import heat_boundary, heat_source
from femdeform.run.hull_areas import area_scales
from femdeform.run.point_setup import Materials, make_materials, make_points, make_walls
from femdeform.scene.point_schema import PointScene
from femdeform.step_problem import IterationObserver, StepSolver
from femdeform.types import FloatArray, Mesh

# Cells of the grid that a point may move by in a step that is accepted.
_CELLS = 1.0


@dataclass(frozen=True)
class PointReport:
    """What became of a step; see `femdeform.run.time_loop.StepReport`.

    Attributes
    ----------
    accepted : bool
    reason : str
    iterations, linear_iterations : int
        Of Newton and inside of it; zero for explicit steps.
    residual_norm, relative_residual : float
        [N], [-].
    n_nodes, n_samples : int
        Active nodes (0 for the fast explicit step) and samples of the surface.
    n_bounded : int
        Liquid points whose J was kept in its bounds.
    n_melted, n_frozen : int
    heat : HeatReport, optional
    surface_area, surface_energy : float
        Of the sampled surface at the beginning of the step [m^2], [J].
    """

    accepted: bool
    reason: str
    iterations: int = 0
    linear_iterations: int = 0
    residual_norm: float = 0.0
    relative_residual: float = 0.0
    n_nodes: int = 0
    n_samples: int = 0
    n_bounded: int = 0
    n_melted: int = 0
    n_frozen: int = 0
    heat: HeatReport | None = None
    surface_area: float = 0.0
    surface_energy: float = 0.0


@dataclass(frozen=True)
class _Surface:
    """Samples of the surface and their tension [N/m]."""

    samples: SurfaceSamples
    k: FloatArray


class PointStep:
    """Takes steps of a scene.

    Parameters
    ----------
    scene : PointScene
    meshes : mapping of str to Mesh
        Of bodies and walls.
    solver : StepSolver, optional
        For implicit steps.
    comm : mpi4py communicator or None
        Ranks that share the grid solve out among them; all else every one of them does for all points.
    start : Particles, optional
        All points at the start of the run, where they are at hand.
    """

    def __init__(
        self,
        scene: PointScene,
        meshes: Mapping[str, Mesh],
        solver: StepSolver | None,
        comm: Any | None = None,
        start: Particles | None = None,
    ) -> None:
        self.scene = scene
        self.materials: Materials = make_materials(scene)
        self.walls: list[RigidWall] = make_walls(scene, meshes)
        self._tempered = [wall for wall in self.walls if wall.temperature is not None]
        self._solver = solver
        self._grid = Grid(scene.grid.cell_size, "quadratic")
        self._low, self._high = np.array(scene.grid.low), np.array(scene.grid.high)
        self._gravity = np.zeros(scene.dim) if scene.gravity is None else np.array(scene.gravity)
        self._potential = PointPotential(self._gravity, scene.surface.symmetric, comm)
        self.has_tension = any(tension is not None for tension in self.materials.tensions)
        self.has_heat = self.materials.heat is not None
        exchanges = any(
            body.heat is not None and (body.heat.transfer or body.heat.flux) for body in scene.bodies.values()
        )
        self._samples_surface = self.has_tension or exchanges
        surface = scene.surface
        self._massless = surface.comparison == "massless_samples"
        self._sampler = SurfaceSampler(scene.grid.cell_size, surface.density, surface.radius, surface.seed)
        heat = scene.heat
        offset = None
        if heat.quadrature == "shifted":
            per_axis = max(body.points_per_axis for body in scene.bodies.values())
            radius = surface.radius if surface.radius is not None else (0.73 if scene.dim == 2 else 0.867)
            offset = (radius - 0.5 / per_axis) * scene.grid.cell_size
        self._heat = HeatConduction(self._grid, heat.quadrature, offset, heat.tolerance)
        # Of each body; only what exchanges heat asks for it.
        self._area_scales = np.ones(len(scene.bodies))
        if exchanges:
            self._area_scales = area_scales(scene, meshes, make_points(scene, meshes) if start is None else start)
        # Without surface and heat explicit steps go through blocks of nodes, which is many times as fast.
        needs_stencils = self._samples_surface or self.has_heat or self.materials.varies or surface.crowding > 0.0
        needs_stencils = needs_stencils or scene.transfer.scheme == "group_apic"
        self._is_fast = scene.time.scheme == "explicit" and not needs_stencils
        self._owners_exchange = self.has_heat and heat.quadrature == "owner"
        self._engine: ExplicitPoints | None = None
        self._engine_step = -1

    def take(
        self, particles: Particles, time: float, step: int, dt: float, observe: IterationObserver | None
    ) -> tuple[Particles, PointReport]:
        """Try a step from points that stay as they are."""
        if self._is_fast:
            return self._fast(particles, time, step, dt)
        points = replace(
            particles,
            temperature=particles.temperature.copy(),
            temperature_gradient=particles.temperature_gradient.copy(),
        )
        try:
            surface = self._surface(points, time, step)
        except ValueError as error:
            return particles, PointReport(False, str(error))
        # Samples without tension are there for the heat only.
        tense = surface if self.has_tension else None
        samples = None if tense is None else tense.samples
        groups = Groups.split(points.x, points.mass, samples, self._grid, self._massless)
        crowding = self.scene.surface.crowding
        own = groups.stencils.of_first(points.n) if crowding > 0.0 or self._owners_exchange else None
        if own is not None and crowding > 0.0:
            points.J = uncrowded(points, own, crowding)
        heat = None
        if self.has_heat:
            try:
                heat = self._conduct(points, surface, own if self._owners_exchange else None, time, dt)
            except ValueError as error:
                return particles, PointReport(False, str(error))
            if not heat.converged:
                return particles, PointReport(False, "the conduction of heat did not converge", heat=heat)
        if self.scene.time.scheme == "explicit":
            new, report = self._explicit(points, tense, groups, time, dt)
        else:
            new, report = self._implicit(points, tense, groups, time, dt, observe)
        report = replace(report, heat=heat)
        if surface is not None:
            area = float(surface.samples.measure.sum())
            energy = float(surface.k @ surface.samples.measure)
            report = replace(report, n_samples=surface.samples.n, surface_area=area, surface_energy=energy)
        if not report.accepted:
            return particles, report
        return self._after(particles, new, report)

    # ------------------------------------------------------------------------------------------------- parts

    def _surface(self, points: Particles, time: float, step: int) -> _Surface | None:
        if not self._samples_surface:
            return None
        samples = self._sampler.sample(points.x, step)
        k = np.zeros(samples.n)
        if self.has_tension:
            distance = wall_distance(self.walls, samples.points, time)
            k = surface_coefficients(samples, points, self.materials.tensions, distance).k
        return _Surface(samples, k)

    def _conduct(
        self, points: Particles, surface: _Surface | None, stencils: Stencils | None, time: float, dt: float
    ) -> HeatReport:
        """Move temperatures on, latent heat included; `stencils` are those of the points where they are at hand."""
        materials = self.materials
        before = points.temperature.copy()
        capacity = materials.capacities(points)
        boundary = None
        samples = None
        if surface is not None:
            samples = surface.samples
            covered = wall_distance(self.walls, samples.points, time) < 0.0
            boundary = heat_boundary(self.scene, points, samples, covered)
        report = self._heat.step(
            points,
            samples,
            dt,
            time + dt,
            capacity,
            materials.conductivities(points),
            boundary,
            heat_source(self.scene, points),
            1.0 if samples is None else self._area_scales[points.body[samples.owner]],
            stencils,
            self._tempered,
        )
        if report.converged:
            materials.recover_temperatures(points, before, capacity)
        return report

    def _explicit(
        self, points: Particles, tense: _Surface | None, groups: Groups, time: float, dt: float
    ) -> tuple[Particles, PointReport]:
        scene = self.scene
        done = explicit_step(
            points,
            self.materials.laws,
            self._grid,
            dt,
            groups=groups,
            forces=None if tense is None else lambda groups: surface_forces(groups, tense.samples, tense.k),
            gravity=self._gravity,
            walls=self.walls,
            time=time,
            transfer=scene.transfer.scheme,
            flip=scene.transfer.flip,
            motion=scene.surface.motion,
            materials=self.materials.at(points) if self.materials.varies else None,
        )
        return done.particles, PointReport(True, "", n_nodes=done.mass.size, n_bounded=done.n_bounded)

    def _implicit(
        self,
        points: Particles,
        tense: _Surface | None,
        groups: Groups,
        time: float,
        dt: float,
        observe: IterationObserver | None,
    ) -> tuple[Particles, PointReport]:
        scene = self.scene
        assert self._solver is not None
        is_affine = scene.transfer.scheme in ("apic", "group_apic")
        affine = points.affine if is_affine else np.zeros_like(points.affine)
        mass, velocity = groups.to_grid(points.v, affine, scene.transfer.scheme == "group_apic")
        positions = groups.stencils.positions
        self._potential.begin_step(
            groups.stencils,
            mass,
            velocity,
            points,
            self.materials.at(points),
            dt,
            None if tense is None else SurfaceTension(tense.samples, tense.k),
            [
                NodeWall(
                    *wall.node_distance(positions, time + dt, scene.grid.cell_size),
                    np.broadcast_to(wall.velocity, positions.shape),
                    wall.kind,
                    wall.friction,
                )
                for wall in self.walls
            ],
        )
        solution = solve_step(self._potential, self._solver, scene.solver.tolerance, observe)
        report = PointReport(
            solution.converged,
            solution.reason,
            solution.iterations,
            solution.linear_iterations,
            solution.residual_norm,
            solution.relative_residual,
            mass.size,
        )
        if not report.accepted:
            return points, report
        new, n_bounded = advance(
            points, self.materials.laws, groups, solution.velocity, dt, is_affine, scene.surface.motion
        )
        if scene.transfer.scheme == "flip":
            kept = points.v + groups.to_points(solution.velocity - velocity)[0]
            new.v[:] = (1.0 - scene.transfer.flip) * new.v + scene.transfer.flip * kept
        return new, replace(report, n_bounded=n_bounded)

    def _after(self, old: Particles, new: Particles, report: PointReport) -> tuple[Particles, PointReport]:
        """Refuse points that are nowhere, have jumped over cells, or are crushed; melt and freeze."""
        if not (np.isfinite(new.x).all() and np.isfinite(new.v).all()):
            return new, replace(report, accepted=False, reason="positions or velocities are not finite")
        # Grid nodes that a point does not come close to cannot stop it: walls and bodies would be jumped over.
        motion = new.x - old.x
        cells = float(np.sqrt(np.einsum("pa,pa->p", motion, motion).max(initial=0.0))) / self._grid.spacing
        if cells > _CELLS:
            return new, replace(report, accepted=False, reason=f"a point moved by {cells:.3g} cells in one step")
        crushed = count_crushed(old, new)
        if crushed:
            reason = f"{crushed} solid points shrink to a tenth of their volume, or are turned inside out, in one step"
            return new, replace(report, accepted=False, reason=reason)
        outside = np.count_nonzero(((new.x < self._low) | (new.x > self._high)).any(axis=1))
        if outside:
            return new, replace(
                report, accepted=False, reason=f"{outside} points have left the domain (grid.low, high)"
            )
        melted = frozen = 0
        if any(melting is not None for melting in self.materials.melting):
            new = replace(new, phase=new.phase.copy())
            for number, melting in enumerate(self.materials.melting):
                if melting is not None:
                    counts = change_phase(new, melting, new.body == number)
                    melted, frozen = melted + counts[0], frozen + counts[1]
        return new, replace(report, n_melted=melted, n_frozen=frozen)

    # ------------------------------------------------------------------------------------- the fast explicit step

    def _fast(self, particles: Particles, time: float, step: int, dt: float) -> tuple[Particles, PointReport]:
        scene = self.scene
        if self._engine is None or self._engine_step != step:
            self._engine = ExplicitPoints(
                particles,
                self.materials.laws,
                scene.grid.cell_size,
                self._low,
                self._high,
                transfer=scene.transfer.scheme if scene.transfer.scheme != "group_apic" else "apic",
                flip=scene.transfer.flip,
                gravity=self._gravity,
                walls=self.walls,
            )
        engine = self._engine
        engine.time = time
        bounded = engine.n_bounded
        self._engine_step = -1
        try:
            engine.step(dt)
        except InputError as error:
            return particles, PointReport(False, str(error))
        report = PointReport(True, "", n_bounded=engine.n_bounded - bounded)
        new, report = self._after(particles, engine.particles(), report)
        if report.accepted:
            self._engine_step = step + 1
        return new, report

    def reset(self) -> None:
        """Let the next step depend on its points alone."""
        self._engine = None
        if self._solver is not None:
            self._solver.reset()


def law_densities(laws: Laws, scene: PointScene) -> list[tuple[Any, float]]:
    """Laws with the densities of their phases, for `femdeform.mpm.time_step.explicit_limit`."""
    found = []
    for (number, _), law in laws.items():
        body = list(scene.bodies.values())[number]
        found.append((law, body.density))
    return found
