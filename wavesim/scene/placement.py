"""Where lens, object, sensor and light are, as deltas from the design."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose, SurfacePerturbation


def _refuse(name: str, values: Any, count: int | None, wanted: str) -> None:
    if (count is not None and len(values) != count) or not all(map(math.isfinite, values)):
        raise InputError(f"{name} = {values!r}: must be {wanted}")


@dataclass(frozen=True)
class Placement:
    """One lens on one bench: how it stands, and what else is not as designed.

    Attributes
    ----------
    pose, surface_perturbations
        The lens, as in :func:`lensdesign.trace`; no arrays of trials. Indices are those at the design's
        wavelength: where another wavelength changes them, surface perturbations say so.
    object_shift_mm, sensor_shift_mm : (x, y, z)
        How far object and sensor stand from where they should. To shift both is to shift the lens the other
        way.
    plane_distances_mm : tuple of float
        How much farther from the lens each plane is in which the sensor records; planes beyond the list are
        where the sensor's shift along z takes them.
    sensor_tilt_deg : (x, y)
        Right-handed rotation of the sensor about x, then about the y axis that turned with it, about the
        middle of its plane.
    wavelength_um : float or None
        Vacuum wavelength of the light; None: the design's.

    Raises
    ------
    InputError
        If a shift or a tilt is not of finite numbers, or not of as many as it takes.
    """

    pose: Pose = Pose()
    surface_perturbations: Mapping[int, SurfacePerturbation] = field(default_factory=dict)
    object_shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor_shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    plane_distances_mm: tuple[float, ...] = ()
    sensor_tilt_deg: tuple[float, float] = (0.0, 0.0)
    wavelength_um: float | None = None

    def __post_init__(self) -> None:
        _refuse("object_shift_mm", self.object_shift_mm, 3, "three finite numbers, x, y and z")
        _refuse("sensor_shift_mm", self.sensor_shift_mm, 3, "three finite numbers, x, y and z")
        _refuse("sensor_tilt_deg", self.sensor_tilt_deg, 2, "two finite numbers, about x and y")
        _refuse("plane_distances_mm", self.plane_distances_mm, None, "finite numbers")

    def plane_distance_mm(self, number: int) -> float:
        """How much farther from the lens a plane is, by its number from 0."""
        told = number < len(self.plane_distances_mm)
        return self.plane_distances_mm[number] if told else self.sensor_shift_mm[2]


NOMINAL = Placement()
"""All as designed."""


def placed(placement: Placement | Pose) -> Placement:
    """A placement; where only a pose is given, that of a lens on an otherwise perfect bench."""
    return Placement(placement) if isinstance(placement, Pose) else placement
