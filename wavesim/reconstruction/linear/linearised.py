"""The model of a recording about one object on one bench, as far as it is linear.

Residuals are weighted, and shares of the length of what was recorded, as one array of shape (planes, ny, nx).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.linear.measurement_operator import (
    ComplexArray,
    FreeSpaceMeasurement,
    MeasurementOperator,
    PixelMeasurement,
    RealArray,
)

DARK = 1e-5
"""Of a plane's mean intensity: keeps roots of dark pixels smooth."""


class Linearised:
    """Residuals, their slopes by whatever changes the field behind the lens, and the way back to the object.

    Parameters
    ----------
    model
        Of the bench.
    transmission
        Of the object.
    fits_scale
        Whether recorded amplitudes are known but for a factor, which is fitted, and taken out of all slopes.

    Attributes
    ----------
    residual : ndarray, shape (planes, ny, nx)
        Recorded less modelled amplitudes.
    misfit : float
        Its length.
    scale : float
        Recorded amplitude for a unit of the model's.
    size : float
        Weighted length of the recorded amplitudes, of which residuals are fractions.
    """

    def __init__(self, model: ForwardModel, transmission: ComplexArray, fits_scale: bool) -> None:
        self.model, self.lit = model, self._behind_object(model, transmission)
        behind = model.engine.forward(self.lit)
        self._index = behind.index
        self.sight: MeasurementOperator = (PixelMeasurement if model.rows else FreeSpaceMeasurement)(
            model, behind.values
        )
        self._root_weights = [
            np.float32(1.0) if weight is None else np.sqrt(weight) for weight in model.weights
        ]
        intensity = self.sight.intensities()
        size = math.sqrt(
            sum(_sum((w * p.amplitude) ** 2) for w, p in zip(self._root_weights, model.recorded, strict=True))
        )
        self.size = size
        self.scale = self._fitted_scale(intensity) if fits_scale else model.scale
        real = behind.values.real.dtype.type
        power = real(self.scale**2)
        residual, seen, self._slopes = [], [], []
        for plane, weight, own in zip(model.recorded, self._root_weights, intensity, strict=True):
            whole = power * own if plane.background is None else power * own + plane.background
            root = np.sqrt(whole + real(DARK * float(whole.mean())))
            residual.append(weight * (plane.amplitude - np.sqrt(whole)) / real(size))
            seen.append(weight * power * own / root)
            self._slopes.append(weight * power / root / real(size))
        self.residual = np.stack(residual)
        self.misfit = math.sqrt(_sum(self.residual**2))
        self._along_scale = np.stack(seen) / math.sqrt(_sum(np.stack(seen) ** 2)) if fits_scale else None
        self._by_intensity = [slope / (2 * power) for slope in self._slopes]

    def without_scale(self, changes: RealArray) -> RealArray:
        """Changes of the residuals, less what another scale does too."""
        if self._along_scale is None:
            return changes
        return changes - self._along_scale * np.float32(np.vdot(self._along_scale, changes))

    def of_exit(self, change: ComplexArray) -> RealArray:
        """Change of the modelled amplitudes with one of the field on the exit grid."""
        return self.of_planes(self.sight.products(change))

    def of_planes(self, products: Sequence[RealArray]) -> RealArray:
        """With pixels' means of Re(conj(u) v), plane by plane."""
        seen = zip(self._slopes, products, strict=True)
        return self.without_scale(np.stack([slope * own for slope, own in seen]))

    def of_plane(self, plane: int, products: RealArray) -> RealArray:
        """With those of one plane, of a change that the others do not see."""
        return self._alone(plane, self._slopes[plane] * products)

    def of_object(self, change: NDArray[Any]) -> RealArray:
        """With one of the transmission."""
        return self.of_exit(self.model.engine.forward(self._behind_object(self.model, change)).values)

    def exit_of_light(self, change: NDArray[Any]) -> ComplexArray:
        """Change of the field on the exit grid with one of the illumination, relative to it."""
        lit = self.lit.with_values((self.lit.values * change).astype(self.lit.values.dtype))
        return self.model.engine.forward(lit).values

    def of_background(self, plane: int) -> RealArray:
        """With an even background as large as the plane's mean recorded intensity."""
        mean = np.float32(np.mean(self.model.recorded[plane].amplitude ** 2))
        return self._alone(plane, self._by_intensity[plane] * mean)

    def to_object(self, left: RealArray) -> ComplexArray:
        """The adjoint of :meth:`of_object`."""
        left = self.without_scale(left)
        change = self.sight.back([slope * one for slope, one in zip(self._slopes, left, strict=True)])
        scene = self.model.engine.scene
        back = self.model.engine.adjoint(Field(scene.exit_grid, change, self.lit.wavelength_um, self._index))
        # Engines' adjoints are those of integrals, and not of sums.
        cells = np.float32(scene.object_grid.cell / scene.exit_grid.cell)
        return np.asarray(cells * back.values * self.model.illumination.values.conj())

    @staticmethod
    def _behind_object(model: ForwardModel, transmission: NDArray[Any]) -> Field:
        values = transmission * model.illumination.values
        return model.illumination.with_values(values.astype(model.illumination.values.dtype))

    def _alone(self, plane: int, change: RealArray) -> RealArray:
        changes = np.zeros_like(self.residual)
        changes[plane] = change
        return self.without_scale(changes)

    def _fitted_scale(self, intensity: list[RealArray]) -> float:
        met = own = 0.0
        for plane, weight, seen in zip(self.model.recorded, self._root_weights, intensity, strict=True):
            behind = 0.0 if plane.background is None else plane.background
            clean = np.sqrt(np.maximum(plane.amplitude**2 - behind, 0.0))
            met += _sum(weight**2 * clean * np.sqrt(seen))
            own += _sum(weight**2 * seen)
        return met / own if met > 0.0 < own else 1.0


def _sum(values: RealArray) -> float:
    return float(np.sum(values, dtype=float))
