"""What is left of recorded amplitudes behind a mounted lens, and how it changes as the mounting does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from wavesim.calibration.motion import gradient, motion
from wavesim.fields.field import Field
from wavesim.fields.plane_waves import axial_wavenumbers, fft_frequencies
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.recording.pixel_means import PixelMeans
from wavesim.scene.placement import Placement
from wavesim.sensor.mounting import WORKING_DISTANCE, plane_of

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]

DARK = 1e-6
"""Share of the mean intensity that keeps roots of dark pixels smooth."""


@dataclass(frozen=True, eq=False)
class Response:
    """Amplitudes of all planes as one vector, as shares of the length of the recorded one.

    Attributes
    ----------
    residual : ndarray, shape (pixels,)
        Recorded less modelled.
    changes : ndarray, shape (parameters, pixels)
        Of the modelled, for a unit of each parameter; the object stays as it is.
    """

    residual: RealArray
    changes: RealArray

    @property
    def misfit(self) -> float:
        """Length of the residual."""
        return float(np.linalg.norm(self.residual))

    @property
    def gradient(self) -> NDArray[np.float64]:
        """Of half the squared misfit."""
        return -np.asarray(self.changes @ self.residual, float)

    @property
    def curvature(self) -> NDArray[np.float64]:
        """Second derivatives of half the squared misfit, as far as the model is linear (Gauss-Newton)."""
        return np.asarray(self.changes @ self.changes.T, float)


def mounting_response(
    model: ForwardModel,
    transmission: ComplexArray,
    mounting: Placement,
    parameters: Sequence[str],
    *,
    blur_pixels: float = 0.0,
    fits_scale: bool = False,
) -> Response:
    """Compare recorded amplitudes with those of an object behind a mounted lens.

    Parameters
    ----------
    model
        Of the mounted lens.
    transmission
        Of the object, on the model's object grid.
    mounting
        Of the model's lens.
    parameters
        For which derivatives are wanted.
    blur_pixels
        Standard deviation of a Gaussian that smooths all intensities.
    fits_scale
        Whether recorded amplitudes are known but for a factor.
    """
    lit = model.illumination.with_values(transmission * model.illumination.values)
    behind = model.engine.forward(lit)
    spectrum = scipy.fft.fftn(behind.values, workers=-1)
    lens_changes = {
        name: scipy.fft.fftn(_change_behind(model, lit, behind, mounting, name), workers=-1)
        for name in parameters
        if plane_of(name) is None
    }
    cycles = fft_frequencies(behind.grid.shape, behind.grid.pitch_mm)
    kz, _ = axial_wavenumbers(cycles, behind.wavelength_um, behind.index)
    along_z = 1j * kz.astype(model.illumination.values.real.dtype)
    recorded, seen, slopes = [], [], []
    for number, (plane, weight) in enumerate(zip(model.recorded, model.weights, strict=True)):
        root = 1.0 if weight is None else np.sqrt(weight)
        measure = _Plane(model, number, spectrum, plane.known, blur_pixels)
        recorded.append(np.ravel(root * measure.root(plane.amplitude**2)))
        seen.append(np.ravel(root * measure.amplitude))
        parts = []
        for name in parameters:
            moved = plane_of(name)
            if moved is None:
                parts.append(np.ravel(root * measure.slope(lens_changes[name])))
            elif moved == number:
                parts.append(np.ravel(root * measure.slope(along_z * spectrum)))
            else:
                parts.append(np.zeros(measure.amplitude.size, measure.amplitude.dtype))
        slopes.append(np.stack(parts) if parts else np.zeros((0, measure.amplitude.size), np.float32))
    return _response(
        np.concatenate(recorded),
        np.concatenate(seen),
        np.concatenate(slopes, axis=1),
        None if fits_scale else model.scale,
    )


def _response(recorded: RealArray, seen: RealArray, changes: RealArray, scale: float | None) -> Response:
    """Relative to the recorded; where the scale is to be fitted, what it can do is taken out."""
    size = float(np.linalg.norm(recorded))
    if scale is None:
        along = seen / np.linalg.norm(seen)
        scale = float(np.dot(seen, recorded)) / float(np.dot(seen, seen))
        changes = changes - np.outer(changes @ along, along)
    return Response((recorded - scale * seen) / size, (scale / size) * changes)


def _change_behind(
    model: ForwardModel, lit: Field, behind: Field, mounting: Placement, name: str
) -> ComplexArray:
    """Change of the field on the exit grid for a unit of a parameter of lens or object."""
    if name == WORKING_DISTANCE:
        farther = gradient(lit)[2]
        return np.asarray(model.engine.forward(lit.with_values(farther)).values)
    with_sources = motion(lit, mounting, name)
    change = motion(behind, mounting, name)
    change -= model.engine.forward(lit.with_values(with_sources)).values
    return change


class _Plane:
    """Amplitudes on a recorded plane, and their changes."""

    def __init__(
        self,
        model: ForwardModel,
        number: int,
        spectrum: ComplexArray,
        known: NDArray[np.bool_] | None,
        blur_pixels: float,
    ) -> None:
        self.pixels = model.pixels or PixelMeans(model.engine.scene.exit_grid, 0.0)
        self.way, self.known, self.blur_pixels = model.ways[number], known, blur_pixels
        self.rows = self.pixels.carried(spectrum, self.way)
        self.amplitude = self.root(self.pixels.intensity(self.rows))

    def root(self, intensity: RealArray) -> RealArray:
        """Amplitude of blurred known intensities."""
        smooth = self._blurred(intensity)
        return np.asarray(np.sqrt(np.maximum(smooth, 0.0) + DARK * smooth.mean()))

    def slope(self, change_spectrum: ComplexArray) -> RealArray:
        """Change of the amplitude with that of the field at the exit."""
        change = self.pixels.carried(change_spectrum, self.way)
        return np.asarray(self._blurred(self.pixels.products(self.rows, change)) / self.amplitude)

    def _blurred(self, intensity: RealArray) -> RealArray:
        if self.known is not None:
            intensity = intensity * self.known
        return gaussian_filter(intensity, self.blur_pixels) if self.blur_pixels else intensity
