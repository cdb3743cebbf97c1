"""How long a step of material points may be.

No node crosses more than a part of a cell, ``dt <= CFL dx / max |v_i|``. Explicit steps resolve sound, viscosity and
capillary waves besides: ``dt <= a dx / c``, ``b rho dx^2 / mu``, ``0.5 sqrt(rho dx^3 / (2 pi k))``, half of the period
of a capillary wave as long as a cell. The last of these binds implicit steps too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.mpm.explicit_laws import Liquid

# Parts of the limits that are taken.
SOUND, VISCOUS, CAPILLARY = 0.4, 0.05, 0.5


@dataclass(frozen=True)
class StepControl:
    """Steps that follow the motion.

    Attributes
    ----------
    shortest, longest : float
        Bounds [s].
    cfl : float
        Part of a cell that a node may cross in a step, below 1 [-].
    growth : float
        Largest ratio of a step to the one before it [-].
    """

    shortest: float
    longest: float
    cfl: float = 0.6
    growth: float = 1.2

    def __post_init__(self) -> None:
        if not (0.0 <= self.shortest <= self.longest and 0.0 < self.cfl < 1.0 and self.growth >= 1.0):
            raise ValueError("a step control needs 0 <= shortest <= longest, 0 < cfl < 1 and growth >= 1")

    def next(self, spacing: float, fastest: float, before: float | None = None, limit: float = np.inf) -> float:
        """Length of the next step [s].

        Parameters
        ----------
        spacing : float
            Of the grid nodes [m].
        fastest : float
            Largest speed of a node [m/s]; for the first step, of a point.
        before : float, optional
            The step before [s].
        limit : float
            Of an explicit step, see `explicit_limit` [s]; stronger than `shortest`.
        """
        wanted = self.cfl * spacing / fastest if fastest > 0.0 else np.inf
        if before is not None:
            wanted = min(wanted, self.growth * before)
        return float(min(max(min(wanted, self.longest), self.shortest), limit))


def explicit_limit(
    spacing: float, materials: Iterable[tuple[Any, float]], surface_tension: float = 0.0, sound: float = SOUND
) -> float:
    """Longest explicit step [s] for laws and their densities at rest.

    Parameters
    ----------
    spacing : float
        [m].
    materials : iterable of (NamedTuple, float)
        Law of `femdeform.materials`, or `Liquid`, and density [kg/m^3].
    surface_tension : float
        The largest coefficient [N/m]; with the smallest of the densities.
    sound : float
        Part of the time that sound takes through a cell; 1 is the edge of what is stable for points at rest.

    Limitations
    -----------
    Sound is that of the materials at rest: a strongly compressed neo-Hookean solid is faster.
    """
    limit, lightest = np.inf, np.inf
    for law, density in materials:
        lightest = min(lightest, density)
        if isinstance(law, Liquid):
            stiffness = law.bulk_modulus
            if law.viscosity > 0.0:
                limit = min(limit, VISCOUS * density * spacing**2 / law.viscosity)
        else:
            stiffness = law.lmbda + 2.0 * law.mu
        if stiffness > 0.0:
            limit = min(limit, sound * spacing * float(np.sqrt(density / stiffness)))
    return float(min(limit, capillary_limit(spacing, lightest, surface_tension)))


def capillary_limit(spacing: float, density: float, surface_tension: float) -> float:
    """Longest step [s] with surface tension [N/m], also of an implicit step: half of ``sqrt(rho dx^3 / (2 pi k))``.

    The root is the period of a capillary wave as long as a cell. Implicit steps begin to fail between half of it and
    the whole: the least energy then lies where the light nodes outside the liquid have moved so far that the samples
    they hold shrink to nothing.

    Parameters
    ----------
    spacing : float
        dx [m].
    density : float
        rho at rest [kg/m^3].
    surface_tension : float
        The largest coefficient k at the time [N/m]; see `femdeform.mpm.surface_coefficient.largest_coefficient`.
    """
    if surface_tension <= 0.0:
        return np.inf
    return CAPILLARY * float(np.sqrt(density * spacing**3 / (2.0 * np.pi * surface_tension)))
