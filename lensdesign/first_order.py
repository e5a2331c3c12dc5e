"""First-order (paraxial) data: focal lengths and cardinal points of the thick lens.

From the ray-transfer matrices of Hecht, Optics, section 6.2: refraction bends (height, index x angle) by the
power (n2 - n1) c, transfer shifts it by thickness / index. Conic constants and asphere terms from r^4 on do
not count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lensdesign.system import Lens


@dataclass(frozen=True)
class FirstOrder:
    """Cardinal points of a lens at one wavelength; lengths in mm, inf for an afocal lens.

    Attributes
    ----------
    efl_mm
        Effective focal length, 1 / power; positive for a converging lens.
    bfl_mm
        From the last vertex to the rear focal point.
    ffl_mm
        From the front vertex to the front focal point; negative where that lies before the lens.
    front_principal_z_mm, rear_principal_z_mm
        Principal planes, z from the front vertex.
    """

    efl_mm: float
    bfl_mm: float
    ffl_mm: float
    front_principal_z_mm: float
    rear_principal_z_mm: float


def first_order(lens: Lens, wavelength_um: float | None = None) -> FirstOrder:
    """Cardinal points of the whole lens; `wavelength_um` None takes the lens's first wavelength."""
    wavelength_um = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    indices = lens.indices(wavelength_um)
    matrix = np.eye(2)
    for i, surface in enumerate(lens.surfaces):
        power = (indices[i + 1] - indices[i]) * surface.curvature
        matrix = np.array([[1.0, 0.0], [-power, 1.0]]) @ matrix
        if surface.thickness_mm is not None:
            matrix = np.array([[1.0, surface.thickness_mm / indices[i + 1]], [0.0, 1.0]]) @ matrix
    (a, _), (c, d) = matrix
    if c == 0.0:
        return FirstOrder(math.inf, math.inf, math.inf, math.inf, math.inf)
    before, behind = indices[0], indices[-1]
    return FirstOrder(
        efl_mm=float(-1.0 / c),
        bfl_mm=float(-behind * a / c),
        ffl_mm=float(before * d / c),
        front_principal_z_mm=float(before * (d - 1.0) / c),
        rear_principal_z_mm=float(lens.exit_vertex_z_mm + behind * (1.0 - a) / c),
    )
