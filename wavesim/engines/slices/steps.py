"""From slice to slice through a lens: waves in front of a surface, what each slice takes, waves behind it.

Works in the precision and the memory of the field that is given, by any array library that indexes as NumPy
does (CuPy). Factors of plane waves are kept from step to step; where the field is not one of NumPy's in
double precision, they are made some rows at a time, with phases in float64, and need little work space.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from wavesim.engines.slices.planes import SlicedSurface
from wavesim.engines.surfaces.grids import WorkingGrid
from wavesim.engines.surfaces.waves import Medium
from wavesim.fields.plane_waves import axial_wavenumbers, fft_frequencies, wave_factor
from wavesim.runtime.arrays import array_module, fftn, ifftn

STEP_GRAIN_MM = 1e-12
"""Steps between planes are rounded to it, so that equal ones are equal; some thousand err by 1e-5 rad."""

BLOCK_SAMPLES = 1 << 24
"""For which factors are made at a time."""


class Through:
    """From the plane of the first slice to that of the last.

    Parameters
    ----------
    working
        Grid and media.
    surfaces
        Samples of every surface by slice.
    """

    def __init__(self, working: WorkingGrid, surfaces: Sequence[SlicedSurface]) -> None:
        self.grid, self.media, self.surfaces = working.grid, working.media, surfaces
        self.start_mm = float(surfaces[0].before_mm[0])
        self.end_mm = float(surfaces[-1].behind_mm[-1])

    def forward(self, field: Any) -> Any:
        """Field at the last slice of one at the first, which may be overwritten."""
        spectrum = fftn(field, norm="ortho", overwrite=True)
        here = self.start_mm
        for (front, back), surface in zip(pairwise(self.media), self.surfaces, strict=True):
            _carry(front, spectrum, surface.before_mm[0] - here)
            spectrum = through_surface(front, back, surface, spectrum)
            here = float(surface.behind_mm[-1])
        return ifftn(spectrum, norm="ortho", overwrite=True)

    def adjoint(self, field: Any) -> Any:
        """Field at the first slice of one at the last: the exact adjoint."""
        spectrum = fftn(field, norm="ortho", overwrite=True)
        here = self.end_mm
        surfaces = list(zip(pairwise(self.media), self.surfaces, strict=True))
        for (front, back), surface in reversed(surfaces):
            _carry(back, spectrum, surface.behind_mm[-1] - here)
            spectrum = through_surface(back, front, surface, spectrum, back=True)
            here = float(surface.before_mm[0])
        return ifftn(spectrum, norm="ortho", overwrite=True)


def through_surface(
    source: Medium, target: Medium, surface: SlicedSurface, spectrum: Any, back: bool = False
) -> Any:
    """Take the waves of one medium at the first slice, and sum those of the other at the last.

    Backwards from the last slice to the first, with conjugate factors, it is the exact adjoint.

    Parameters
    ----------
    source, target
        Media in front of the surface and behind it; the other way round if backwards.
    surface
        Its slices.
    spectrum
        Of the field, in FFT order; changed.
    back
        Whether to go backwards.
    """
    xp = array_module(spectrum)
    order = range(len(surface.parts))
    start, end = surface.before_mm, surface.behind_mm
    if back:
        order, start, end = order[::-1], end, start
    arriving, leaving = _Steps(source), _Steps(target)
    _keep_band(source, spectrum)
    total = xp.zeros_like(spectrum)
    last = order[0]
    for q in order:
        arriving.carry(spectrum, float(start[q] - start[last]))
        leaving.carry(total, float(end[q] - end[last]))
        part = surface.parts[q]
        factor = surface.factors[part].conj() if back else surface.factors[part]
        total += _masked(spectrum, xp.asarray(surface.pixels[part]), xp.asarray(factor, dtype=spectrum.dtype))
        last = q
    # The borders of a slice send light under all angles; the grid holds that of the band.
    _keep_band(target, total)
    return total


def _masked(spectrum: Any, pixels: Any, factor: Any) -> Any:
    """Spectrum of what one slice leaves of a wave."""
    wave = ifftn(spectrum, norm="ortho")
    samples = wave.ravel()
    values = samples[pixels] * factor
    samples[...] = 0.0
    samples[pixels] = values
    return fftn(wave, norm="ortho", overwrite=True)


class _Steps:
    """Factors of plane waves from plane to plane; the last one is kept, since steps mostly repeat."""

    def __init__(self, medium: Medium) -> None:
        self.medium = medium
        self.step_mm = 0.0
        self.factor: Any = None

    def carry(self, spectrum: Any, step_mm: float) -> None:
        step_mm = round(step_mm / STEP_GRAIN_MM) * STEP_GRAIN_MM
        if step_mm == 0.0:
            return
        if step_mm != self.step_mm:
            # Frees the old factor before the new one is made.
            self.factor = None
            self.step_mm, self.factor = step_mm, _factor(self.medium, spectrum, step_mm)
        spectrum *= self.factor


def _carry(medium: Medium, spectrum: Any, distance_mm: float) -> None:
    spectrum *= _factor(medium, spectrum, distance_mm)


def _factor(medium: Medium, like: Any, distance_mm: float) -> Any:
    """As :meth:`Medium.over`, in the library and precision of an array."""
    if _is_plain(like):
        return medium.over(distance_mm)
    xp = array_module(like)
    result = xp.empty(like.shape, dtype=like.dtype)
    for rows, kz in _blocks(medium, xp):
        inside = kz > medium.smallest_kz_per_mm
        result[rows] = wave_factor(kz * distance_mm, like.dtype, xp)
        result[rows] *= inside
    return result


def _keep_band(medium: Medium, spectrum: Any) -> None:
    """Leave out waves beyond a medium's band."""
    if _is_plain(spectrum):
        spectrum *= medium.inside
        return
    for rows, kz in _blocks(medium, array_module(spectrum)):
        spectrum[rows] *= kz > medium.smallest_kz_per_mm


def _is_plain(values: Any) -> bool:
    return isinstance(values, np.ndarray) and values.dtype == np.complex128


def _blocks(medium: Medium, xp: Any) -> Iterator[tuple[slice, Any]]:
    """Axial wave numbers of a medium, some rows at a time."""
    shape = medium.grid.shape
    cycles = fft_frequencies(shape, medium.grid.pitch_mm, xp)
    rows = max(BLOCK_SAMPLES // math.prod(shape[1:]), 1)
    for start in range(0, shape[0], rows):
        part = slice(start, start + rows)
        yield (
            part,
            axial_wavenumbers([cycles[0][part], *cycles[1:]], medium.wavelength_um, medium.index, xp)[0],
        )
