"""Free space between two grids: one operator, with its adjoint and what it takes, and its guarded use."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from lensdesign.errors import InputError
from wavesim.fields.angular_spectrum import AngularSpectrum
from wavesim.fields.chirp_z import ChirpZ
from wavesim.fields.field import Field, Grid
from wavesim.fields.guards import WARNED, Pad, SamplingWarning
from wavesim.fields.tilted_samples import TiltedSamples

Tilt = tuple[float, float]


@dataclass(frozen=True)
class FreeSpacePropagator:
    """Free space between two grids, linear in the field.

    Waves that decay along z are left out. Between grids of the same shape and pitch a field goes by Fourier
    transforms, padded as needed, unless so few of its plane waves arrive that chirp-z transforms are smaller;
    by these it goes to any other window and pitch, and by non-uniform ones to a tilted plane.

    Attributes
    ----------
    source, target : Grid
        Both lines, or both planes; the target may lie in front of the source.
    wavelength_um, index : float
        Vacuum wavelength, and refractive index between the grids.
    source_tilt_deg, target_tilt_deg : (about x, about y), optional
        Of one of the planes, turned about the centre of the grid on the other; its own grid is in its own
        frame, at z = 0 (:mod:`wavesim.fields.tilted_samples`).
    pad
        Samples along each axis to pad to, at least the grid's, or "auto": as many as keep every copy of the
        field away from the target. Only between grids of the same shape and pitch.
    band_limit : bool
        Whether waves are left out that walk too far for the padding; False as `pad`.

    Raises
    ------
    InputError
        If grids, tilts or padding do not go together.
    SamplingError
        If a tilt takes too many samples.
    """

    source: Grid
    target: Grid
    wavelength_um: float
    index: float = 1.0
    source_tilt_deg: Tilt | None = None
    target_tilt_deg: Tilt | None = None
    pad: Pad = "auto"
    band_limit: bool = True

    def forward(self, values: Any) -> Any:
        """Values on the target of a field on the source; phases are formed in double, single stays single."""
        return self._way.forward(values)

    def adjoint(self, values: Any) -> Any:
        """Exact adjoint of :meth:`forward` for <f, g> = cell * sum(conj(f) g)."""
        return self._way.adjoint(values)

    def check(self, values: Any, *, coarse_output: bool = False) -> None:
        """Warn of what :meth:`forward` would get wrong, or refuse it; as :func:`propagate`."""
        self._way.check(values, coarse_output)

    @property
    def samples(self) -> int:
        """Of the spectrum."""
        return self._way.samples

    @property
    def seconds(self) -> float:
        """What one use takes on this machine."""
        return self._way.seconds

    @property
    def peak_bytes(self) -> int:
        """Most memory of one use in double precision, its result not counted."""
        return self._way.peak_bytes

    @cached_property
    def _way(self) -> AngularSpectrum | ChirpZ | TiltedSamples:
        if self.source.is_line != self.target.is_line:
            raise InputError("input grid and output grid: both must be lines, or both planes")
        ends = (self.source, self.target, self.wavelength_um, self.index)
        chosen = self.pad != "auto" or not self.band_limit
        tilt = self.source_tilt_deg or self.target_tilt_deg
        if tilt is not None:
            if chosen or (self.source_tilt_deg and self.target_tilt_deg):
                raise InputError("a tilted plane: the other must be straight, and padding is not chosen")
            return TiltedSamples(*ends, tilt, straight=self.source_tilt_deg is None)
        if chosen:
            return AngularSpectrum(*ends, self.pad, self.band_limit)
        chirped = ChirpZ(*ends)
        if (self.source.shape, self.source.pitch_mm) == (self.target.shape, self.target.pitch_mm):
            padded = AngularSpectrum(*ends, self.pad, self.band_limit)
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
    """Carry a field through free space: :class:`FreeSpacePropagator`, guarded.

    Parameters
    ----------
    field
        Single precision stays single; the phases are formed in double.
    to
        Grid, or how far along the axis in mm, onto the field's own samples; in front of the field, or
        negative, if it is to be carried back.
    source_tilt_deg, target_tilt_deg, pad, band_limit
        As of :class:`FreeSpacePropagator`.
    check
        Whether to judge the sampling first (:func:`wavesim.fields.guards.check_propagation`).
    coarse_output
        Whether to accept an output pitch too coarse for the field that falls there.

    Raises
    ------
    SamplingError
        If the samples cannot hold the field on its way, or the spectrum needs too many of them.
    InputError
        If grids, tilts or padding do not go together.

    Warns
    -----
    SamplingWarning
        If a small part of the energy is lost, in the sampling or, where only a distance is given, because it
        leaves the window.
    """
    grid = field.grid.towards(to)
    passage = FreeSpacePropagator(
        field.grid, grid, field.wavelength_um, field.index, source_tilt_deg, target_tilt_deg, pad, band_limit
    )
    if check:
        passage.check(field.values, coarse_output=coarse_output)
    result = Field(grid, passage.forward(field.values), field.wavelength_um, field.index)
    if check and to is not grid:
        _tell_escape(field, result)
    return result


def _tell_escape(field: Field, result: Field) -> None:
    before = field.energy
    lost = 1.0 - result.energy / before if before > 0.0 else 0.0
    if lost > WARNED:
        warnings.warn(
            f"{100.0 * lost:.2g} % of the field's energy leaves the window on its way over "
            f"{abs(result.grid.z_mm - field.grid.z_mm):.4g} mm: the samples inside it stand; give a larger "
            "window if all of the light is wanted",
            SamplingWarning,
            stacklevel=3,
        )
