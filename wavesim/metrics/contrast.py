"""Quality of a reconstruction: resolved elements, and correlation with the true object.

A correlation of amplitudes near 1 does not prove that the object is right, since a bright ground alone
contributes most of it. :func:`object_correlation` therefore removes the known illumination from both objects.
Both are compared as the lens transmits them (:mod:`wavesim.metrics.transmitted_band`), since no
reconstruction can find more.
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
from wavesim.fields.field import Field, Grid, Orientation
from wavesim.metrics.similarity import Mask, Picture
from wavesim.runtime.threads import row_blocks
from wavesim.targets.bars import (
    RESOLVED_CONTRAST,
    BarContrast,
    bar_contrasts,
    bar_levels,
    bar_profile,
    resolved_lines,
)
from wavesim.targets.patterns import Polarity
from wavesim.targets.usaf import BARS, UsafElement


@dataclass(frozen=True, eq=False)
class SetContrast(BarContrast):
    """Contrast and profile of one set of three bars, see :func:`wavesim.targets.bars.bar_profile`."""

    # Coordinate across the bars from the set's centre, and mean along the bars, shape (n,).
    across_um: Array
    intensity: Array


@dataclass(frozen=True, eq=False)
class ElementContrast:
    """Contrast of an element's two sets.

    Attributes
    ----------
    element : UsafElement
        The element.
    x, y : SetContrast
        Contrast of the set whose bars are repeated along x, and of that along y.
    """

    element: UsafElement
    x: SetContrast
    y: SetContrast

    @property
    def contrast(self) -> float:
        """The lower contrast of both sets; NaN if either is NaN."""
        return float(np.minimum(self.x.contrast, self.y.contrast))

    def resolved(self, threshold: float = RESOLVED_CONTRAST) -> bool:
        """Return True if both sets reach a contrast and every bar is brighter than every gap.

        Reversed lines have a negative contrast. Two bars instead of three have a negative weakest contrast.
        Neither is resolved.
        """
        return self.x.resolved(threshold) and self.y.resolved(threshold)


def bar_contrast(
    picture: Picture, grid: Grid, element: UsafElement, ground: Polarity = "bright"
) -> ElementContrast:
    """Return the contrast of an element's bars at their position in the chart.

    The intensity is averaged over the middle of each bar and gap: half a line width across, three line widths
    along. Cells count by the fraction that lies inside. The bars are not searched: lines that are displaced
    by half a period are reversed. :func:`wavesim.metrics.charts.chart_resolution` finds a displaced chart
    first.

    Parameters
    ----------
    picture
        Real intensity, or complex amplitude whose squared modulus is used; shape (ny, nx).
    grid
        Grid of the picture, a plane in the coordinates of the chart.
    element
        The element with its position.
    ground
        "bright" for dark bars on a bright ground, "dark" for bright bars.

    Returns
    -------
    ElementContrast
        Contrast of both sets.

    Raises
    ------
    InputError
        If shapes or values are invalid, or the element reaches beyond the grid.
    SamplingError
        If its lines are narrower than two samples.
    """
    intensity = _intensity(picture, grid)
    validate_choice("ground", ground, ("bright", "dark"))
    name = f"lines (group {element.group}, element {element.element})"
    validate_sampling(grid, element.line_width_um, name)

    def contrast_of(orientation: Orientation) -> SetContrast:
        centre_mm = element.set_centre_mm(orientation)
        shown = (intensity, grid, 1e-3 * element.line_width_um, BARS, orientation, centre_mm)
        bars, gaps = bar_levels(*shown)
        bright, dark = (bars, gaps) if ground == "dark" else (gaps, bars)
        return SetContrast(*bar_contrasts(bright, dark), *bar_profile(*shown))

    return ElementContrast(element, contrast_of("x"), contrast_of("y"))


def element_contrasts(
    picture: Picture, grid: Grid, elements: Sequence[UsafElement], ground: Polarity = "bright"
) -> tuple[ElementContrast, ...]:
    """Return the contrasts of several elements (:func:`bar_contrast`), the coarsest first.

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
    """Return the resolved elements, the coarsest first, up to the first that is not resolved.

    Finer elements that reach the threshold again are false resolution and do not count.

    Parameters
    ----------
    contrasts
        Contrasts of the elements.
    threshold
        Contrast from which lines count as resolved, 0 to 1.

    Raises
    ------
    InputError
        If the threshold does not lie between 0 and 1.
    """
    if not 0.0 < threshold < 1.0:
        raise InputError(f"threshold = {threshold!r}: must lie between 0 and 1")
    ordered = sorted(contrasts, key=lambda one: -one.element.line_width_um)
    return tuple(resolved_lines(ordered, lambda one: one.resolved(threshold)))


def smallest_resolved_element(
    contrasts: Sequence[ElementContrast], threshold: float = RESOLVED_CONTRAST
) -> UsafElement | None:
    """Return the finest of :func:`resolved_elements`; None if even the coarsest element is not resolved.

    Raises
    ------
    InputError
        If the threshold does not lie between 0 and 1.
    """
    kept = resolved_elements(contrasts, threshold)
    return kept[-1].element if kept else None


def object_correlation(found: Field, truth: Field, illumination: Field, support: Mask | None = None) -> float:
    """Return the correlation of two object fields, after the illumination is removed from both.

    Each field loses its projection on the illumination within the support. What remains is the effect of the
    object on the light. A constant factor between both fields does not matter.

    Parameters
    ----------
    found, truth, illumination
        Object fields on one grid: transmission times illumination, and the illumination alone. Give all of
        them as the lens transmits them (`transmitted_part`), so that the true object is comparable.
    support
        Mask of the samples that count, those inside the field stop. Default: samples whose illumination has
        an intensity above 1e-6 of its maximum. Give it after `transmitted_part`, which spreads light beyond
        the stop.

    Returns
    -------
    float
        Correlation, 0 to 1; NaN if a field is proportional to the illumination.

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
