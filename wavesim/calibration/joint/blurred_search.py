"""First search for the pose of the lens with a known object, by blurred intensities.

Fringes of frames and model agree only near the true pose. Intensities that are blurred beyond the fringes at
the border of the field stop's shadow tell the pose from further away.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensdesign.common.arrays import Array
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from wavesim.calibration.joint.pixels import CalibrationPixels
from wavesim.calibration.parameters import Decenter, LensPose, Parameter, Unknowns
from wavesim.forward.linear_model import LinearModel, RealArray

BLUR_PIXELS = 8.0
"""Standard deviation of the blur, in samples of a plane."""

DECENTER_RANGE, TILT_RANGE_DEG = 0.1, 5.0
"""Range of the search: decenters over the lens's diameter, and tilts in deg."""


class BlurredResponse:
    """Blurred amplitudes on a bench: measured less modelled, and the derivatives of this residual.

    Both are relative to the length of the measured amplitudes. `residual` has the shape (pixels,), and
    `jacobian` (pixels, parameters).
    """

    def __init__(
        self,
        pixels: CalibrationPixels,
        unknowns: Unknowns,
        known: NDArray[Any],
        parameters: Sequence[Parameter],
    ) -> None:
        model = pixels.model(unknowns)
        linear = LinearModel(model, known, pixels.scale is None)
        columns = pixels.columns(unknowns, linear, parameters)
        all_measured, all_modelled, changes = [], [], []
        for index, plane in enumerate(model.recorded):
            valid = np.float32(1.0) if plane.known is None else plane.known
            amplitude = linear.modelled_amplitude(index)
            modelled = _blurred_amplitude(valid * amplitude**2)
            all_measured.append(_blurred_amplitude(valid * plane.amplitude**2))
            all_modelled.append(modelled)
            intensity_changes = amplitude * linear.unweighted(index, columns[:, index])
            changes.append([gaussian_filter(one, BLUR_PIXELS) / modelled for one in intensity_changes])
        measured, modelled = np.ravel(all_measured), np.ravel(all_modelled)
        jacobian = np.stack([np.ravel(planes) for planes in zip(*changes, strict=True)], axis=1)
        if pixels.scale is None:
            power = float(modelled @ modelled)
            factor = float(modelled @ measured) / power
            jacobian = factor * (jacobian - np.outer(modelled, modelled @ jacobian / power))
            modelled = factor * modelled
        size = float(np.linalg.norm(measured))
        self.residual, self.jacobian = (measured - modelled) / size, -jacobian / size


def blurred_search(
    pixels: CalibrationPixels, known: NDArray[Any], parameters: Sequence[Parameter], start: Unknowns
) -> Unknowns:
    """Return a bench whose pose, as far as it is sought, fits the blurred frames of a known object.

    Raises
    ------
    TransferLensError
        If the model raises it at the start. Later benches at which it raises are avoided.
    """
    from scipy.optimize import least_squares

    pose = [parameter for parameter in parameters if isinstance(parameter, LensPose)]
    if not pose:
        return start
    responses: dict[bytes, BlurredResponse] = {}

    def response(values: Array) -> BlurredResponse:
        key = values.tobytes()
        if key not in responses:
            unknowns = start.changed(pose, values.tolist())
            responses[key] = BlurredResponse(pixels, unknowns, known, pose)
        return responses[key]

    first = response(start.of(pose)).residual

    def residual(values: Array) -> RealArray:
        try:
            return response(values).residual
        except TransferLensError:
            return np.ones_like(first)

    def jacobian(values: Array) -> RealArray:
        return response(values).jacobian

    search_range = _search_range(pixels.scene.lens, pose)
    found = least_squares(
        residual,
        start.of(pose),
        jacobian,
        bounds=(-search_range, search_range),
        x_scale=[parameter.typical for parameter in pose],
        ftol=3e-3,  # the search only needs to come near
        max_nfev=8,
    )
    return start.changed(pose, found.x.tolist())


def _search_range(lens: Lens, pose: Sequence[LensPose]) -> Array:
    diameter_mm = 2.0 * min(surface.semi_diameter_mm or np.inf for surface in lens.surfaces)
    decenter_mm = DECENTER_RANGE * (diameter_mm if np.isfinite(diameter_mm) else abs(lens.object_z_mm))
    return np.array([decenter_mm if isinstance(one, Decenter) else TILT_RANGE_DEG for one in pose])


def _blurred_amplitude(intensity: RealArray) -> RealArray:
    # Fraction of the mean intensity added under the root: dark pixels then have finite derivatives.
    dark = 1e-6
    smooth = gaussian_filter(intensity, BLUR_PIXELS)
    return np.asarray(np.sqrt(np.maximum(smooth, 0.0) + dark * smooth.mean()))
