"""Resolution of a USAF chart in a result: its position, its contrasts, and what limits them.

A displaced result is not blurred. The chart is therefore registered first: its displacement, and scale and
rotation where they matter, are found by correlation of the intensity with the chart, and stated separately.
Contrast is then measured at the chart's position.

The finest resolved element is a limit of the result only if the next finer element could be resolved. The
samples, the aperture, the chart and the displayed region may also end the series of elements;
:class:`ChartResolution` states which of them does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensdesign.common.arrays import Array
from lensdesign.common.text import finite_or_none
from lensdesign.errors import InputError
from wavesim.fields.coverage import ROUNDING, SAMPLES_PER_FEATURE, Rectangle, rectangle_coverage
from wavesim.fields.field import Field, Grid
from wavesim.metrics.contrast import ElementContrast, bar_contrast
from wavesim.targets.bars import RESOLVED_CONTRAST, resolved_lines
from wavesim.targets.patterns import Polarity
from wavesim.targets.region import around, cut_field, holds, part_of
from wavesim.targets.usaf import ELEMENTS, GROUPS, UsafElement, chart_outline, usaf_line_width_um

Limit = Literal["result", "aperture", "sampling", "chart", "region"]

SEARCH_LINES, SEARCH_SAMPLES = 2.0, (16, 64)
"""Largest trial displacement in line widths of the coarsest element, and its limits in samples."""

DETERMINED, CHANCE = 0.25, 6.0
"""Least correlation of chart and intensity that determines the position of the chart, absolute and as a
multiple of that of noise.
"""

DEFORMED_SAMPLES, DEFORMED_GAIN, DEFORMED_ELEMENTS = 0.5, 0.1, 3
"""Scale and rotation are accepted if they move the chart's corners by this number of samples, and reduce the
difference of the correlation from 1 by this fraction. They are searched if this number of elements is shown.
"""

SMOOTHING = 1.0
"""Standard deviation in samples of the smoothing of chart and intensity before their correlation. Without it,
edges of bars between samples would change the variance of the chart, and thereby the correlation.
"""


@dataclass(frozen=True)
class Registration:
    """Position of a chart in a result.

    Attributes
    ----------
    displacement_mm : (x, y)
        Displacement of the result from the nominal centre of the chart, in mm.
    scale, rotation_rad : float
        Size of the result over that of the chart, and right-handed rotation in rad, about the chart's centre.
    correlation : float
        Correlation of the intensity with the chart at the position found.
    correlation_in_place : float
        The same correlation at the nominal position.
    middle_mm : (x, y)
        Nominal centre of the chart in mm.
    """

    displacement_mm: tuple[float, float]
    scale: float
    rotation_rad: float
    correlation: float
    correlation_in_place: float
    middle_mm: tuple[float, float]

    def moved(self, element: UsafElement) -> UsafElement:
        """Return an element at its position in the result; its bars keep their width and direction."""
        x, y = (own - middle for own, middle in zip(element.centre_mm, self.middle_mm, strict=True))
        turned = self.scale * (x + 1j * y) * np.exp(1j * self.rotation_rad)
        placed = complex(*self.middle_mm) + complex(*self.displacement_mm) + turned
        return replace(element, centre_mm=(float(placed.real), float(placed.imag)))

    def as_dict(self, pitch_mm: float) -> dict[str, float]:
        """Return plain values for JSON."""
        x, y = self.displacement_mm
        return {
            "x_um": 1e3 * x,
            "y_um": 1e3 * y,
            "x_samples": x / pitch_mm,
            "y_samples": y / pitch_mm,
            "scale": self.scale,
            "rotation_deg": math.degrees(self.rotation_rad),
            "correlation": self.correlation,
            "correlation_in_place": self.correlation_in_place,
        }


@dataclass(frozen=True, eq=False)
class ChartResolution:
    """Resolution of a chart in a result.

    Attributes
    ----------
    contrasts : tuple of ElementContrast
        Contrasts of the elements that the result shows, the coarsest first.
    finest, finest_x, finest_y : UsafElement or None
        Finest element down to which all are resolved: in both sets, in the set whose bars are repeated along
        x, and in that along y. None if not even the coarsest element is resolved.
    limits : tuple of str
        Reasons why no finer element is resolved.

        - "result": the next finer element is shown, but not resolved.
        - "aperture": the next finer element is finer than wavelength / 2 NA.
        - "sampling": it is finer than the samples show reliably.
        - "chart": the chart has no finer element.
        - "region": it lies outside the displayed region.

        Without "result" the finest element is not a limit of the result.
    registration : Registration or None
        Position of the chart; None if the result does not determine it.
    outside : int
        Number of elements of the chart outside the displayed region.
    sample_um, passed_um : float
        Pitch of the samples, and wavelength / 2 NA, in um.
    next_um : float or None
        Line width of the next finer element in um; None after the last element.
    """

    contrasts: tuple[ElementContrast, ...]
    finest: UsafElement | None
    finest_x: UsafElement | None
    finest_y: UsafElement | None
    limits: tuple[Limit, ...]
    registration: Registration | None
    outside: int
    sample_um: float
    passed_um: float
    next_um: float | None

    @property
    def limit_in_words(self) -> str:
        """Return the limit of the finest element in words."""
        if not self.contrasts and self.limits == ("region",):
            return "no element of the chart lies within the displayed part"
        lines = "" if self.next_um is None else f" ({self.next_um:.3g} µm)"
        which = "the next finer lines" if self.finest is not None else "even the coarsest lines shown"
        says = {
            "result": f"{which}{lines} are not resolved",
            "aperture": f"the aperture passes none finer than {self.passed_um:.3g} µm (wavelength / 2 NA)",
            "sampling": f"samples of {self.sample_um:.3g} µm hardly show the next finer lines{lines}",
            "chart": "the chart has no finer lines",
            "region": f"the next finer lines{lines} lie outside the displayed part",
        }
        words = "; ".join(says[limit] for limit in self.limits)
        return words if "result" in self.limits else f"{words}: the reconstruction is not the limit"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        shown = [one.element.line_width_um for one in self.contrasts]
        return {
            "smallest_resolved": self._named(self.finest),
            "smallest_resolved_x": self._named(self.finest_x),
            "smallest_resolved_y": self._named(self.finest_y),
            "limited_by": list(self.limits),
            "limit": self.limit_in_words,
            "displacement": None
            if self.registration is None
            else self.registration.as_dict(1e-3 * self.sample_um),
            "aperture_passes_um": self.passed_um,
            "sample_um": self.sample_um,
            "coarsest_shown_um": max(shown, default=None),
            "finest_shown_um": min(shown, default=None),
            "elements_outside": self.outside,
            "elements": [
                {
                    "group": one.element.group,
                    "element": one.element.element,
                    "line_width_um": one.element.line_width_um,
                    "contrast_x": finite_or_none(one.x.contrast),
                    "contrast_y": finite_or_none(one.y.contrast),
                    "resolved": one.resolved(),
                }
                for one in self.contrasts
            ],
        }

    def _named(self, element: UsafElement | None) -> dict[str, Any] | None:
        if element is None:
            return None
        return {
            "group": element.group,
            "element": element.element,
            "line_width_um": element.line_width_um,
            "beyond_aperture": element.line_width_um < self.passed_um,
        }


def chart_resolution(
    transmission: Field,
    elements: Sequence[UsafElement],
    ground: Polarity,
    passed_um: float,
    inside: NDArray[np.bool_] | None = None,
    threshold: float = RESOLVED_CONTRAST,
) -> ChartResolution:
    """Register a chart, measure its contrasts, and find what limits the finest element.

    Parameters
    ----------
    transmission
        Transmission of the result, or of a part of it.
    elements
        Elements of the chart, including those outside that part.
    ground
        "bright" for dark bars on a bright ground, "dark" for bright bars.
    passed_um
        Width in um of the finest lines that the aperture transmits, wavelength / 2 NA.
    inside
        Mask of the samples within the field stop. Default: all samples.
    threshold
        Contrast from which lines count as resolved, 0 to 1.

    Returns
    -------
    ChartResolution
        Contrasts, the finest resolved elements, and their limits.

    Raises
    ------
    InputError
        If there are no elements, or the threshold does not lie between 0 and 1.
    """
    if not elements:
        raise InputError("resolution of a USAF chart: needs one element at least")
    if not 0.0 < threshold < 1.0:
        raise InputError(f"threshold = {threshold!r}: must lie between 0 and 1")
    found = register_chart(transmission, elements, ground, inside)
    ordered = sorted(elements, key=lambda one: -one.line_width_um)
    placed = [(one, one if found is None else found.moved(one)) for one in ordered]
    grid = transmission.grid
    sample_um = 1e3 * grid.pitch_mm
    in_sight = [(one, position) for one, position in placed if holds(grid, position.outline)]
    contrasts = tuple(
        _contrast(transmission, one, position, ground)
        for one, position in in_sight
        if one.line_width_um >= SAMPLES_PER_FEATURE * sample_um * ROUNDING
    )
    # In a displaced chart, an element within the region may be cut off, and is then not shown either.
    outside = len(ordered) - len(in_sight)

    def down_to(is_resolved: Callable[[ElementContrast], bool]) -> UsafElement | None:
        kept = resolved_lines(contrasts, is_resolved)
        return kept[-1].element if kept else None

    finest = down_to(lambda one: one.resolved(threshold))
    next_um, limits = _limits(finest, contrasts, ordered, sample_um, passed_um)
    return ChartResolution(
        contrasts,
        finest,
        down_to(lambda one: one.x.resolved(threshold)),
        down_to(lambda one: one.y.resolved(threshold)),
        limits,
        found,
        outside,
        sample_um,
        passed_um,
        next_um,
    )


def _contrast(
    transmission: Field, element: UsafElement, position: UsafElement, ground: Polarity
) -> ElementContrast:
    """Return the contrast of an element at its position, from the samples around it."""
    own = cut_field(transmission, around(position.outline, transmission.grid))
    return replace(bar_contrast(own.values, own.grid, position, ground), element=element)


def _limits(
    finest: UsafElement | None,
    contrasts: Sequence[ElementContrast],
    elements: Sequence[UsafElement],
    sample_um: float,
    passed_um: float,
) -> tuple[float | None, tuple[Limit, ...]]:
    """Return the line width of the next finer element, and the reasons why it is not resolved."""
    if finest is None and contrasts:
        width: float | None = contrasts[0].element.line_width_um
    elif finest is None:
        width = elements[0].line_width_um
    else:
        width = _next_finer_um(finest)
    if width is None:
        return None, ("chart",)
    shown = any(_same(one.element.line_width_um, width) for one in contrasts)
    of_chart = any(_same(one.line_width_um, width) for one in elements)
    too_fine = width < SAMPLES_PER_FEATURE * sample_um * ROUNDING
    limits: list[Limit] = []
    if width < passed_um * ROUNDING:
        limits.append("aperture")
    # Lines of fewer samples may fail because of their position among the samples.
    few_samples = 3.0
    if too_fine or (shown and width < few_samples * sample_um):
        limits.append("sampling")
    elif of_chart and not shown:
        limits.append("region")
    elif not of_chart:
        limits.append("chart")
    if shown and not limits:
        limits.append("result")
    return width, tuple(limits)


def chart_end(elements: Sequence[UsafElement], sample_um: float) -> Literal["sampling", "chart"]:
    """Return whether the sampling or the series of elements limits the finest element of a chart."""
    width = _next_finer_um(min(elements, key=lambda one: one.line_width_um))
    too_fine = width is not None and width < SAMPLES_PER_FEATURE * sample_um * ROUNDING
    return "sampling" if too_fine else "chart"


def _next_finer_um(element: UsafElement) -> float | None:
    """Return the line width of the next finer element of the chart."""
    finer = (usaf_line_width_um(group, number) for group in GROUPS for number in ELEMENTS)
    return next((width for width in finer if width < element.line_width_um * ROUNDING), None)


def _same(one_um: float, other_um: float) -> bool:
    return math.isclose(one_um, other_um, rel_tol=1e-9)


def register_chart(
    transmission: Field,
    elements: Sequence[UsafElement],
    ground: Polarity,
    inside: NDArray[np.bool_] | None = None,
) -> Registration | None:
    """Find the position of a chart in a result, to a small fraction of a sample.

    The correlation of the intensity with the chart is largest there. All displacements by whole samples are
    tried. Fractions of samples, scale and rotation are then found near the best of them. Blur does not affect
    the position.

    Parameters
    ----------
    transmission, elements, ground, inside
        As in :func:`chart_resolution`.

    Returns
    -------
    Registration or None
        None if the correlation is not above that of noise, or the intensity is reversed.
    """
    grid = transmission.grid
    pitch = grid.pitch_mm
    coarsest = max(one.line_width_um for one in elements)
    reach = int(np.clip(math.ceil(1e-3 * SEARCH_LINES * coarsest / pitch), *SEARCH_SAMPLES))
    window = _window(grid, chart_outline(elements), reach * pitch)
    if window is None:
        return None
    own = cut_field(transmission, window)
    seen = _ChartCorrelation(own, elements, ground, None if inside is None else inside[part_of(window, grid)])
    with np.errstate(invalid="ignore", divide="ignore"):
        by_shift = seen.correlations(reach)
    if not np.isfinite(by_shift).any():
        return None
    by_shift = np.nan_to_num(by_shift, nan=-1.0)
    row, column = np.unravel_index(int(np.argmax(by_shift)), by_shift.shape)
    in_place = float(by_shift[reach, reach])
    reversed_too = by_shift[row, column] < -np.min(by_shift[by_shift > -1.0])
    if by_shift[row, column] < seen.least_correlation or reversed_too:
        return None
    start = np.array([column - reach, row - reach, 0.0, 0.0])
    shifted, correlation = seen.displaced(start + _between(by_shift, int(row), int(column)))
    shown = sum(holds(window, one.outline) for one in elements)
    if shown >= DEFORMED_ELEMENTS and seen.may_be_deformed(shifted, correlation):
        deformed, better = seen.best(shifted)
        gained = better - correlation > DEFORMED_GAIN * (1.0 - correlation)
        if gained and np.hypot(*deformed[2:]) > DEFORMED_SAMPLES:
            shifted, correlation = deformed, better
    if correlation <= in_place:
        shifted, correlation = np.zeros(4), in_place
    return seen.registration(shifted, correlation, in_place)


def _window(grid: Grid, chart: Rectangle, margin_mm: float) -> Grid | None:
    """Return the samples of a chart and its trial displacements; None if there are hardly any."""
    (half_y, half_x), (x, y) = grid.half_widths_mm, grid.centre_mm
    wanted = Rectangle(
        max(chart.left_mm - margin_mm, x - half_x),
        min(chart.right_mm + margin_mm, x + half_x),
        max(chart.low_mm - margin_mm, y - half_y),
        min(chart.high_mm + margin_mm, y + half_y),
    )
    if min(wanted.right_mm - wanted.left_mm, wanted.high_mm - wanted.low_mm) < 4.0 * grid.pitch_mm:
        return None
    return around(wanted, grid)


class _ChartCorrelation:
    """Intensity around a chart, and its correlation with the chart at trial positions.

    A position is a vector in samples: displacement along x and y, and the shifts of the chart's corner
    due to scale and rotation.
    """

    def __init__(
        self,
        field: Field,
        elements: Sequence[UsafElement],
        ground: Polarity,
        inside: NDArray[np.bool_] | None,
    ) -> None:
        self.grid, self.elements = field.grid, elements
        self.sign = 1.0 if ground == "dark" else -1.0
        intensity = np.abs(field.values).astype(float) ** 2
        known = np.isfinite(intensity) if inside is None else np.isfinite(intensity) & inside
        self.weight = known.astype(float)
        self.count = max(float(self.weight.sum()), 1.0)
        intensity = np.where(known, intensity, 0.0)
        intensity = np.where(known, intensity - intensity.sum() / self.count, 0.0)
        smooth = gaussian_filter(intensity, SMOOTHING)
        self.intensity = self.weight * (smooth - np.vdot(self.weight, smooth) / self.count)
        self.size = float(np.linalg.norm(self.intensity))
        chart = chart_outline(elements)
        self.middle = (0.5 * (chart.left_mm + chart.right_mm), 0.5 * (chart.low_mm + chart.high_mm))
        corner = math.hypot(chart.right_mm - chart.left_mm, chart.high_mm - chart.low_mm)
        self.corner_samples = 0.5 * corner / field.grid.pitch_mm

    def registration(self, position: Array, correlation: float = 0.0, in_place: float = 0.0) -> Registration:
        """Return the registration that a position vector describes."""
        x, y = (float(one) * self.grid.pitch_mm for one in position[:2])
        scale, rotation = 1.0 + position[2] / self.corner_samples, position[3] / self.corner_samples
        return Registration((x, y), float(scale), float(rotation), correlation, in_place, self.middle)

    def chart(self, position: Array, grid: Grid) -> Array:
        """Return the fraction of each cell that bars cover; bars are cut off at the border of the grid."""
        moved = self.registration(position).moved
        (half_y, half_x), (x, y) = grid.half_widths_mm, grid.centre_mm
        bars = []
        for element in self.elements:
            own = moved(element)
            for bar in (*own.bars("x"), *own.bars("y")):
                cut = Rectangle(
                    max(bar.left_mm, x - half_x),
                    min(bar.right_mm, x + half_x),
                    max(bar.low_mm, y - half_y),
                    min(bar.high_mm, y + half_y),
                )
                if cut.right_mm > cut.left_mm and cut.high_mm > cut.low_mm:
                    bars.append(cut)
        return np.asarray(gaussian_filter(self.sign * rectangle_coverage(grid, bars), SMOOTHING))

    def correlations(self, reach: int) -> Array:
        """Return correlations for shifts by whole samples, from -reach to reach along y and x."""
        from scipy.signal import fftconvolve

        rows, columns = self.grid.shape
        wider = replace(self.grid, shape=(rows + 2 * reach, columns + 2 * reach))
        chart = self.chart(np.zeros(4), wider)

        def sums(weights: Array, values: Array) -> Array:
            # The chart moves relative to the intensity: its displacement is opposite to that of the window.
            return np.asarray(fftconvolve(values, weights[::-1, ::-1], mode="valid"))[::-1, ::-1]

        products = sums(self.intensity, chart)
        means, squares = sums(self.weight, chart) / self.count, sums(self.weight, chart**2)
        spread = np.sqrt(np.maximum(squares - self.count * means**2, 0.0))
        # Rounding errors of Fourier transforms must not give an even chart a contrast.
        spread[spread < 1e-6 * math.sqrt(self.count)] = np.nan
        return np.asarray(products / (spread * self.size)) if self.size > 0.0 else np.full_like(means, np.nan)

    def correlation(self, position: Array) -> float:
        """Return the correlation at a position."""
        chart = self.weight * self.chart(position, self.grid)
        chart -= self.weight * (chart.sum() / self.count)
        size = float(np.linalg.norm(chart)) * self.size
        return float(np.vdot(chart, self.intensity)) / size if size > 0.0 else -1.0

    @property
    def least_correlation(self) -> float:
        """Least correlation that determines a position. It is higher for fewer samples, because of chance."""
        return max(DETERMINED, CHANCE * math.sqrt(4.0 * math.pi * SMOOTHING**2 / self.count))

    def displaced(self, start: Array) -> tuple[Array, float]:
        """Return the displaced position with the largest correlation, from parabolas, and the correlation."""
        step = 0.5
        middle, position = self.correlation(start), start.copy()
        for axis in (0, 1):
            aside = step * np.eye(4)[axis]
            position[axis] += step * _vertex(
                self.correlation(start - aside), middle, self.correlation(start + aside)
            )
        found = self.correlation(position)
        return (position, found) if found > middle else (start, middle)

    def may_be_deformed(self, position: Array, correlation: float) -> bool:
        """Return True if a small change of scale or rotation increases the correlation."""
        asides = (sign * DEFORMED_SAMPLES * np.eye(4)[axis] for axis in (2, 3) for sign in (-1.0, 1.0))
        return any(self.correlation(position + aside) > correlation for aside in asides)

    def best(self, start: Array) -> tuple[Array, float]:
        """Return the best position near a start, including scale and rotation, and its correlation."""
        from scipy.optimize import minimize

        def loss(position: Any) -> float:
            return 1.0 - self.correlation(position)

        simplex = start + np.vstack([np.zeros(4), 0.6 * np.eye(4)])
        options: Any = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 1e-7, "maxfev": 300}
        found = minimize(loss, start, method="Nelder-Mead", options=options)
        return np.asarray(found.x), 1.0 - float(found.fun)


def _between(values: Array, row: int, column: int) -> Array:
    """Return the offset of the peak from the largest sample along x and y, from fitted parabolas."""
    found = np.zeros(4)
    if 0 < column < values.shape[1] - 1:
        found[0] = _vertex(*values[row, column - 1 : column + 2])
    if 0 < row < values.shape[0] - 1:
        found[1] = _vertex(*values[row - 1 : row + 2, column])
    return found


def _vertex(previous: float, middle: float, following: float) -> float:
    """Return the vertex of the parabola through three points, in their spacing; at most 1 from the middle."""
    bend = previous - 2.0 * middle + following
    return float(np.clip(0.5 * (previous - following) / bend, -1.0, 1.0)) if bend < 0.0 else 0.0
