"""A rigid body in the same backward Euler step and on the same penalty obstacles as a deformable one: a reference.

The step minimises ``sum m / 2 |x - x_hat|^2 / h^2 - sum m g.x + contact(x)`` over the rigid motions of the points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cross_matrices(a: Array) -> Array:
    """Matrices of the cross products a x, (n, 3, 3)."""
    out = np.zeros((len(a), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -a[:, 2], a[:, 1], -a[:, 0]
    return out - np.swapaxes(out, 1, 2)


def turned(w: Array, a: Array) -> Array:
    """Points turned by the rotation vector w (Rodrigues)."""
    angle = float(np.linalg.norm(w))
    if angle == 0.0:
        return a.copy()
    k = w / angle
    cross = np.cross(k, a)
    return np.asarray(a + np.sin(angle) * cross + (1.0 - np.cos(angle)) * np.cross(k, cross))


def best_fit(x: Array, points: Array, mass: Array) -> Array:
    """The rigid motion of `points` nearest to x, weighted by mass (Kabsch)."""
    m = mass / mass.sum()
    center, reference = m @ x, m @ points
    U, _, Vt = np.linalg.svd((m[:, None] * (x - center)).T @ (points - reference))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return np.asarray((points - reference) @ R.T + center)


class RigidBody:
    """Points with masses that move as one.

    Parameters
    ----------
    points : (n, 3) float64
        Positions at the start [m].
    mass : (n,) float64
        Masses [kg].
    velocity : (n, 3) float64
        Velocities at the start, those of a rigid motion [m/s].
    gravity : (3,) float64
        [m/s^2].
    contacts : sequence
        With the methods of `PenaltyContact`.
    """

    def __init__(self, points: Array, mass: Array, velocity: Array, gravity: Array, contacts: Sequence[Any]) -> None:
        self.x, self.mass, self.v, self.gravity, self.contacts = points.copy(), mass, velocity.copy(), gravity, contacts
        self.time = 0.0

    def step(self, h: float, tolerance: float = 1e-10) -> None:
        """One step by Newton's method in the six degrees of freedom, with the Hessian made definite."""
        self.time += h
        target = self.x + h * self.v + h * h * self.gravity
        weights = self.mass / (h * h)
        for contact in self.contacts:
            contact.begin_step(self.x, self.time, h)

        def value(x: Array) -> float:
            inertia = 0.5 * float(np.einsum("i,ic,ic->", weights, x - target, x - target))
            return inertia + sum(contact.value(x) for contact in self.contacts)

        x = self.x + h * self.v
        x = best_fit(x, self.x, self.mass)
        scale = float(weights @ np.linalg.norm(self.x - target, axis=1))
        for _ in range(200):
            force = weights[:, None] * (x - target)
            blocks = np.zeros((len(x), 9))
            blocks[:, [0, 4, 8]] = weights[:, None]
            for contact in self.contacts:
                contact.add_gradient(x, force)
                contact.add_hessian(x, True, blocks)
            center = self.mass @ x / self.mass.sum()
            arm = x - center
            residual = np.concatenate([np.cross(arm, force).sum(0), force.sum(0)])
            if np.abs(residual).max() <= tolerance * scale:
                break
            rows = np.concatenate([-cross_matrices(arm), np.broadcast_to(np.eye(3), (len(x), 3, 3))], axis=2)
            H = np.einsum("nai,nab,nbj->ij", rows, blocks.reshape(-1, 3, 3), rows)
            moment = np.einsum("na,nb->ab", arm, force)
            H[:3, :3] += 0.5 * (moment + moment.T) - np.trace(moment) * np.eye(3)
            values, vectors = np.linalg.eigh(H)
            values = np.maximum(np.abs(values), 1e-12 * np.abs(values).max())
            change = -vectors @ ((vectors.T @ residual) / values)
            start, slope, length = value(x), float(residual @ change), 1.0
            while length > 1e-12:
                trial = turned(length * change[:3], arm) + center + length * change[3:]
                if value(trial) <= start + 1e-4 * length * slope + 1e-14 * abs(start):
                    break
                length *= 0.5
            x = trial
        else:
            raise RuntimeError("the rigid step did not converge")
        self.v = (x - self.x) / h
        self.x = x
