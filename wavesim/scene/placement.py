"""Positions of lens, object, sensor and light, as deviations from the design."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose, SurfacePerturbation


def _validate_numbers(name: str, values: Any, count: int | None, allowed: str) -> None:
    if (count is not None and len(values) != count) or not all(map(math.isfinite, values)):
        raise InputError(f"{name} = {values!r}: must be {allowed}")


@dataclass(frozen=True)
class Placement:
    """Deviations of one lens, its object, its sensor and its light from the design.

    Attributes
    ----------
    pose : Pose
        Displacement and tilt of the lens.
    surface_perturbations : mapping of int to SurfacePerturbation
        Manufacturing errors by the index of the surface from 0, as in :func:`lensdesign.trace`, for one lens.
        Refractive indices are those at the design's wavelength; perturbations state the changes of index at
        another wavelength.
    object_shift_mm, sensor_shift_mm : (x, y, z)
        Shifts of object and sensor in mm. Equal shifts of both are equivalent to the opposite shift of the
        lens.
    plane_distances_mm : tuple of float
        Change of the distance from the lens in mm, for each recording plane. Planes beyond the list use the z
        component of `sensor_shift_mm`.
    sensor_tilt_deg : (x, y)
        Right-handed rotation of the sensor about x, then about the rotated y axis, in degrees. The axes pass
        through the centre of the sensor's plane.
    wavelength_um : float or None
        Vacuum wavelength of the light in um. Default: the wavelength of the nominal scene.

    Raises
    ------
    InputError
        If a shift or a tilt has the wrong number of components, or a component is not finite.

    Examples
    --------
    A tilted lens, and a sensor whose first plane is 20 um too far away:

    >>> from lensdesign import Pose
    >>> from wavesim import Placement
    >>> mounted = Placement(Pose(tilt_y_deg=0.1), plane_distances_mm=(0.02,))
    >>> mounted.plane_distance_mm(0), mounted.plane_distance_mm(1)
    (0.02, 0.0)
    """

    pose: Pose = Pose()
    surface_perturbations: Mapping[int, SurfacePerturbation] = field(default_factory=dict)
    object_shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor_shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    plane_distances_mm: tuple[float, ...] = ()
    sensor_tilt_deg: tuple[float, float] = (0.0, 0.0)
    wavelength_um: float | None = None

    def __post_init__(self) -> None:
        _validate_numbers("object_shift_mm", self.object_shift_mm, 3, "three finite numbers, x, y and z")
        _validate_numbers("sensor_shift_mm", self.sensor_shift_mm, 3, "three finite numbers, x, y and z")
        _validate_numbers("sensor_tilt_deg", self.sensor_tilt_deg, 2, "two finite numbers, about x and y")
        _validate_numbers("plane_distances_mm", self.plane_distances_mm, None, "finite numbers")

    def plane_distance_mm(self, index: int) -> float:
        """Return the change of a plane's distance from the lens in mm; `index` counts planes from 0."""
        is_listed = index < len(self.plane_distances_mm)
        return self.plane_distances_mm[index] if is_listed else self.sensor_shift_mm[2]


NOMINAL = Placement()
"""Placement without deviations from the design."""


def placed(placement: Placement | Pose) -> Placement:
    """Return a placement; a pose alone becomes the placement of that lens on a bench as designed."""
    return Placement(placement) if isinstance(placement, Pose) else placement
