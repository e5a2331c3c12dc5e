"""State of a system: every deviation of lens, object, sensor, light and source from the design.

The same value describes the simulated bench of an image, a tolerance trial, and the result of a calibration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose, SurfacePerturbation
from wavesim.scene.light_errors import NO_LIGHT_ERRORS, LightErrors, light_mode
from wavesim.scene.source import POINT, Source


def _validate_numbers(name: str, values: Any, count: int | None, allowed: str) -> None:
    if (count is not None and len(values) != count) or not all(map(math.isfinite, values)):
        raise InputError(f"{name} = {values!r}: must be {allowed}")


def _value_at(values: Sequence[Any], index: int, default: Any) -> Any:
    return values[index] if index < len(values) else default


SLOPE_ORDERS = (1, 0), (0, 1)
"""Orders of the polynomials of a background that is uneven along x, and along y."""


LARGEST_NONLINEARITY = 0.4
"""Largest magnitude of a camera's nonlinearity. The light increases with the counts below 0.5."""


def validate_nonlinearity(value: float) -> None:
    """Check the nonlinearity of a camera.

    Raises
    ------
    InputError
        If its magnitude exceeds `LARGEST_NONLINEARITY`.
    """
    if not -LARGEST_NONLINEARITY <= value <= LARGEST_NONLINEARITY:
        raise InputError(
            f"nonlinearity = {value!r}: must be from {-LARGEST_NONLINEARITY:g} to {LARGEST_NONLINEARITY:g}"
        )


