"""Kernels of a sweep over nodes: what the cells of a law add to a node's force and matrix, and how far a step may go.

Positions are flat with three components a node also in 2D, so that one kernel moves nodes in both. The accumulator
holds nine numbers a node: the force (3) and the matrix (00, 11, 22, 12, 02, 01). Nodes of one colour share no cell:
each thread reads positions that nobody moves and writes to its own nodes, so the result does not depend on the number
of threads.
"""

from __future__ import annotations

from typing import Any

from numba.extending import overload

from femdeform.jit import njit, prange
from femdeform.materials.dispatch import energy_density, pk1
from solvers.position_based.constraints import ROTATED, rotation, stress
from solvers.position_based.gathered_corners import gathered_visit, is_stored
from solvers.position_based.nodal_blocks import apply_2d, apply_3d, nodal_block


@njit
def deformation_3d(x: Any, i: Any, others: Any, gradients: Any, v: Any) -> Any:
    """F of the cell of visit v from the positions, and the gradient of the node's shape function."""
    j, k, base = others[0, v], others[1, v], others[2, v]
    b0, b1, b2 = x[base], x[base + 1], x[base + 2]
    e0, e1, e2 = x[i] - b0, x[i + 1] - b1, x[i + 2] - b2
    p0, p1, p2 = x[j] - b0, x[j + 1] - b1, x[j + 2] - b2
    q0, q1, q2 = x[k] - b0, x[k + 1] - b1, x[k + 2] - b2
    n0, n1, n2 = gradients[0, v], gradients[1, v], gradients[2, v]
    g0, g1, g2 = gradients[3, v], gradients[4, v], gradients[5, v]
    h0, h1, h2 = gradients[6, v], gradients[7, v], gradients[8, v]
    F = (
        e0 * n0 + p0 * g0 + q0 * h0,
        e0 * n1 + p0 * g1 + q0 * h1,
        e0 * n2 + p0 * g2 + q0 * h2,
        e1 * n0 + p1 * g0 + q1 * h0,
        e1 * n1 + p1 * g1 + q1 * h1,
        e1 * n2 + p1 * g2 + q1 * h2,
        e2 * n0 + p2 * g0 + q2 * h0,
        e2 * n1 + p2 * g1 + q2 * h1,
        e2 * n2 + p2 * g2 + q2 * h2,
    )
    return F, (n0, n1, n2)


@njit
def deformation_2d(x: Any, i: Any, others: Any, gradients: Any, v: Any) -> Any:
    """See `deformation_3d`."""
    j, base = others[0, v], others[1, v]
    e0, e1 = x[i] - x[base], x[i + 1] - x[base + 1]
    p0, p1 = x[j] - x[base], x[j + 1] - x[base + 1]
    n0, n1 = gradients[0, v], gradients[1, v]
    g0, g1 = gradients[2, v], gradients[3, v]
    return (e0 * n0 + p0 * g0, e0 * n1 + p0 * g1, e1 * n0 + p1 * g0, e1 * n1 + p1 * g1), (n0, n1)


def visit_deformation(x: Any, i: Any, others: Any, gradients: Any, v: Any, dim: Any) -> Any:
    """F of the cell of visit v and the gradient of the node's shape function, from the positions or as it is stored."""
    raise NotImplementedError("compiled code only")


@overload(visit_deformation)
def _visit_deformation(x: Any, i: Any, others: Any, gradients: Any, v: Any, dim: Any) -> Any:
    def spatial(x: Any, i: Any, others: Any, gradients: Any, v: Any, dim: Any) -> Any:
        return deformation_3d(x, i, others, gradients, v)

    def planar(x: Any, i: Any, others: Any, gradients: Any, v: Any, dim: Any) -> Any:
        return deformation_2d(x, i, others, gradients, v)

    if is_stored(others):
        return gathered_visit(len(dim))
    return spatial if len(dim) == 3 else planar


def visit_stress(F: Any, law: Any) -> Any:
    """`pk1`, by the fast rotation of the law where it has one."""
    raise NotImplementedError("compiled code only")


@overload(visit_stress)
def _visit_stress(F: Any, law: Any) -> Any:
    def rotated(F: Any, law: Any) -> Any:
        return stress(F, rotation(F), law)

    def any_law(F: Any, law: Any) -> Any:
        return pk1(F, law)

    return rotated if law.instance_class in ROTATED and len(F) == 9 else any_law


