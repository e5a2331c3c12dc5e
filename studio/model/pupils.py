"""Wavefronts, Strehl ratios and contrast of a lens with deviations, and a small patch imaged through it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from studio.model.whatif import WhatIf
from wavesim.pupil.characteristic import PupilSampler
from wavesim.pupil.line_pairs import line_pair_contrast
from wavesim.pupil.patch_reconstructor import PatchReconstructor
from wavesim.pupil.pupil import ReconstructionPupil, mtf, psf, refocus, rms_waves, strehl

SAMPLES, COARSE = 128, 48
"""Samples across the pupil, as in `wavesim pupil`, and while a value changes."""

COARSE_PATCH = 67
"""Samples of the stop for the patch while a value changes."""


@dataclass(frozen=True, eq=False)
class PupilAnalysis:
    """Quality of the pupil of one object point.

    Attributes
    ----------
    field_mm
        Height of the object point along y in mm.
    strehl, rms_waves
        Strehl ratio and root mean square wavefront error in waves, after refocusing.
    shift_um, refocus_um
        Displacement of the reconstructed object, and refocusing distance, in um.
    widths_um, contrast
        Line widths in um, and the smaller of the contrasts of lines along both axes.
    waves : ndarray, shape (samples, samples)
        Path difference in waves; NaN outside the pupil.
    psf_half_um
        Half the side of the point spread's window in um.
    psf_decades : ndarray
        Decimal logarithm of the point spread, relative to the peak of a perfect pupil; row: y, column: x.
    frequencies_lp_per_mm, mtf, perfect_mtf : ndarray
        Spatial frequencies in the object plane, the smaller modulation along both axes, and that of a pupil
        without aberrations.
    """

    field_mm: float
    strehl: float
    rms_waves: float
    shift_um: tuple[float, float]
    refocus_um: float
    widths_um: tuple[float, ...]
    contrast: tuple[float, ...]
    waves: Array
    psf_half_um: float
    psf_decades: Array
    frequencies_lp_per_mm: Array
    mtf: Array
    perfect_mtf: Array


def analyse_pupils(
    lens: Lens, what_if: WhatIf, heights_mm: Sequence[float], samples: int = SAMPLES
) -> tuple[PupilAnalysis, ...]:
    """Return the quality of the pupils of object points, as in `wavesim pupil`.

    Raises
    ------
    InputError
        If rays do not arrive.
    """
    state = what_if.state(lens)
    # Line widths, as multiples of the resolution wavelength / (2 NA).
    widths = tuple(float(w * _resolution_um(lens)) for w in (1.0, 1.25, 1.6, 2.0, 2.8))
    found = []
    for height in heights_mm:
        registered = refocus(_sampler(lens, float(height), samples).pupil(state))
        pupil = registered.pupil
        inside = pupil.valid_on_grid > 0.0
        x, y = registered.shift_um.tolist()
        contrast = tuple(
            min(line_pair_contrast(pupil, width, "x"), line_pair_contrast(pupil, width, "y"))
            for width in widths
        )
        waves = np.where(inside, pupil.waves_on_grid, np.nan)
        half_um, decades = _point_spread(pupil, samples)
        cut_off = 2e3 * pupil.grid.half_width / pupil.wavelength_um
        frequencies = np.linspace(0.0, cut_off, 49)
        perfect = ReconstructionPupil(pupil.grid, np.zeros_like(pupil.opd_mm), pupil.valid)
        found.append(
            PupilAnalysis(
                height,
                strehl(pupil),
                rms_waves(pupil),
                (x, y),
                registered.refocus_um,
                widths,
                contrast,
                waves,
                half_um,
                decades,
                frequencies,
                np.minimum(mtf(pupil, frequencies, "x"), mtf(pupil, frequencies, "y")),
                np.minimum(mtf(perfect, frequencies, "x"), mtf(perfect, frequencies, "y")),
            )
        )
    return tuple(found)


PSF_DECADES = 4.0
"""Range of the point spread that is shown, in decades."""


def _point_spread(pupil: ReconstructionPupil, samples: int) -> tuple[float, Array]:
    """Return half the side of the window, which holds four Airy disks, and the point spread in decades."""
    airy_diameter_um = 1.22 * pupil.wavelength_um / pupil.grid.half_width
    half_um = min(2.0 * airy_diameter_um, 0.5 * pupil.grid.window_um)
    _, intensity = psf(pupil, half_um, points=97 if samples == SAMPLES else 49)
    return half_um, np.log10(np.maximum(intensity, 10.0**-PSF_DECADES))


@lru_cache(maxsize=8)
def _sampler(lens: Lens, height_mm: float, samples: int) -> PupilSampler:
    """Return the cached pupil sampler of a lens, which does not depend on the deviations."""
    return PupilSampler(lens, (0.0, height_mm), samples=samples)


@dataclass(frozen=True, eq=False)
class PatchPicture:
    """A small patch of a chart, reconstructed through the actual and through the nominal lens.

    Attributes
    ----------
    side_um
        Side of the patch in um.
    actual, nominal : ndarray
        Intensities; row: y, column: x.
    """

    side_um: float
    actual: Array
    nominal: Array


def patch_picture(lens: Lens, what_if: WhatIf, height_mm: float, samples: int | None = None) -> PatchPicture:
    """Propagate a chart of bars through the lens with deviations, and back through the nominal lens.

    Parameters
    ----------
    lens, what_if
        The lens, and its deviations from the design.
    height_mm
        Field height of the patch's centre along y in mm.
    samples
        Samples of the stop; see :class:`wavesim.PatchReconstructor`.

    Raises
    ------
    InputError
        If rays do not arrive.
    """
    reconstructor = _reconstructor(lens, height_mm, samples)
    actual = reconstructor.perturbed(what_if.state(lens)).reconstruct(_chart(reconstructor), "focus").values
    return PatchPicture(reconstructor.patch_um, np.abs(actual) ** 2, _nominal(lens, height_mm, samples))


@lru_cache(maxsize=4)
def _reconstructor(lens: Lens, height_mm: float, samples: int | None) -> PatchReconstructor:
    # Side of the patch for a resolution of 0.532 um; it is proportional to the resolution.
    patch_um = 16.0
    return PatchReconstructor(
        lens, (0.0, height_mm), patch_um=patch_um / 0.532 * _resolution_um(lens), samples=samples
    )


@lru_cache(maxsize=4)
def _nominal(lens: Lens, height_mm: float, samples: int | None) -> Array:
    reconstructor = _reconstructor(lens, height_mm, samples)
    return np.asarray(
        np.abs(reconstructor.perturbed().reconstruct(_chart(reconstructor), "focus").values) ** 2
    )


def _resolution_um(lens: Lens) -> float:
    return 0.5 * lens.wavelengths_um[0] / lens.object.numerical_aperture


def _chart(reconstructor: PatchReconstructor) -> Array:
    """Return a chart: three groups of three bars in each direction, 2, 1.5, 1.1 times the resolution wide."""
    xy, unit = reconstructor.patch.coordinates_um, _resolution_um(reconstructor.lens)
    chart = np.zeros(reconstructor.patch.shape)
    for row, width in ((-8.2, 2.0), (1.5, 1.5), (9.3, 1.1)):
        for column, across in ((-7.0, True), (7.0, False)):
            x, y = np.meshgrid(xy / unit - column, xy / unit - row)
            u, v = (x, y) if across else (y, x)
            bars = np.any([np.abs(u - 2.0 * width * k) <= 0.5 * width for k in (-1, 0, 1)], axis=0)
            chart = np.maximum(chart, bars * (np.abs(v) <= 2.5 * width))
    return chart
