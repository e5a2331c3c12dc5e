"""Resolution test: contrast of lines that one engine reconstructs from the field of a reference engine.

A reference engine propagates the field of bright bars from a field point through the lens. The engine under
test propagates it back to the object, on a meridional line. The test ignores shift and defocus of the model:
the result is refocused and registered, as is a reconstruction of a recorded picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid, correlation
from wavesim.fields.plane_waves import PlaneWaves, phasor_of
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds
from wavesim.scene.engine import Engine
from wavesim.scene.patches import exit_grid
from wavesim.scene.scene import Scene, diffraction_limit_um, wavelength_of
from wavesim.targets.bars import (
    RESOLVED_CONTRAST,
    BarContrast,
    bar_and_gap_centres,
    bar_contrasts,
    bar_coverage,
    resolved_lines,
)

ComplexArray = NDArray[np.complex128]

REFOCUS_RANGE_MM, REFOCUS_STEP_MM = 0.15, 0.0005

PROFILE_POINTS = 201

LineLimit = Literal["engine", "reference", "aperture", "widths"]


def usual_line_widths_um(lens: Lens, wavelength_um: float | None = None) -> list[float]:
    """Return ten line widths in um, from the finest that the aperture transmits to three times as wide.

    They have equal ratios, and are rounded up to three digits.
    """
    finest = diffraction_limit_um(lens, wavelength_of(lens, wavelength_um))
    digit = 10.0 ** (math.floor(math.log10(finest)) - 2)
    return [float(f"{math.ceil(finest * 3.0 ** (k / 9.0) / digit - 1e-6) * digit:.4g}") for k in range(10)]


@dataclass(frozen=True)
class LineContrast(BarContrast):
    """Contrast of reconstructed lines of one width.

    Attributes
    ----------
    contrast : float
        (bright - dark) / (bright + dark) at the centres of bars and gaps, after refocus and registration. It
        is negative where bright and dark are reversed.
    weakest_contrast : float
        The same contrast of the darkest bar and the brightest gap.
    line_width_um : float
        Width of a bar and of a gap in um.
    contrast_as_is : float
        The same contrast without refocus and registration.
    contrast_of_reference : float
        Contrast of the lines that the reference engine itself has propagated back.
    refocus_um, shift_um : float
        Distance along the axis, and lateral displacement, in um, that the registration has removed.
    exit_correlation : float
        Correlation of the exit fields of the engine under test and of the reference engine.
    profile : ndarray, shape (`PROFILE_POINTS`,)
        Intensity of the registered lines across the bars, and across half a line width beyond them.
    """

    line_width_um: float
    contrast_as_is: float
    contrast_of_reference: float
    refocus_um: float
    shift_um: float
    exit_correlation: float
    profile: Array = field(repr=False, compare=False)


@dataclass(frozen=True)
class Resolved:
    """Result of the resolution test at one field point.

    Attributes
    ----------
    field_mm : float
        Height of the field point along y, in mm.
    engine, reference : str
        Engine that propagated back, and engine that propagated forward.
    settings : dict
        Settings of the engine under test.
    lines : tuple of LineContrast
        Contrasts of each line width. Bars are repeated along y, the only direction of a meridional line.
    passed_um : float
        Width in um of the finest lines that the aperture transmits, wavelength / 2 NA.
    sample_um : float
        Pitch of the object's samples in um.
    """

    field_mm: float
    engine: str
    reference: str
    settings: dict[str, Any]
    lines: tuple[LineContrast, ...]
    passed_um: float = 0.0
    sample_um: float = 0.0

    def smallest_resolved_um(self, threshold: float = RESOLVED_CONTRAST) -> float | None:
        """Return the smallest line width in um down to which all lines are resolved; None if none are.

        Finer lines that reach the threshold again are false resolution and do not count.
        """
        ordered = sorted(self.lines, key=lambda one: -one.line_width_um)
        kept = resolved_lines(ordered, lambda one: one.resolved(threshold))
        return kept[-1].line_width_um if kept else None

    def limit(self, threshold: float = RESOLVED_CONTRAST) -> LineLimit:
        """Return the reason why no finer lines are resolved.

        - "engine": finer lines were tried; the reference engine resolves them, but this engine does not.
        - "reference": not even the reference engine resolves them, although the aperture transmits them.
        - "aperture": they are finer than wavelength / 2 NA.
        - "widths": no finer lines were tried, so that the result is not a limit of the engine.
        """
        smallest = self.smallest_resolved_um(threshold)
        finer = [one for one in self.lines if smallest is None or one.line_width_um < smallest]
        if not finer:
            return "widths"
        tried = max(finer, key=lambda one: one.line_width_um)
        if tried.line_width_um < self.passed_um * (1.0 - 1e-9):
            return "aperture"
        return "engine" if tried.contrast_of_reference >= threshold else "reference"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, without profiles."""
        data = asdict(self)
        for line in data["lines"]:
            del line["profile"]
        return data


