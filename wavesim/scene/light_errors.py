"""Errors of the light on the object: its direction, and uneven amplitude and phase."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legval

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from wavesim.fields.field import Field

Orders = tuple[int, int]
"""Orders (i, j) of the Legendre product P_i(x) P_j(y)."""


@dataclass(frozen=True)
class LightErrors:
    """Deviations of the light on the object from the stated light.

    Attributes
    ----------
    tilt_deg : (x, y)
        Error of its direction, as defined by :func:`wavesim.targets.illumination.plane_wave`.
    amplitude : mapping
        Coefficients c of the relative amplitude 1 + sum of c P_i(x) P_j(y), by (i, j). The coordinates x and
        y run from -1 to 1 over the patch.
    phase_waves : mapping
        Coefficients of the phase in the same polynomials, in waves.

    Raises
    ------
    InputError
        If a number is not finite, a tilt reaches 90 deg, or an order is negative.
    """

    tilt_deg: tuple[float, float] = (0.0, 0.0)
    amplitude: Mapping[Orders, float] = field(default_factory=dict)
    phase_waves: Mapping[Orders, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.tilt_deg) != 2 or not all(abs(tilt) < 90.0 for tilt in self.tilt_deg):
            raise InputError(f"light tilt_deg = {self.tilt_deg!r}: must be two angles between -90 and 90°")
        for name in ("amplitude", "phase_waves"):
            for orders, value in getattr(self, name).items():
                if len(orders) != 2 or min(orders) < 0 or orders == (0, 0):
                    raise InputError(
                        f"light {name}, orders {orders}: must be two whole numbers from 0, not both 0"
                    )
                if not math.isfinite(value):
                    raise InputError(f"light {name}, orders {orders} = {value!r}: must be finite")

    def on(self, light: Field) -> Field:
        """Return the light with these errors applied.

        Raises
        ------
        InputError
            If the amplitude falls below 0 at some sample.
        """
        if not (any(self.tilt_deg) or any(self.amplitude.values()) or any(self.phase_waves.values())):
            return light
        shape = light.grid.shape
        relative = 1.0 + sum_of_modes(self.amplitude, shape)
        if relative.min() < 0.0:
            raise InputError(
                f"light amplitude: the modes reduce it to {relative.min():.3g}; it must stay above 0"
            )
        phase = 2.0 * np.pi * sum_of_modes(self.phase_waves, shape)
        slopes = [math.tan(math.radians(tilt)) for tilt in self.tilt_deg]
        per_mm = 2e3 * np.pi * light.index / light.wavelength_um / math.hypot(1.0, *slopes)
        x, y = light.grid.x_mm - light.grid.centre_mm[0], light.grid.y_mm - light.grid.centre_mm[1]
        phase = phase + per_mm * (slopes[0] * x[None, :] + slopes[1] * y[:, None])
        factor = (relative * np.exp(1j * phase)).astype(np.result_type(light.values, np.complex64))
        return light.with_values(light.values * factor)


NO_LIGHT_ERRORS = LightErrors()
"""The light as stated."""


def light_mode(orders: Orders, shape: tuple[int, ...]) -> Array:
    """Return P_i(x) P_j(y) on the samples of a patch, shape (ny, nx); x and y run from -1 to 1."""
    x, y = ((2.0 * np.arange(n) + 1.0) / n - 1.0 for n in reversed(shape))
    across, down = (legval(values, np.eye(n + 1)[n]) for values, n in zip((x, y), orders, strict=True))
    return np.outer(down, across)


def sum_of_modes(sizes: Mapping[Orders, Any], shape: tuple[int, ...]) -> Any:
    """Return the sum of modes (:func:`light_mode`) with real or complex sizes on the samples of a patch."""
    return sum((c * light_mode(orders, shape) for orders, c in sizes.items()), np.zeros(shape))