def node_terms(
    x: Any, i: Any, first: Any, last: Any, others: Any, gradients: Any, volumes: Any, law: Any, dim: Any
) -> Any:
    """Force [N] and matrix [N/m] that the visits from first to last give the node at flat place i, nine numbers."""
    raise NotImplementedError("compiled code only")


@overload(node_terms, inline="never")
def _node_terms(
    x: Any, i: Any, first: Any, last: Any, others: Any, gradients: Any, volumes: Any, law: Any, dim: Any
) -> Any:
    def spatial(
        x: Any, i: Any, first: Any, last: Any, others: Any, gradients: Any, volumes: Any, law: Any, dim: Any
    ) -> Any:
        zero = x[i] - x[i]
        f0 = f1 = f2 = zero
        a0 = a1 = a2 = a3 = a4 = a5 = zero
        for v in range(first, last):
            F, n = visit_deformation(x, i, others, gradients, v, dim)
            V = volumes[v]
            t = apply_3d(visit_stress(F, law), n)
            A = nodal_block(F, n, law)
            f0 -= V * t[0]
            f1 -= V * t[1]
            f2 -= V * t[2]
            a0 += V * A[0]
            a1 += V * A[1]
            a2 += V * A[2]
            a3 += V * A[3]
            a4 += V * A[4]
            a5 += V * A[5]
        return (f0, f1, f2, a0, a1, a2, a3, a4, a5)

    def planar(
        x: Any, i: Any, first: Any, last: Any, others: Any, gradients: Any, volumes: Any, law: Any, dim: Any
    ) -> Any:
        zero = x[i] - x[i]
        f0 = f1 = a0 = a1 = a5 = zero
        for v in range(first, last):
            F, n = visit_deformation(x, i, others, gradients, v, dim)
            V = volumes[v]
            t = apply_2d(visit_stress(F, law), n)
            A = nodal_block(F, n, law)
            f0 -= V * t[0]
            f1 -= V * t[1]
            a0 += V * A[0]
            a1 += V * A[1]
            a5 += V * A[2]
        # No cell resists across the plane, and nothing pushes there.
        return (f0, f1, zero, a0, a1, a0 + a1, zero, zero, a5)

    return spatial if len(dim) == 3 else planar


@njit
def add_terms(terms: Any, acc: Any, place: Any) -> None:
    """Add nine numbers to a node's row of the accumulator."""
    acc[place] += terms[0]
    acc[place + 1] += terms[1]
    acc[place + 2] += terms[2]
    acc[place + 3] += terms[3]
    acc[place + 4] += terms[4]
    acc[place + 5] += terms[5]
    acc[place + 6] += terms[6]
    acc[place + 7] += terms[7]
    acc[place + 8] += terms[8]


@njit(parallel=True)
def add_cells(
    chunks: Any,
    nodes: Any,
    offsets: Any,
    others: Any,
    gradients: Any,
    volumes: Any,
    law: Any,
    dim: Any,
    x: Any,
    acc: Any,
) -> None:
    """Add forces and matrices of the nodes of one colour from the cells of one law, any law.

    Parameters
    ----------
    chunks : (n_chunks + 1,) int64
        Rows at which pieces of work begin.
    nodes, offsets, others, gradients, volumes
        See `layout.Visits`.
    law : NamedTuple
        In the precision of the arrays.
    dim : tuple
        Its length is the dimension.
    x : (3 n_nodes,)
        Positions [m].
    acc : (9 n_nodes,)
        Added to.
    """
    for c in prange(chunks.size - 1):
        for r in range(chunks[c], chunks[c + 1]):
            i = nodes[r]
            terms = node_terms(x, 3 * i, offsets[r], offsets[r + 1], others, gradients, volumes, law, dim)
            add_terms(terms, acc, 9 * i)


# ---------------------------------------------------------------------------------------- steps that may be too long


def visit_energies(
    x: Any, i: Any, s: Any, first: Any, last: Any, others: Any, gradients: Any, volumes: Any, law: Any, dim: Any
) -> Any:
    """Energies of a node's cells when it has moved by s [J]: their sum, and the sum of their sizes."""
    raise NotImplementedError("compiled code only")


