"""First-order (paraxial) data: focal lengths and cardinal points of the thick lens.

The ray-transfer matrices are those of Hecht, Optics, section 6.2, for the vector (height, index x angle).
Refraction uses the power (n2 - n1) c of a surface, and transfer the reduced thickness (thickness / index).
Conic constants and asphere terms from r^4 on have no effect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.lens.lens import Lens


@dataclass(frozen=True)
class FirstOrder:
    """Cardinal points of a lens at one wavelength; lengths are inf for an afocal lens.

    Attributes
    ----------
    power_per_mm
        Power; 0 for an afocal lens, and positive for a converging lens.
    efl_mm
        Effective focal length in the medium behind the lens, index / power: from the rear principal plane to
        the rear focal point.
    bfl_mm
        Back focal length, from the last vertex to the rear focal point.
    ffl_mm
        Front focal length, from the front vertex to the front focal point; negative if the point is in front
        of the lens.
    front_principal_z_mm, rear_principal_z_mm
        z of the principal planes, from the front vertex.
    """

    power_per_mm: float
    efl_mm: float
    bfl_mm: float
    ffl_mm: float
    front_principal_z_mm: float
    rear_principal_z_mm: float


def first_order(lens: Lens, wavelength_um: float | None = None) -> FirstOrder:
    """Return the cardinal points of the whole lens.

    Parameters
    ----------
    lens
        The lens.
    wavelength_um
        Vacuum wavelength (default: the first of the lens).

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> round(first_order(lens).efl_mm, 3)
    19.166
    """
    wavelength_um = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    curvatures = [surface.curvature for surface in lens.surfaces]
    return cardinal_points(curvatures, np.diff(lens.vertex_z_mm), lens.indices(wavelength_um))


def cardinal_points(curvatures: ArrayLike, thicknesses_mm: ArrayLike, indices: ArrayLike) -> FirstOrder:
    """Return the cardinal points of a sequence of surfaces.

    Parameters
    ----------
    curvatures
        Curvatures of the n surfaces in 1/mm.
    thicknesses_mm
        Thicknesses of the n - 1 media between them.
    indices
        Refractive indices of all n + 1 media.

    Examples
    --------
    >>> round(cardinal_points([0.05, -0.05], [3.0], [1.0, 1.5, 1.0]).efl_mm, 3)
    20.513
    """
    c, t, n = (np.asarray(values, float) for values in (curvatures, thicknesses_mm, indices))
    matrix = np.array([[1.0, 0.0], [-(n[1] - n[0]) * c[0], 1.0]])
    for i in range(1, len(c)):
        matrix = np.array([[1.0, t[i - 1] / n[i]], [0.0, 1.0]]) @ matrix
        matrix = np.array([[1.0, 0.0], [-(n[i + 1] - n[i]) * c[i], 1.0]]) @ matrix
    (a, _), (minus_power, d) = matrix
    if minus_power == 0.0:
        return FirstOrder(0.0, math.inf, math.inf, math.inf, math.inf, math.inf)
    return FirstOrder(
        power_per_mm=float(-minus_power),
        efl_mm=float(-n[-1] / minus_power),
        bfl_mm=float(-n[-1] * a / minus_power),
        ffl_mm=float(n[0] * d / minus_power),
        front_principal_z_mm=float(n[0] * (d - 1.0) / minus_power),
        rear_principal_z_mm=float(np.sum(t) + n[-1] * (1.0 - a) / minus_power),
    )
