"""One bench: lens, light and camera as they are, and not as they should be.

The same model simulates frames and is found from them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legval

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.fields.field import Field
from wavesim.scene.placement import NOMINAL, Placement, placed
from wavesim.scene.source import POINT, Source

Orders = tuple[int, int]
"""Of a product of Legendre polynomials P_i(x) P_j(y)."""


@dataclass(frozen=True)
class LightErrors:
    """How the light on the object differs from what it should be.

    Attributes
    ----------
    tilt_deg : (x, y)
        Of its direction, as of :func:`wavesim.targets.illumination.plane_wave`.
    amplitude : mapping
        Change of the relative amplitude, 1 + sum of c P_i(x) P_j(y), by (i, j); x and y go from -1 to 1 over
        the patch.
    phase_waves : mapping
        The same for its phase, in waves.

    Raises
    ------
    InputError
        If a number is not finite, a tilt not below 90 deg, or an order not whole or negative.
    """

    tilt_deg: tuple[float, float] = (0.0, 0.0)
    amplitude: Mapping[Orders, float] = field(default_factory=dict)
    phase_waves: Mapping[Orders, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.tilt_deg) != 2 or not all(abs(tilt) < 90.0 for tilt in self.tilt_deg):
            raise InputError(f"light tilt_deg = {self.tilt_deg!r}: must be two angles between -90 and 90 deg")
        for name in ("amplitude", "phase_waves"):
            for orders, value in getattr(self, name).items():
                if len(orders) != 2 or min(orders) < 0 or orders == (0, 0):
                    raise InputError(f"light {name}, orders {orders}: must be two, not negative, not both 0")
                if not math.isfinite(value):
                    raise InputError(f"light {name}, orders {orders} = {value!r}: must be finite")

    def on(self, light: Field) -> Field:
        """The light with these errors.

        Raises
        ------
        InputError
            If its amplitude falls below 0.
        """
        if not (any(self.tilt_deg) or any(self.amplitude.values()) or any(self.phase_waves.values())):
            return light
        shape = light.grid.shape
        relative = 1.0 + _sum_of_modes(self.amplitude, shape)
        if relative.min() < 0.0:
            raise InputError(
                f"light amplitude: its modes make it {relative.min():.3g} somewhere: must be above 0"
            )
        phase = 2.0 * np.pi * _sum_of_modes(self.phase_waves, shape)
        slopes = [math.tan(math.radians(tilt)) for tilt in self.tilt_deg]
        per_mm = 2e3 * np.pi * light.index / light.wavelength_um / math.hypot(1.0, *slopes)
        x, y = light.grid.x_mm - light.grid.centre_mm[0], light.grid.y_mm - light.grid.centre_mm[1]
        phase = phase + per_mm * (slopes[0] * x[None, :] + slopes[1] * y[:, None])
        factor = (relative * np.exp(1j * phase)).astype(light.values.dtype)
        return light.with_values(light.values * factor)


def light_mode(orders: Orders, shape: tuple[int, ...]) -> Array:
    """P_i(x) P_j(y) on the samples of a patch, x and y from -1 to 1 between its borders, shape (ny, nx)."""
    x, y = ((2.0 * np.arange(n) + 1.0) / n - 1.0 for n in reversed(shape))
    across, down = (legval(values, np.eye(n + 1)[n]) for values, n in zip((x, y), orders, strict=True))
    return np.outer(down, across)


def _sum_of_modes(sizes: Mapping[Orders, float], shape: tuple[int, ...]) -> Array:
    return sum((c * light_mode(orders, shape) for orders, c in sizes.items()), np.zeros(shape))


@dataclass(frozen=True)
class Bench:
    """Lens, object, sensor, light and camera as deltas from the design.

    Attributes
    ----------
    placement : Placement
        Where lens, object and sensor are, the lens's own errors, and the distances of the planes.
    light : LightErrors
        Of the light on the object.
    plane_shifts_um : tuple of (x, y)
        How far the sensor's middle is on each plane from where it should be, beside the placement's shift;
        planes beyond the list are not shifted.
    plane_backgrounds : tuple of float
        Even light on each plane that is none of the object's, as a share of the plane's mean intensity.
    source : Source
        Of the light.

    Raises
    ------
    InputError
        If a shift or background is not usable.
    """

    placement: Placement = NOMINAL
    light: LightErrors = LightErrors()
    plane_shifts_um: tuple[tuple[float, float], ...] = ()
    plane_backgrounds: tuple[float, ...] = ()
    source: Source = POINT

    def __post_init__(self) -> None:
        for shift in self.plane_shifts_um:
            if len(shift) != 2 or not all(map(math.isfinite, shift)):
                raise InputError(
                    f"plane_shifts_um = {self.plane_shifts_um!r}: must be pairs of finite numbers"
                )
        for share in self.plane_backgrounds:
            if not 0.0 <= share < 1.0:
                raise InputError(f"plane_backgrounds = {self.plane_backgrounds!r}: must be from 0 to below 1")

    def shift_mm(self, number: int) -> tuple[float, float]:
        """Of the sensor's middle on a plane, by its number from 0."""
        x_mm, y_mm, _ = self.placement.sensor_shift_mm
        x_um, y_um = _of(self.plane_shifts_um, number, (0.0, 0.0))
        return x_mm + 1e-3 * x_um, y_mm + 1e-3 * y_um

    def at_plane(self, number: int) -> Placement:
        """The placement with the sensor where it is on a plane, by its number from 0."""
        return replace(
            self.placement, sensor_shift_mm=(*self.shift_mm(number), self.placement.sensor_shift_mm[2])
        )

    def background(self, number: int) -> float:
        """Share of a plane's mean intensity that is none of the object's light, by its number from 0."""
        return _of(self.plane_backgrounds, number, 0.0)


AS_DESIGNED = Bench()
"""All as it should be."""


def bench_of(given: Placement | Pose | Bench) -> Bench:
    """A bench, of which the placement alone may be given."""
    return given if isinstance(given, Bench) else Bench(placed(given))


def _of(values: Sequence[Any], number: int, otherwise: Any) -> Any:
    return values[number] if number < len(values) else otherwise
