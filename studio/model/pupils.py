"""Wavefronts, Strehl ratios and contrast of a lens that is not as designed, and a small patch through it."""

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
from wavesim.pupil.patch_chain import PatchChain
from wavesim.pupil.pupil import refocus, rms_waves, strehl

SAMPLES, COARSE = 128, 48
"""Across the pupil: as `wavesim pupil`; and while a value moves."""

WIDTHS = (1.0, 1.25, 1.6, 2.0, 2.8)
"""Line widths, in units of wavelength / (2 NA)."""

PATCH_UM = 16.0
"""Side of the patch for a resolution of 0.532 um; others in proportion."""

COARSE_PATCH = 67
"""Samples of the stop for the patch while a value moves."""


@dataclass(frozen=True, eq=False)
class PupilFigures:
    """What comes back from one object point.

    Attributes
    ----------
    field_mm
        Height of the object point, along y.
    strehl, rms_waves
        After refocusing.
    shift_um, refocus_um
        By how much the object comes back displaced, and is refocused.
    widths_um, contrast
        Line widths, and contrasts of lines along both axes, the smaller of the two.
    waves : ndarray, shape (samples, samples)
        Path difference; NaN outside the pupil.
    """

    field_mm: float
    strehl: float
    rms_waves: float
    shift_um: tuple[float, float]
    refocus_um: float
    widths_um: tuple[float, ...]
    contrast: tuple[float, ...]
    waves: Array


def pupil_figures(
    lens: Lens, what_if: WhatIf, heights_mm: Sequence[float], samples: int = SAMPLES
) -> tuple[PupilFigures, ...]:
    """Figures at object points, as `wavesim pupil` has them.

    Raises
    ------
    InputError
        If rays do not arrive.
    """
    placement = what_if.placement(lens)
    widths = tuple(float(w * _resolution_um(lens)) for w in WIDTHS)
    found = []
    for height in heights_mm:
        registered = refocus(_sampler(lens, float(height), samples).pupil(placement))
        pupil = registered.pupil
        inside = pupil.valid_on_grid > 0.0
        x, y = registered.shift_um.tolist()
        contrast = tuple(
            min(line_pair_contrast(pupil, width, "x"), line_pair_contrast(pupil, width, "y"))
            for width in widths
        )
        waves = np.where(inside, pupil.waves_on_grid, np.nan)
        found.append(
            PupilFigures(
                height,
                strehl(pupil),
                rms_waves(pupil),
                (x, y),
                registered.refocus_um,
                widths,
                contrast,
                waves,
            )
        )
    return tuple(found)


@lru_cache(maxsize=8)
def _sampler(lens: Lens, height_mm: float, samples: int) -> PupilSampler:
    """Kept while only what is off changes."""
    return PupilSampler(lens, (0.0, height_mm), samples=samples)


@dataclass(frozen=True, eq=False)
class PatchPicture:
    """A chart's small patch as it comes back, and as the nominal lens brings it back.

    Attributes
    ----------
    side_um
        Of the patch.
    actual, nominal : ndarray
        Intensities; row: y, column: x.
    """

    side_um: float
    actual: Array
    nominal: Array


def patch_picture(lens: Lens, what_if: WhatIf, height_mm: float, samples: int | None = None) -> PatchPicture:
    """A chart of bars through the lens as it may be, and back through the nominal one, refocused.

    Parameters
    ----------
    lens, what_if
        The lens, and how far it is off.
    height_mm
        Of the object point in the patch's middle, along y.
    samples
        As of :class:`wavesim.PatchChain`.

    Raises
    ------
    InputError
        If rays do not arrive.
    """
    chain = _chain(lens, height_mm, samples)
    actual = chain.perturbed(what_if.placement(lens)).returned(_chart(chain), "focus").values
    return PatchPicture(chain.patch_um, np.abs(actual) ** 2, _nominal(lens, height_mm, samples))


@lru_cache(maxsize=4)
def _chain(lens: Lens, height_mm: float, samples: int | None) -> PatchChain:
    return PatchChain(
        lens, (0.0, height_mm), patch_um=PATCH_UM / 0.532 * _resolution_um(lens), samples=samples
    )


@lru_cache(maxsize=4)
def _nominal(lens: Lens, height_mm: float, samples: int | None) -> Array:
    chain = _chain(lens, height_mm, samples)
    return np.asarray(np.abs(chain.perturbed().returned(_chart(chain), "focus").values) ** 2)


def _resolution_um(lens: Lens) -> float:
    return 0.5 * lens.wavelengths_um[0] / lens.object.numerical_aperture


def _chart(chain: PatchChain) -> Array:
    """Three groups of three bars in each direction, 2, 1.5 and 1.1 times the resolution wide."""
    xy, unit = chain.patch.coordinates_um, _resolution_um(chain.lens)
    chart = np.zeros(chain.patch.shape)
    for row, width in ((-8.2, 2.0), (1.5, 1.5), (9.3, 1.1)):
        for column, across in ((-7.0, True), (7.0, False)):
            x, y = np.meshgrid(xy / unit - column, xy / unit - row)
            u, v = (x, y) if across else (y, x)
            bars = np.any([np.abs(u - 2.0 * width * k) <= 0.5 * width for k in (-1, 0, 1)], axis=0)
            chart = np.maximum(chart, bars * (np.abs(v) <= 2.5 * width))
    return chart
