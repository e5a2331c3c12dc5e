"""Residuals of the amplitudes behind a mounted lens, and their derivatives with respect to the mounting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from wavesim.calibration.motion import gradient, motion
from wavesim.calibration.parameters import LensPose, Parameter, PlaneDistance, WorkingDistance
from wavesim.fields.field import Field
from wavesim.fields.plane_waves import PlaneWaves
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.pixel_means import PixelMeans
from wavesim.scene.system_state import SystemState

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Response:
    """Amplitudes of all planes as one vector, divided by the length of the measured one.

    Attributes
    ----------
    residual : ndarray, shape (pixels,)
        Measured less modelled amplitudes.
    changes : ndarray, shape (parameters, pixels)
        Change of the modelled amplitudes per unit of each parameter, for a fixed object.
    """

    residual: RealArray
    changes: RealArray

    @property
    def misfit(self) -> float:
        """Length of the residual."""
        return float(np.linalg.norm(self.residual))


def mounting_response(
    model: ChannelModel,
    transmission: ComplexArray,
    mounting: SystemState,
    parameters: Sequence[Parameter],
    *,
    blur_pixels: float = 0.0,
    fits_scale: bool = False,
) -> Response:
    """Compare measured amplitudes with those of an object behind a mounted lens.

    Parameters
    ----------
    model
        Forward model of the mounted lens.
    transmission
        Transmission of the object, on the model's object grid.
    mounting
        Mounting of the model's lens.
    parameters
        Parameters for which derivatives are computed.
    blur_pixels
        Standard deviation, in pixels, of a Gaussian that smooths all intensities.
    fits_scale
        Whether measured amplitudes are known only up to a factor.
    """
    lit = model.illumination.with_values(transmission * model.illumination.values)
    exit_field = model.engine.forward(lit)
    spectrum = scipy.fft.fftn(exit_field.values, workers=-1)
    lens_changes = {
        parameter: scipy.fft.fftn(_exit_field_change(model, lit, exit_field, mounting, parameter), workers=-1)
        for parameter in parameters
        if isinstance(parameter, LensPose | WorkingDistance)
    }
    kz = PlaneWaves.of(exit_field.grid, exit_field.wavelength_um, exit_field.index).kz
    along_z = 1j * kz.astype(model.illumination.values.real.dtype)
    measured, modelled, changes = [], [], []
    for plane_index, (plane, weight) in enumerate(zip(model.recorded, model.weights, strict=True)):
        root_weight = 1.0 if weight is None else np.sqrt(weight)
        own = _PlaneAmplitudes(model, plane_index, spectrum, plane.known, blur_pixels)
        measured.append(np.ravel(root_weight * own.amplitude_of(plane.amplitude**2)))
        modelled.append(np.ravel(root_weight * own.amplitude))
        rows = []
        for parameter in parameters:
            if parameter in lens_changes:
                rows.append(np.ravel(root_weight * own.amplitude_change(lens_changes[parameter])))
            elif isinstance(parameter, PlaneDistance) and parameter.plane == plane_index:
                rows.append(np.ravel(root_weight * own.amplitude_change(along_z * spectrum)))
            else:
                rows.append(np.zeros(own.amplitude.size, own.amplitude.dtype))
        changes.append(np.stack(rows) if rows else np.zeros((0, own.amplitude.size), np.float32))
    return _response(
        np.concatenate(measured),
        np.concatenate(modelled),
        np.concatenate(changes, axis=1),
        None if fits_scale else model.scale,
    )


def _response(recorded: RealArray, modelled: RealArray, changes: RealArray, scale: float | None) -> Response:
    """Return the response relative to the measured amplitudes; the effect of a fitted scale is removed."""
    size = float(np.linalg.norm(recorded))
    if scale is None:
        direction = modelled / np.linalg.norm(modelled)
        scale = float(np.dot(modelled, recorded)) / float(np.dot(modelled, modelled))
        changes = changes - np.outer(changes @ direction, direction)
    return Response((recorded - scale * modelled) / size, (scale / size) * changes)


def _exit_field_change(
    model: ChannelModel,
    lit: Field,
    exit_field: Field,
    mounting: SystemState,
    parameter: LensPose | WorkingDistance,
) -> ComplexArray:
    """Return the change of the field on the exit grid per unit of a parameter of lens or object."""
    if isinstance(parameter, WorkingDistance):
        along_z = gradient(lit)[2]
        return np.asarray(model.engine.forward(lit.with_values(along_z)).values)
    source_motion = motion(lit, mounting, parameter)
    change = motion(exit_field, mounting, parameter)
    change -= model.engine.forward(lit.with_values(source_motion)).values
    return change


class _PlaneAmplitudes:
    """Amplitudes on a measured plane, and their changes."""

    def __init__(
        self,
        model: ChannelModel,
        plane_index: int,
        spectrum: ComplexArray,
        known: NDArray[np.bool_] | None,
        blur_pixels: float,
    ) -> None:
        self.pixels = model.pixels or PixelMeans(model.engine.scene.exit_grid, 0.0)
        self.propagator, self.known, self.blur_pixels = (
            model.planes[plane_index].propagator,
            known,
            blur_pixels,
        )
        self.rows = self.pixels.propagate(spectrum, self.propagator)
        self.amplitude = self.amplitude_of(self.pixels.intensity(self.rows))

    def amplitude_of(self, intensity: RealArray) -> RealArray:
        """Return the amplitude of blurred intensities in valid pixels."""
        smooth = self._blurred(intensity)
        # Fraction of the mean intensity added under the root: dark pixels then have finite derivatives.
        dark = 1e-6
        return np.asarray(np.sqrt(np.maximum(smooth, 0.0) + dark * smooth.mean()))

    def amplitude_change(self, change_spectrum: ComplexArray) -> RealArray:
        """Return the change of the amplitude for a change of the exit field."""
        change = self.pixels.propagate(change_spectrum, self.propagator)
        return np.asarray(self._blurred(self.pixels.products(self.rows, change)) / self.amplitude)

    def _blurred(self, intensity: RealArray) -> RealArray:
        if self.known is not None:
            intensity = intensity * self.known
        return gaussian_filter(intensity, self.blur_pixels) if self.blur_pixels else intensity