def resolve(
    lens: Lens,
    line_widths_um: Sequence[float],
    field_mm: float = 0.0,
    engine: str = "slices",
    *,
    reference: str = "eikonal",
    wavelength_um: float | None = None,
    plane_distance_mm: float = 0.0,
    bars: int = 5,
    **settings: Any,
) -> Resolved:
    """Measure the contrast of lines that an engine reconstructs from the field of a reference engine.

    The reference engine propagates the field of bright bars through the lens, on a meridional line. The
    engine under test propagates it back to the object. The result is refocused and registered before its
    contrast is measured.

    Parameters
    ----------
    lens
        The lens.
    line_widths_um
        Widths of the bars in um, 0.01 to 1000. Gaps are as wide as bars.
    field_mm
        Height of the field point along y, in mm.
    engine
        Name of the engine under test.
    reference
        Name of the engine that propagates forward.
    wavelength_um
        Vacuum wavelength in um. Default: the design's first wavelength.
    plane_distance_mm
        Distance in mm from the exit vertex to the plane between both engines.
    bars
        Number of bars, at least 5. Fewer bars would hide false contrast.
    **settings
        Settings of the engine under test.

    Returns
    -------
    Resolved
        Contrast of each line width, and the reason why no finer lines are resolved.

    Raises
    ------
    InputError
        If a value is out of its range, or the bars are wider than the field.
    SamplingError
        If the grid of an engine cannot sample the field.

    Examples
    --------
    >>> from lensdesign import load_design, scaled
    >>> from wavesim import resolve
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> found = resolve(lens, [0.775, 1.55], engine="slices", slices=20, compensation="oblique")
    >>> [round(line.contrast, 1) for line in found.lines], found.smallest_resolved_um()
    ([1.0, 1.0], 0.775)
    """
    _refuse(lens, line_widths_um, field_mm, bars)
    scene = meridional_scene(lens, max(line_widths_um), field_mm, bars, wavelength_um, plane_distance_mm)
    truth, tested = engine_for(scene, reference), engine_for(scene, engine, **settings)
    lines = tuple(_line_contrast(truth, tested, width, bars) for width in line_widths_um)
    passed_um = diffraction_limit_um(lens, scene.wavelength_um)
    sample_um = 1e3 * scene.object_grid.pitch_mm
    return Resolved(field_mm, engine, reference, tested.settings(), lines, passed_um, sample_um)


def resolving_seconds(
    lens: Lens,
    line_widths_um: Sequence[float],
    field_mm: float = 0.0,
    engine: str = "slices",
    *,
    reference: str = "eikonal",
    wavelength_um: float | None = None,
    plane_distance_mm: float = 0.0,
    bars: int = 5,
    **settings: Any,
) -> float:
    """Return the estimated time in s of :func:`resolve` with the same arguments on this machine.

    Raises
    ------
    InputError, SamplingError
        As :func:`resolve`.
    """
    _refuse(lens, line_widths_um, field_mm, bars)
    scene = meridional_scene(lens, max(line_widths_um), field_mm, bars, wavelength_um, plane_distance_mm)
    costs = (engine_for(scene, reference).cost(), engine_for(scene, engine, **settings).cost())
    each = 2.0 * sum(cost.seconds for cost in costs) + _registering_seconds(scene.object_grid)
    return sum(cost.setup_seconds for cost in costs) + len(line_widths_um) * each


def meridional_scene(
    lens: Lens,
    widest_line_um: float,
    field_mm: float,
    bars: int = 5,
    wavelength_um: float | None = None,
    plane_distance_mm: float = 0.0,
    margin_mm: float = 0.06,
) -> Scene:
    """Return a line scene of the bars at a field point, and the lens's footprint on the exit plane.

    The margin on each side of the bars is dark. It holds lines that are imaged displaced or blurred.
    """
    wavelength = wavelength_of(lens, wavelength_um)
    half_object = 0.5e-3 * (2 * bars - 1) * widest_line_um + margin_mm
    # Pitch of the object grid, in wavelengths.
    object_pitch_waves = 0.1
    pitch = object_pitch_waves * 1e-3 * wavelength
    count = scipy.fft.next_fast_len(2 * int(np.ceil(half_object / pitch)) + 1)
    object_grid = Grid((count,), pitch, lens.object_z_mm, (0.0, float(field_mm)))
    return Scene(lens, object_grid, exit_grid(lens, wavelength, plane_distance_mm, 1), wavelength)


def bars_field(grid: Grid, wavelength_um: float, line_width_um: float, bars: int = 5) -> Field:
    """Return the field of bright bars on a dark ground, at the centre of a line grid.

    A sample at the edge of a bar has the fraction of its cell that the bar covers.
    """
    samples_mm = grid.y_mm - grid.centre_mm[1]
    covered = bar_coverage(samples_mm, grid.pitch_mm, 1e-3 * line_width_um, bars)
    return Field(grid, covered.astype(complex), wavelength_um)


