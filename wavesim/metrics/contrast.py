"""How good a reconstruction is: resolved elements, correlation, PSNR and SSIM, the support of its spectrum.

A correlation of amplitudes near 1 does not mean that the object is right: a bright ground alone makes most of
it. :func:`object_correlation` therefore takes the known illumination out of both sides first, and truth and
result are compared as the lens passes them (:mod:`wavesim.metrics.transmitted_band`), which no
reconstruction can better.

Source of the structural similarity: Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, "Image quality
assessment: from error visibility to structural similarity", IEEE Trans. Image Process. 13, 600 (2004), by
scikit-image.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_choice
from wavesim.fields.coverage import validate_sampling
from wavesim.fields.field import Field, Grid
from wavesim.metrics.similarity import Mask, Picture
from wavesim.runtime.threads import row_blocks
from wavesim.targets.bar_sets import SetContrast, set_contrast
from wavesim.targets.patterns import Polarity
from wavesim.targets.usaf import UsafElement

RESOLVED_CONTRAST = 0.2
"""From which contrast on lines count as resolved, as in `smallest_resolved_line_width_um`."""


@dataclass(frozen=True, eq=False)
class ElementContrast:
    """Contrast of an element's two sets.

    Attributes
    ----------
    element : UsafElement
        Which one.
    x, y : SetContrast
        Of the set whose bars follow each other along x, and along y.
    """

    element: UsafElement
    x: SetContrast
    y: SetContrast

    @property
    def contrast(self) -> float:
        """The lower one of both sets; NaN if either is."""
        return float(np.minimum(self.x.contrast, self.y.contrast))

    def resolved(self, threshold: float = RESOLVED_CONTRAST) -> bool:
        """Return True if both sets reach a contrast and every bar is brighter than every gap.

        Reversed contrast is negative and two bars in place of three leave the weakest contrast negative:
        neither counts.
        """
        return all(one.contrast >= threshold and one.weakest_contrast > 0.0 for one in (self.x, self.y))


def bar_contrast(
    picture: Picture, grid: Grid, element: UsafElement, ground: Polarity = "bright"
) -> ElementContrast:
    """Contrast of an element's bars where the chart has them.

    Intensity is averaged over the middle of each bar and gap: half a line width across, three along, cells
    weighted by the part of them that lies within. Nothing is searched for: lines that are displaced by half a
    period are reversed, and count as such. :func:`wavesim.metrics.charts.chart_resolution` finds a
    displaced chart first.

    Parameters
    ----------
    picture
        Intensity if real; of a complex amplitude, the squared modulus is taken.
    grid
        A plane, in the chart's coordinates.
    element
        Which one, and where.
    ground
        "bright": bars ought to be dark; "dark": bright.

    Raises
    ------
    InputError
        If shapes or values do not fit, or the element reaches beyond the grid.
    SamplingError
        If its lines are narrower than two samples.
    """
    intensity = _intensity(picture, grid)
    validate_choice("ground", ground, ("bright", "dark"))
    name = f"lines (group {element.group}, element {element.element})"
    validate_sampling(grid, element.line_width_um, name)
    return ElementContrast(
        element, *(set_contrast(intensity, grid, element, way, ground) for way in ("x", "y"))
    )


def element_contrasts(
    picture: Picture, grid: Grid, elements: Sequence[UsafElement], ground: Polarity = "bright"
) -> tuple[ElementContrast, ...]:
    """:func:`bar_contrast` of several elements, the coarsest first.

    Raises
    ------
    InputError, SamplingError
        As :func:`bar_contrast`, or if there are no elements.
    """
    if not elements:
        raise InputError("contrast of a USAF chart: needs one element at least")
    ordered = sorted(elements, key=lambda one: -one.line_width_um)
    return tuple(bar_contrast(picture, grid, one, ground) for one in ordered)


def resolved_elements(
    contrasts: Sequence[ElementContrast], threshold: float = RESOLVED_CONTRAST
) -> tuple[ElementContrast, ...]:
    """The elements, the coarsest first, up to the one before the first that is not resolved.

    Finer elements that reach the threshold again are false resolution and left out.

    Raises
    ------
    InputError
        If the threshold does not lie between 0 and 1.
    """
    if not 0.0 < threshold < 1.0:
        raise InputError(f"threshold = {threshold!r}: must lie between 0 and 1")
    kept: list[ElementContrast] = []
    for one in sorted(contrasts, key=lambda one: -one.element.line_width_um):
        if not one.resolved(threshold):
            break
        kept.append(one)
    return tuple(kept)


def smallest_resolved_element(
    contrasts: Sequence[ElementContrast], threshold: float = RESOLVED_CONTRAST
) -> UsafElement | None:
    """The finest of :func:`resolved_elements`; None if even the coarsest element is not resolved.

    Raises
    ------
    InputError
        If the threshold does not lie between 0 and 1.
    """
    kept = resolved_elements(contrasts, threshold)
    return kept[-1].element if kept else None


def object_correlation(found: Field, truth: Field, illumination: Field, support: Mask | None = None) -> float:
    """Correlation of two object fields, after what is the illumination has been taken out of both.

    Each side loses its projection on the illumination within the support: what the object does to the light
    remains. A constant factor between both does not matter.

    Parameters
    ----------
    found, truth, illumination
        Object fields on one grid (transmission times illumination, and illumination alone), all as the lens
        passes them (`transmitted_part`) if the truth is to be comparable.
    support
        Samples that count, those inside the field stop. Left out: where the illumination's intensity is above
        1e-6 of its largest; after `transmitted_part` light spills over the stop, so give it
        then.

    Returns
    -------
    float
        0 to 1; NaN if either side is nothing but illumination.

    Raises
    ------
    InputError
        If grids or shapes differ, values are not finite, or the support is empty or dark.
    """
    for name, one in (("found", found), ("truth", truth)):
        if one.grid.shape != illumination.grid.shape or one.grid.pitch_mm != illumination.grid.pitch_mm:
            raise InputError(f"{name}: its grid {one.grid} is not the illumination's {illumination.grid}")
    inside = _lit(illumination) if support is None else np.asarray(support, bool)
    if inside.shape != illumination.values.shape:
        shape = illumination.values.shape
        raise InputError(f"support: its shape {inside.shape} is not that of the fields, {shape}")
    products = np.zeros((3, 3), complex)
    for rows in row_blocks(len(inside)):
        products += _products(rows, inside, (illumination, found, truth))
    strength = float(products[0, 0].real)
    if not np.all(np.isfinite(products)):
        raise InputError("object_correlation: the fields hold values that are not finite")
    if not strength > 0.0:
        raise InputError("illumination: is dark within the support")
    left = products - np.outer(products[:, 0], products[0]) / strength
    sizes = [float(left[i, i].real) for i in (1, 2)]
    if any(size <= 1e-12 * float(products[i, i].real) for i, size in enumerate(sizes, start=1)):
        return math.nan
    return float(abs(left[1, 2])) / math.sqrt(sizes[0] * sizes[1])


def _lit(illumination: Field) -> Mask:
    """Return the mask of samples with significant intensity."""
    power = np.abs(illumination.values) ** 2
    return np.asarray(power > 1e-6 * power.max(initial=0.0))


def _products(rows: slice, inside: Mask, fields: tuple[Field, ...]) -> NDArray:
    """Return all inner products of fields over a range of rows."""
    chosen = inside[rows]
    parts = [np.asarray(one.values[rows][chosen], complex) for one in fields]
    return np.array([[np.vdot(one, other) for other in parts] for one in parts])


def _intensity(picture: Picture, grid: Grid) -> Array:
    if grid.is_line or picture.shape != grid.shape:
        raise InputError(f"contrast of bars: picture of shape {picture.shape}, grid of shape {grid.shape}")
    if np.iscomplexobj(picture):
        return np.asarray(np.abs(picture), float) ** 2
    intensity = np.asarray(picture, float)
    if np.any(intensity < -1e-9 * np.max(intensity, initial=0.0)):
        raise InputError("contrast of bars: the intensity must not be negative")
    return intensity