@overload(visit_energies, inline="never")
def _visit_energies(
    x: Any, i: Any, s: Any, first: Any, last: Any, others: Any, gradients: Any, volumes: Any, law: Any, dim: Any
) -> Any:
    def spatial(
        x: Any, i: Any, s: Any, first: Any, last: Any, others: Any, gradients: Any, volumes: Any, law: Any, dim: Any
    ) -> Any:
        energy = size = 0.0
        for v in range(first, last):
            F, n = visit_deformation(x, i, others, gradients, v, dim)
            moved = (
                F[0] + s[0] * n[0],
                F[1] + s[0] * n[1],
                F[2] + s[0] * n[2],
                F[3] + s[1] * n[0],
                F[4] + s[1] * n[1],
                F[5] + s[1] * n[2],
                F[6] + s[2] * n[0],
                F[7] + s[2] * n[1],
                F[8] + s[2] * n[2],
            )
            part = volumes[v] * energy_density(moved, law)
            energy += part
            size += abs(part)
        return energy, size

    def planar(
        x: Any, i: Any, s: Any, first: Any, last: Any, others: Any, gradients: Any, volumes: Any, law: Any, dim: Any
    ) -> Any:
        energy = size = 0.0
        for v in range(first, last):
            F, n = visit_deformation(x, i, others, gradients, v, dim)
            moved = (F[0] + s[0] * n[0], F[1] + s[0] * n[1], F[2] + s[1] * n[0], F[3] + s[1] * n[1])
            part = volumes[v] * energy_density(moved, law)
            energy += part
            size += abs(part)
        return energy, size

    return spatial if len(dim) == 3 else planar


@njit
def quadratic_form(A: Any, s: Any) -> Any:
    """s.A s with A in places 3 to 8 of nine numbers."""
    return (
        A[3] * s[0] * s[0]
        + A[4] * s[1] * s[1]
        + A[5] * s[2] * s[2]
        + 2.0 * (A[6] * s[1] * s[2] + A[7] * s[0] * s[2] + A[8] * s[0] * s[1])
    )


@njit(parallel=True)
def shorten_steps(
    chunks: Any,
    nodes: Any,
    offsets: Any,
    others: Any,
    gradients: Any,
    volumes: Any,
    law: Any,
    dim: Any,
    flat: Any,
    most: Any,
    x: Any,
    steps: Any,
    parts: Any,
) -> None:
    """Halve the steps of the nodes of one colour until the energy of one law's cells is where it should be.

    A part t of the step s is good if the energy of these cells does not exceed ``E - t f.s + t/2 s.A s`` with their
    own force f and matrix A. Terms that A bounds stay below that for any t in [0, 1]; summed over all terms of the
    node the right-hand side is ``E - t/2 s.A s``, so the energy falls. Cells that would invert where the law allows
    none have infinite energy.

    Parameters
    ----------
    chunks, nodes, offsets, others, gradients, volumes, law, dim, x
        See `add_cells`.
    flat : float
        Part of the energies below which their differences are not looked at, but for cells that would invert.
    most : int
        Halvings after which the node stays where it is.
    steps : (3 n_nodes,)
        Steps [m].
    parts : (n_nodes,)
        Part of each step that may be taken; lowered here.
    """
    for c in prange(chunks.size - 1):
        for r in range(chunks[c], chunks[c + 1]):
            i = nodes[r]
            p = 3 * i
            first, last = offsets[r], offsets[r + 1]
            s = (steps[p], steps[p + 1], steps[p + 2])
            rest = (s[0] - s[0], s[1] - s[1], s[2] - s[2])
            before, size = visit_energies(x, p, rest, first, last, others, gradients, volumes, law, dim)
            terms = node_terms(x, p, first, last, others, gradients, volumes, law, dim)
            work = terms[0] * s[0] + terms[1] * s[1] + terms[2] * s[2]
            margin = 0.5 * quadratic_form(terms, s)
            t = parts[i]
            for k in range(most + 1):
                if k == most:
                    t = 0.0 * t
                    break
                reached = (t * s[0], t * s[1], t * s[2])
                after, _ = visit_energies(x, p, reached, first, last, others, gradients, volumes, law, dim)
                beyond = after - before + t * work
                if beyond <= t * margin:
                    break
                # So small a margin drowns in the rounding of the energies; the block bounds small steps by itself.
                if t * margin <= flat * size and beyond <= flat * size:
                    break
                t = t * 0.5
            parts[i] = t
