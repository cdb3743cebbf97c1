"""The explicit step of material points whose surface is sampled: stored stencils, any further force at the nodes.

Slower than `mpm.explicit`, which it agrees with where there are no samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from femdeform.mpm import group_kernels as kernels
from femdeform.mpm.explicit_laws import Laws, Liquid, is_viscous, material_sets
from femdeform.mpm.grid import Grid
from femdeform.mpm.groups import Groups
from femdeform.mpm.particles import Particles
from femdeform.mpm.point_terms import PointMaterials
from femdeform.mpm.rigid_walls import RigidWall, constrain
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.types import FloatArray, IntArray

GroupTransfer = Literal["pic", "flip", "apic", "group_apic"]
Motion = Literal["field", "group"]


@dataclass(frozen=True)
class GroupStep:
    """What became of a step.

    Attributes
    ----------
    particles : Particles
        After the step.
    groups : Groups
        Of the points before it.
    mass, velocity : (n_nodes,), (n_nodes, dim) float64
        Of the nodes after the step [kg], [m/s].
    n_bounded : int
        Liquid points whose J was kept in [0.1, 10].
    """

    particles: Particles
    groups: Groups
    mass: FloatArray
    velocity: FloatArray
    n_bounded: int


def explicit_step(
    particles: Particles,
    laws: Laws,
    grid: Grid,
    dt: float,
    *,
    samples: SurfaceSamples | None = None,
    groups: Groups | None = None,
    forces: Callable[[Groups], FloatArray] | None = None,
    gravity: FloatArray | None = None,
    walls: Sequence[RigidWall] = (),
    time: float = 0.0,
    transfer: GroupTransfer = "apic",
    flip: float = 0.95,
    massless: bool = False,
    motion: Motion = "group",
    materials: PointMaterials | None = None,
) -> GroupStep:
    """Advance points by one symplectic Euler step.

    Parameters
    ----------
    particles : Particles
        Not changed.
    laws : mapping
        By ``(body, phase)``; see `ExplicitPoints`.
    grid : Grid
        With quadratic splines.
    dt : float
        [s].
    samples : SurfaceSamples, optional
        Of the surface of the points as they are.
    groups : Groups, optional
        Of the points and their samples, where they are at hand.
    forces : callable, optional
        Further forces at the nodes (n_nodes, dim) [N], of surface tension: ``-d(energy)/dy`` at the nodes of the
        groups' stencils, before they move.
    gravity : (dim,) array, optional
        [m/s^2].
    walls, time
        Walls, and the time at the beginning of the step [s].
    transfer : str
        ``pic``, ``flip``, ``apic``, or ``group_apic``, see `mpm.groups`.
    flip : float
        Part of FLIP in its blend with PIC [-].
    massless : bool
        Samples without mass, for comparison, see `mpm.groups`.
    motion : str
        See `advance`.
    materials : PointMaterials, optional
        Constants of each point, in place of those of the laws.
    """
    if groups is None:
        groups = Groups.split(particles.x, particles.mass, samples, grid, massless)
    is_affine = transfer in ("apic", "group_apic")
    affine = particles.affine if is_affine else np.zeros_like(particles.affine)
    mass, before = groups.to_grid(particles.v, affine, transfer == "group_apic")
    viscous = any(map(is_viscous, laws.values())) if materials is None else bool((materials.viscosity > 0.0).any())
    rates = groups.gradients(before) if viscous else None
    force = groups.forces(stresses(particles, laws, rates, materials))
    if forces is not None:
        force = force + forces(groups)
    velocity = before + dt * force / mass[:, None]
    if gravity is not None:
        velocity += dt * np.asarray(gravity)
    velocity = constrain(walls, groups.stencils.positions, velocity, time + dt, grid.spacing)
    after, n_bounded = advance(particles, laws, groups, velocity, dt, is_affine, motion)
    if transfer == "flip":
        kept = particles.v + groups.to_points(velocity - before)[0]
        after.v[:] = (1.0 - flip) * after.v + flip * kept
    return GroupStep(after, groups, mass, velocity, n_bounded)


def advance(
    particles: Particles,
    laws: Laws,
    groups: Groups,
    velocity: FloatArray,
    dt: float,
    is_affine: bool = True,
    motion: Motion = "group",
) -> tuple[Particles, int]:
    """Merge the groups and move and deform the points by velocities of the nodes, of whatever scheme they are.

    Parameters
    ----------
    particles, laws, dt
        See `explicit_step`.
    groups : Groups
        Of the points.
    velocity : (n_nodes, dim) float64
        Of the nodes [m/s].
    is_affine : bool
        Whether the transfer has affine velocities.
    motion : str
        ``field``: points move with the grid where they are (`Groups.displaced`), which is the motion that their J and F
        see; ``group``: with the mean over their group, as published. The two differ for points with samples.

    Returns
    -------
    particles : Particles
        New ones, with the velocities of the nodes.
    n_bounded : int
        Liquid points whose J was kept in its bounds.
    """
    v, affine = groups.to_points(velocity)
    x = particles.x + dt * v
    if motion == "field" and groups.owner.size > groups.n:
        x, affine = groups.displaced(velocity, v, affine, dt)
    out = replace(
        particles,
        x=x,
        v=v,
        affine=affine if is_affine else np.zeros_like(affine),
        J=particles.J.copy(),
        F=particles.F.copy(),
    )
    gradient = groups.gradients(velocity)
    kernel = kernels.deform_points_2d if particles.dim == 2 else kernels.deform_points_3d
    n_bounded = 0
    for rows, law in material_sets(particles, laws):
        bounded = np.zeros(rows.size, np.int64)
        kernel(out.J if isinstance(law, Liquid) else out.F, gradient, dt, law, rows, bounded)
        n_bounded += int(bounded.sum())
    return out, n_bounded


def stresses(
    particles: Particles,
    laws: Laws,
    gradient: FloatArray | None = None,
    materials: PointMaterials | None = None,
) -> FloatArray:
    """Kirchhoff stress times volume of each point [J]: (n, 6) as xx, yy, zz, yz, xz, xy, in 2D (n, 3) as xx, yy, xy.

    Parameters
    ----------
    particles, laws
        See `explicit_step`.
    gradient : (n, dim, dim) float64, optional
        Gradients of the velocity [1/s], for viscosity.
    materials : PointMaterials, optional
        Constants of each point, in place of those of the laws.
    """
    dim = particles.dim
    out = np.empty((particles.n, dim * (dim + 1) // 2))
    kernel = kernels.stresses_2d if dim == 2 else kernels.stresses_3d
    rates = np.zeros((1, dim, dim)) if gradient is None else gradient
    for rows, law in material_sets(particles, laws):
        state = particles.J if isinstance(law, Liquid) else particles.F
        parts = [] if materials is None else _parts(law, rows, materials, dim)
        if gradient is None and (any(is_viscous(part) for part, _ in parts) or (is_viscous(law) and not parts)):
            raise ValueError("viscosity needs the gradients of the velocity")
        if not parts:
            kernel(state, particles.volume, rates, law, rows, out)
            continue
        total = np.zeros((rows.size, out.shape[1]))
        for part, constants in parts:
            kernel(state, particles.volume, rates, part, rows, out)
            total += constants[:, None] * out[rows]
        out[rows] = total
    return out


def _parts(law: Any, rows: IntArray, materials: PointMaterials, dim: int) -> list[tuple[Any, FloatArray]]:
    """Laws with one constant of one each, and that constant at the points `rows`: stresses are their sum."""
    if isinstance(law, Liquid):
        viscosity = materials.viscosity[rows]
        friction = [(Liquid(0.0, 1.0), viscosity)] if viscosity.any() else []
        return [(Liquid(1.0, 0.0), materials.bulk_modulus[rows]), *friction]
    if materials.moduli is None or not np.isfinite(materials.moduli[rows]).all():
        return []  # a body whose solid keeps its constants
    shear, dilation = type(law).from_lame(1.0, 0.0, dim), type(law).from_lame(0.0, 1.0, dim)
    return [(shear, materials.moduli[rows, 0]), (dilation, materials.moduli[rows, 1])]