class SensorPose(NamedTuple):
    """Deviation of the sensor from its nominal position on one plane.

    Attributes
    ----------
    distance_mm : float
        Shift along z, away from the lens.
    shift_mm : (x, y)
        Lateral shift of the sensor's centre.
    tilt_deg : (x, y)
        Tilt about the sensor's centre, see :class:`SystemState`.
    """

    distance_mm: float = 0.0
    shift_mm: tuple[float, float] = (0.0, 0.0)
    tilt_deg: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class SystemState:
    """Deviations of one lens, its object, its sensor, its light and the light's source from the design.

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
    plane_distance_errors_mm : tuple of float
        Change of the distance from the lens in mm on each recording plane, in addition to `sensor_shift_mm`.
        Planes beyond the list have none.
    sensor_tilt_deg : (x, y)
        Right-handed rotation of the sensor about x, then about the rotated y axis, in degrees. The axes pass
        through the centre of the sensor's plane.
    wavelength_um : float or None
        Vacuum wavelength of the light in um. Default: the wavelength of the nominal scene.
    light : LightErrors
        Errors of the light on the object.
    plane_shifts_um : tuple of (x, y)
        Shift of the sensor's centre on each plane, in addition to `sensor_shift_mm`. Planes beyond the list
        have none.
    plane_backgrounds : tuple of float
        Even background light on each plane, as a fraction of the plane's mean intensity. Planes beyond the
        list have none.
    plane_background_slopes : tuple of (x, y)
        Change of the background from the centre of the sensor to its edges at +x and +y, as a fraction of the
        plane's mean intensity. Planes beyond the list have none.
    plane_exposure_errors : tuple of float
        Relative error of the stated exposure on each plane (true over stated, minus 1). Planes beyond the
        list have none.
    nonlinearity : float
        Nonlinearity of the camera in addition to the one its frames state, see
        :class:`wavesim.FrameSettings`.
    vibration_um : float
        Standard deviation of the sensor's lateral vibration during an exposure, along x and y, in um. It
        blurs the pictures of all planes.
    source : Source
        Angular size and bandwidth of the light source.

    Raises
    ------
    InputError
        If a shift or a tilt has the wrong number of components, a component is not finite, a background does
        not lie between 0 and 1, an exposure error is not above -1, or the vibration is negative.

    Examples
    --------
    A tilted lens, and a sensor whose first plane is 20 um too far away:

    >>> from lensdesign import Pose
    >>> from wavesim import SystemState
    >>> state = SystemState(Pose(tilt_y_deg=0.1), plane_distance_errors_mm=(0.02,))
    >>> state.sensor_pose(0).distance_mm, state.sensor_pose(1).distance_mm
    (0.02, 0.0)
    """

    pose: Pose = Pose()
    surface_perturbations: Mapping[int, SurfacePerturbation] = field(default_factory=dict)
    object_shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor_shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    plane_distance_errors_mm: tuple[float, ...] = ()
    sensor_tilt_deg: tuple[float, float] = (0.0, 0.0)
    wavelength_um: float | None = None
    light: LightErrors = NO_LIGHT_ERRORS
    plane_shifts_um: tuple[tuple[float, float], ...] = ()
    plane_backgrounds: tuple[float, ...] = ()
    plane_background_slopes: tuple[tuple[float, float], ...] = ()
    plane_exposure_errors: tuple[float, ...] = ()
    nonlinearity: float = 0.0
    vibration_um: float = 0.0
    source: Source = POINT

    def __post_init__(self) -> None:
        _validate_numbers("object_shift_mm", self.object_shift_mm, 3, "three finite numbers, x, y and z")
        _validate_numbers("sensor_shift_mm", self.sensor_shift_mm, 3, "three finite numbers, x, y and z")
        _validate_numbers("sensor_tilt_deg", self.sensor_tilt_deg, 2, "two finite numbers, about x and y")
        _validate_numbers("plane_distance_errors_mm", self.plane_distance_errors_mm, None, "finite numbers")
        for name in ("plane_shifts_um", "plane_background_slopes"):
            pairs = getattr(self, name)
            if not all(len(pair) == 2 and all(map(math.isfinite, pair)) for pair in pairs):
                raise InputError(f"{name} = {pairs!r}: must be pairs of finite numbers")
        if not 0.0 <= self.vibration_um < math.inf:
            raise InputError(f"vibration_um = {self.vibration_um!r}: must be finite, and 0 or above")
        for fraction in self.plane_backgrounds:
            if not 0.0 <= fraction < 1.0:
                raise InputError(f"plane_backgrounds = {self.plane_backgrounds!r}: must be from 0 to below 1")
        errors = self.plane_exposure_errors
        if not all(-1.0 < error < math.inf for error in errors):
            raise InputError(f"plane_exposure_errors = {errors!r}: must be finite, and above -1")
        validate_nonlinearity(self.nonlinearity)

    def sensor_pose(self, index: int) -> SensorPose:
        """Return the deviation of the sensor's position on a plane; `index` counts planes from 0."""
        x_mm, y_mm, z_mm = self.sensor_shift_mm
        x_um, y_um = _value_at(self.plane_shifts_um, index, (0.0, 0.0))
        return SensorPose(
            z_mm + _value_at(self.plane_distance_errors_mm, index, 0.0),
            (x_mm + 1e-3 * x_um, y_mm + 1e-3 * y_um),
            self.sensor_tilt_deg,
        )

    def at_plane(self, index: int) -> SystemState:
        """Return the state with the sensor's lateral position on a plane as its shift; `index` counts planes
        from 0.
        """
        shift_mm = self.sensor_pose(index).shift_mm
        return replace(self, sensor_shift_mm=(*shift_mm, self.sensor_shift_mm[2]), plane_shifts_um=())

    def exposure_error(self, index: int) -> float:
        """Return the relative error of the exposure on a plane; `index` counts planes from 0."""
        return float(_value_at(self.plane_exposure_errors, index, 0.0))

    def background(self, index: int) -> float:
        """Return the background on a plane as a fraction of its mean intensity; `index` counts from 0."""
        return float(_value_at(self.plane_backgrounds, index, 0.0))

    def background_on(self, index: int, shape: tuple[int, ...]) -> Array | None:
        """Return the background on the pixels of a plane as fractions of its mean intensity, at least 0.

        Parameters
        ----------
        index
            Index of the plane from 0.
        shape
            Number of pixels along y and x.

        Returns
        -------
        ndarray or None
            Fractions whose shape broadcasts to (ny, nx); None without a background.
        """
        fraction = self.background(index)
        slopes = _value_at(self.plane_background_slopes, index, (0.0, 0.0))
        if not (fraction or any(slopes)):
            return None
        result = np.array([[fraction]])
        if any(slopes):
            (x, y), (height, width) = slopes, shape
            across, down = SLOPE_ORDERS
            result = result + x * light_mode(across, (1, width)) + y * light_mode(down, (height, 1))
        return np.maximum(result, 0.0)


AS_DESIGNED = SystemState()
"""State without deviations from the design."""


def state_of(given: SystemState | Pose) -> SystemState:
    """Return a state; a pose alone becomes the state of a system whose lens has this pose."""
    return SystemState(given) if isinstance(given, Pose) else given
