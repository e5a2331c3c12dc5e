"""Error of scalar waves for light with a polarization, from the Jones matrices of some rays.

Scalar waves have one component, and the mean transmission of both polarizations. The light of an object that
fills its aperture evenly has, after the lens, the components that the Jones matrices of its rays state. Their
difference, relative to the whole field, is the error of scalar waves for unpolarized light.
"""

from __future__ import annotations

import math

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.raytrace.bundles import directions_of, largest_cosine
from lensdesign.raytrace.polarization import jones_matrices
from lensdesign.raytrace.rays import trace_compiled
from wavesim.rays.interfaces import coating_transmission
from wavesim.scene.engine import ErrorTerm
from wavesim.scene.scene import Scene

MARGIN = 1.05
"""Factor on the mean over rays, about which the errors of single scenes scatter by 3 %. With it the term is
an upper bound in all scenes of `python -m benchmarks.scalar_light`."""


def scalar_light_term(scene: Scene) -> ErrorTerm | None:
    """Return the error of scalar waves for unpolarized light; None if no ray passes the lens.

    On a line the light is polarized across the line and stays so. Scalar waves are then exact.

    Parameters
    ----------
    scene
        Lens with its coatings, object grid and wavelength.

    Raises
    ------
    InputError
        If a coating's table ends before the angles of the rays.
    """
    if scene.object_grid.is_line or not scene.system.surfaces:
        return None
    origins, directions = _rays(scene)
    system = scene.system
    rays = trace_compiled(system, origins, directions, record_hits=True)
    if not np.any(rays.ok):
        return None
    polarized = jones_matrices(system, origins, rays)
    jones = polarized.jones[rays.ok]
    scalar = coating_transmission(scene, polarized.cos_incidence[rays.ok])
    different = jones - scalar[:, None, None] * np.eye(2)
    # Rays carry equal |u|^2 in front of the lens. Behind it, |u|^2 times the cosine to the axis is kept.
    weight = directions[rays.ok, 2] / rays.direction[rays.ok, 2]
    squares = (weight * np.sum(np.abs(matrices) ** 2, axis=(1, 2)) for matrices in (different, jones))
    error = MARGIN * math.sqrt(float(np.sum(next(squares)) / np.sum(next(squares))))
    coatings = "ideal coatings" if scene.has_ideal_coatings else "coatings that are not ideal"
    return ErrorTerm(f"scalar light: one component of the field instead of two, with {coatings}", error)


def _rays(scene: Scene) -> tuple[Array, Array]:
    """Return rays of points over the object grid, evenly over the direction cosines of the aperture."""
    grid = scene.object_grid
    rings, arms = 16, 24
    radius = np.sqrt((np.arange(rings) + 0.5) / rings)
    turns = 2.0 * np.pi * np.arange(arms) / arms
    reach = largest_cosine(scene.lens)
    cosines = reach * np.stack([np.outer(radius, np.cos(turns)), np.outer(radius, np.sin(turns))], axis=-1)
    headings = directions_of(cosines.reshape(-1, 2))
    # Their mean is that over the grid, for cubic polynomials of the position.
    fractions = math.sqrt(0.5) * np.array([-1.0, 0.0, 1.0])
    half_y, half_x = grid.half_widths_mm
    x, y = grid.centre_mm[0] + half_x * fractions, grid.centre_mm[1] + half_y * fractions
    starts = np.array([(a, b, grid.z_mm) for a in x for b in y])
    return np.repeat(starts, len(headings), axis=0), np.tile(headings, (len(starts), 1))