def _refuse(lens: Lens, line_widths_um: Sequence[float], field_mm: float, bars: int) -> None:
    if not len(line_widths_um):
        raise InputError("line_widths_um: must hold at least one width")
    for width in line_widths_um:
        if not 0.01 <= width <= 1000.0:
            raise InputError(f"line width = {width!r} µm: must be from 0.01 to 1000")
    if not abs(field_mm) <= lens.half_field_mm:
        raise InputError(
            f"field height = {field_mm:g} mm: must lie within the half field of {lens.half_field_mm:g} mm"
        )
    widest = 1e-3 * (2 * bars - 1) * max(line_widths_um)
    if widest > lens.object.field_diameter_mm:
        raise InputError(
            f"{bars} bars of {max(line_widths_um):g} µm take {widest:.3g} mm: must be within the field "
            f"diameter of {lens.object.field_diameter_mm:g} mm"
        )
    if bars < 5:
        raise InputError(
            f"bars = {bars}: must be at least 5, because fewer bars do not reveal false contrast"
        )


def _line_contrast(truth: Engine, tested: Engine, line_width_um: float, bars: int) -> LineContrast:
    grid, wavelength = truth.scene.object_grid, truth.scene.wavelength_um
    lines = bars_field(grid, wavelength, line_width_um, bars)
    exit_field = truth.forward(lines)
    best = np.asarray(truth.adjoint(exit_field).values)
    seen = np.asarray(tested.adjoint(exit_field).values)
    refocus, shift, moved = register(seen, best, grid, wavelength)
    contrast = contrasts_of(grid, line_width_um, bars)
    mean, weakest = contrast(moved)
    return LineContrast(
        line_width_um=float(line_width_um),
        contrast=mean,
        weakest_contrast=weakest,
        contrast_as_is=contrast(seen)[0],
        contrast_of_reference=contrast(best)[0],
        refocus_um=1e3 * refocus,
        shift_um=1e3 * shift,
        exit_correlation=correlation(tested.forward(lines).values, exit_field.values),
        profile=_profile(moved, grid, line_width_um, bars),
    )


def _profile(values: ComplexArray, grid: Grid, line_width_um: float, bars: int) -> Array:
    half = 1e-3 * line_width_um * bars
    y = np.linspace(-half, half, PROFILE_POINTS)
    return np.interp(y, grid.y_mm - grid.centre_mm[1], np.abs(values) ** 2)


def contrasts_of(
    grid: Grid, line_width_um: float, bars: int
) -> Callable[[ComplexArray], tuple[float, float]]:
    """Return the contrasts of a field: that of the means of bars and gaps, and that of the weakest pair."""
    y, centres = grid.y_mm - grid.centre_mm[1], bar_and_gap_centres(1e-3 * line_width_um, bars)

    def contrasts(values: ComplexArray) -> tuple[float, float]:
        intensity = np.interp(centres, y, np.abs(values) ** 2)
        return bar_contrasts(intensity[:bars], intensity[bars:])

    return contrasts


def register(
    values: ComplexArray, target: ComplexArray, grid: Grid, wavelength_um: float
) -> tuple[float, float, ComplexArray]:
    """Refocus and shift a field on a line until its correlation with a target is largest.

    Returns
    -------
    refocus_mm, shift_mm : float
        Distance of the propagation along the axis, and lateral displacement that was found after it, in mm.
    moved : ndarray
        The refocused field without its displacement.
    """
    from scipy.optimize import minimize_scalar

    # Padding keeps what is shifted over an end from coming back at the other.
    count = scipy.fft.next_fast_len(2 * len(values))
    cycles = scipy.fft.fftfreq(count, grid.pitch_mm)
    kz = PlaneWaves([cycles], wavelength_um).kz - 2e3 * np.pi / wavelength_um
    spectrum = scipy.fft.fft(values, count)
    product = spectrum * np.conj(scipy.fft.fft(target, count))

    def overlap(distance: float) -> Array:
        return np.abs(scipy.fft.ifft(product * phasor_of(kz * distance)))

    distances = np.arange(-REFOCUS_RANGE_MM, REFOCUS_RANGE_MM + REFOCUS_STEP_MM, REFOCUS_STEP_MM)
    rough = distances[int(np.argmax([overlap(d).max() for d in distances]))]
    bounds = (rough - REFOCUS_STEP_MM, rough + REFOCUS_STEP_MM)
    fine = minimize_scalar(lambda d: -overlap(d).max(), bounds=bounds, method="bounded")
    distance = float(fine.x)
    lag = _peak(overlap(distance))
    shift = (lag - count if lag > count / 2 else lag) * grid.pitch_mm
    turned = spectrum * phasor_of(kz * distance + 2.0 * np.pi * cycles * shift)
    return distance, float(shift), scipy.fft.ifft(turned)[: len(values)]


def _registering_seconds(grid: Grid) -> float:
    """Return the cost of :func:`register`: a phasor and a transform for every distance."""
    count = scipy.fft.next_fast_len(2 * grid.size)
    each = fft_seconds(count, line=True) + exponential_seconds(count) + 3.0 * pass_seconds(count)
    return 2.0 * REFOCUS_RANGE_MM / REFOCUS_STEP_MM * each


def _peak(values: Array) -> float:
    """Return the position of the largest value, between samples by a parabola."""
    top = int(np.argmax(values))
    left, middle, right = (values[(top + i) % len(values)] for i in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    return top + (0.5 * (left - right) / bend if bend < 0.0 else 0.0)
