"""Free space: the choice of a propagator, and its checked use.

Each propagator is linear, and has `forward` and an exact `adjoint`. There are two choices:

- :class:`FreeSpacePropagator` leads from any window to any other. It chooses the padded angular spectrum
  (:mod:`wavesim.fields.angular_spectrum`), chirp-z transforms (:mod:`wavesim.fields.chirp_z`), or the rotated
  spectrum for a tilted plane (:mod:`wavesim.fields.tilted_planes`), by grids, distance and tilt.
- :func:`propagator_to` leads from the spectrum of one field to planes with the same samples, as a sensor's.
  It chooses a transfer function, or a sum over a few parallel planes for a slightly tilted sensor.

Plane waves, their transfer function, the band limit and the padding are in :mod:`wavesim.fields.plane_waves`,
and all checks are in :mod:`wavesim.fields.sampling_checks`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from lensdesign.errors import InputError
from lensdesign.raytrace.plane_plate import PlanePlate
from wavesim.fields.angular_spectrum import AngularSpectrum, TransferFunction
from wavesim.fields.chirp_z import ChirpZ
from wavesim.fields.field import Field, Grid
from wavesim.fields.plane_waves import Pad, centres_mm
from wavesim.fields.sampling_checks import (
    check_propagation,
    check_sample_count,
    check_tilted_propagation,
    warn_of_escape,
)
from wavesim.fields.tilted_planes import RotatedSpectrum, TiltedPropagator, band_wavenumbers

Tilt = tuple[float, float]


@dataclass(frozen=True)
class FreeSpacePropagator:
    """Free space between two grids, as an operator that is linear in the field.

    Evanescent waves are omitted. Between grids of the same shape and pitch the operator is the angular
    spectrum with padding, unless so few plane waves arrive that chirp-z transforms are smaller. Chirp-z
    transforms serve any other window and pitch. Non-uniform Fourier transforms serve a tilted plane.

    Attributes
    ----------
    source, target : Grid
        Both lines, or both planes; the target may lie in front of the source.
    wavelength_um, index : float
        Vacuum wavelength in um, and refractive index between the grids.
    source_tilt_deg, target_tilt_deg : (about x, about y), optional
        Tilt of one of the planes about the centre of the other plane's grid, in degrees. The tilted grid is
        defined in its own frame, at z = 0 (:mod:`wavesim.fields.tilted_planes`).
    pad
        Padded number of samples along each axis, at least the grid's, or "auto": as many as keep every copy
        of the field away from the target. Only for grids of the same shape and pitch.
    band_limit : bool
        Whether to omit waves whose lateral shift is too large for the padding. False only for grids of the
        same shape and pitch.
    plate : PlanePlate, optional
        Plane plate between the grids, such as the cover glass of a sensor. Its thickness is part of the
        distance, and its faces transmit all light. Only between grids without tilt.

    Raises
    ------
    InputError
        If grids, tilts, padding or plate are not compatible.
    SamplingError
        If a tilt needs too many samples.

    Examples
    --------
    >>> import numpy as np
    >>> from wavesim.fields import FreeSpacePropagator, Grid
    >>> grid = Grid((64, 64), 1e-3, 0.0)
    >>> operator = FreeSpacePropagator(grid, grid.at(0.1), 0.532)
    >>> operator.forward(np.ones((64, 64), np.complex64)).dtype
    dtype('complex64')
    """

    source: Grid
    target: Grid
    wavelength_um: float
    index: float = 1.0
    source_tilt_deg: Tilt | None = None
    target_tilt_deg: Tilt | None = None
    pad: Pad = "auto"
    band_limit: bool = True
    plate: PlanePlate | None = None

    def forward(self, values: Any) -> Any:
        """Return the values on the target for a field on the source.

        Phases are computed in double precision; a field in single precision stays in single precision.
        """
        return self._method.forward(values)

    def adjoint(self, values: Any) -> Any:
        """Return the exact adjoint of :meth:`forward` for <f, g> = cell * sum(conj(f) g)."""
        return self._method.adjoint(values)

    def check(self, values: Any, *, coarse_output: bool = False) -> None:
        """Warn of a small sampling error of :meth:`forward`, or refuse a large one, as :func:`propagate`."""
        method = self._method
        if isinstance(method, RotatedSpectrum):
            check_tilted_propagation(method, values, coarse_output)
            return
        self.check_samples()
        field = Field(self.source, values, self.wavelength_um, self.index)
        check_propagation(
            field, self.target, pad=self.pad, band_limit=self.band_limit, coarse_output=coarse_output
        )

    def check_samples(self) -> None:
        """Raise SamplingError if the spectrum needs too many samples, for any field on the source."""
        if isinstance(self._method, RotatedSpectrum):
            return
        distance_mm = abs(self.target.z_mm - self.source.z_mm)
        check_sample_count(
            self._method.counts,
            f"propagation from {centres_mm(self.source)} to {centres_mm(self.target)} mm over "
            f"{distance_mm:.4g} mm at a pitch of {1e3 * self.source.pitch_mm:.4g} µm",
        )

    @property
    def samples(self) -> int:
        """Number of samples of the spectrum."""
        return self._method.samples

    @property
    def seconds(self) -> float:
        """Predicted time of one use on this machine."""
        return self._method.seconds

    @property
    def peak_bytes(self) -> int:
        """Peak memory of one use in double precision, without its result."""
        return self._method.peak_bytes

    @cached_property
    def _method(self) -> AngularSpectrum | ChirpZ | RotatedSpectrum:
        if self.source.is_line != self.target.is_line:
            raise InputError("input grid and output grid: both must be lines, or both planes")
        ends = (self.source, self.target, self.wavelength_um, self.index)
        is_padding_set = self.pad != "auto" or not self.band_limit
        tilt = self.source_tilt_deg or self.target_tilt_deg
        if tilt is not None:
            if is_padding_set or self.plate or (self.source_tilt_deg and self.target_tilt_deg):
                raise InputError(
                    "source_tilt_deg, target_tilt_deg: only one plane can be tilted, and pad, band_limit and "
                    "plate must keep their defaults"
                )
            rotated = RotatedSpectrum(*ends, tilt, straight=self.source_tilt_deg is None)
            check_sample_count(rotated.counts, "propagation to the tilted plane")
            return rotated
        if is_padding_set:
            return AngularSpectrum(*ends, self.pad, self.band_limit, self.plate)
        chirped = ChirpZ(*ends, self.plate)
        if (self.source.shape, self.source.pitch_mm) == (self.target.shape, self.target.pitch_mm):
            padded = AngularSpectrum(*ends, self.pad, self.band_limit, self.plate)
            if padded.samples <= chirped.widest:
                return padded
        return chirped


def propagate(
    field: Field,
    to: Grid | float,
    *,
    source_tilt_deg: Tilt | None = None,
    target_tilt_deg: Tilt | None = None,
    pad: Pad = "auto",
    band_limit: bool = True,
    check: bool = True,
    coarse_output: bool = False,
) -> Field:
    """Propagate a field through free space, after a check of the sampling.

    The method is that of :class:`FreeSpacePropagator`: the band-limited angular spectrum, or chirp-z
    transforms for other windows and pitches.

    Parameters
    ----------
    field
        Field to propagate. Single precision stays single; phases are computed in double precision.
    to
        Target grid, or a distance along the axis in mm for the field's own samples. A target in front of the
        field, or a negative distance, propagates backwards.
    source_tilt_deg, target_tilt_deg, pad, band_limit
        As in :class:`FreeSpacePropagator`.
    check
        Whether to check the sampling first (:func:`wavesim.fields.sampling_checks.check_propagation`).
    coarse_output
        Whether to accept an output pitch that is too coarse to interpolate the field.

    Returns
    -------
    Field
        Field on the target grid.

    Raises
    ------
    SamplingError
        If the samples cannot represent the field, or the spectrum needs too many of them.
    InputError
        If grids, tilts or padding are not compatible.

    Warns
    -----
    SamplingWarning
        If a small fraction of the energy is lost by the sampling or, where only a distance is given, because
        light leaves the window.

    References
    ----------
    K. Matsushima and T. Shimobaba, "Band-limited angular spectrum method for numerical simulation of
    free-space propagation in far and near fields", Opt. Express 17, 19662 (2009).

    Examples
    --------
    >>> import numpy as np
    >>> from wavesim import Field, Grid, propagate
    >>> grid = Grid((256, 256), 2e-3, 0.0)
    >>> beam = Field(grid, np.exp(-grid.radius_squared_mm2() / 0.05**2), wavelength_um=0.532)
    >>> behind = propagate(beam, 1.0)
    >>> round(behind.energy / beam.energy, 6)
    1.0
    """
    grid = field.grid.target_grid(to)
    operator = FreeSpacePropagator(
        field.grid, grid, field.wavelength_um, field.index, source_tilt_deg, target_tilt_deg, pad, band_limit
    )
    if check:
        operator.check(field.values, coarse_output=coarse_output)
    result = Field(grid, operator.forward(field.values), field.wavelength_um, field.index)
    if check and to is not grid:
        warn_of_escape(field, result)
    return result


PlanePropagator = TransferFunction | TiltedPropagator


def propagator_to(
    grid: Grid,
    wavelength_um: float,
    distance_mm: float,
    dtype: DTypeLike,
    shift_mm: tuple[float, float],
    tilt_deg: tuple[float, float],
) -> PlanePropagator:
    """Return the propagator to a parallel plane, or to a tilted one where the tilt is not negligible."""
    rim_mm = math.hypot(*grid.half_widths_mm) * math.hypot(*np.deg2rad(tilt_deg))
    _, differing = band_wavenumbers(grid, wavelength_um)
    # Largest phase difference of waves at the rim, in radians, at which a plane counts as not tilted.
    level_rad = 1e-4
    if rim_mm * differing > level_rad:
        return TiltedPropagator(grid, wavelength_um, distance_mm, dtype, tilt_deg, shift_mm)
    return TransferFunction(grid, wavelength_um, distance_mm, dtype, shift_mm)
