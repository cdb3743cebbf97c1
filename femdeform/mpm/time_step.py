"""How long a step of material points may be.

Explicit steps resolve sound, viscosity and capillary waves: ``dt <= a dx / c``, ``b rho dx^2 / mu``,
``0.5 sqrt(rho dx^3 / (2 pi k))``, half of the period of a capillary wave as long as a cell. The last of these binds
implicit steps too.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from femdeform.mpm.explicit_laws import Liquid

# Parts of the limits that are taken.
SOUND, VISCOUS, CAPILLARY = 0.4, 0.05, 0.5


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
