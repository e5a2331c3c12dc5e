"""Light of one object sample behind a stop in free space, by Rayleigh-Sommerfeld sums.

Rayleigh's first integral gives the field in the stop, and then the field that the opening radiates. On a
line the stop is a slit, and the integral is summed directly. On a plane it is a round hole about the sample's
axis, and the sum is over the plane waves of the radial spectrum. The stop is black: the field in its opening
is the field without a stop. See M. Born and E. Wolf, "Principles of Optics", section 8.11.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive
from lensdesign.lens.lens import Lens, ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from wavesim.analytic.registry import AnalyticCase
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

APART, BEHIND = 5.0, 10.0 / 3.0
"""Distances from object to stop and from stop to exit grid, relative to the stop's semi-diameter."""

OBJECT_SAMPLES, EXIT_SAMPLES = 5, 160

LARGEST, SMALLEST = 2000.0, 50.0
"""Limits of the semi-diameter of the stop in wavelengths."""


def slit_scene(semi_diameter_mm: float = 0.15, wavelength_um: float = 0.5) -> AnalyticCase:
    """Return the case of the central sample of an object line, whose light passes a slit.

    Parameters
    ----------
    semi_diameter_mm
        Semi-diameter of the stop; all other lengths are in proportion.
    wavelength_um
        Vacuum wavelength.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    scene = _scene(semi_diameter_mm, wavelength_um, 1)
    k, (distance, apart) = scene.wavenumber_per_mm, _distances(semi_diameter_mm)
    y, weight = panel_nodes(-semi_diameter_mm, semi_diameter_mm, 1e-3 * wavelength_um)
    light = scene.object_grid.cell * _line_source(k, y, distance) * weight
    exact = np.concatenate(
        [_line_source(k, part[:, None] - y, apart) @ light for part in _parts(scene.exit_grid.y_mm)]
    )
    return _case(scene, exact)


def hole_scene(semi_diameter_mm: float = 0.15, wavelength_um: float = 0.5) -> AnalyticCase:
    """Return the case of the central sample of an object plane, whose light passes a round hole.

    The hole is centred on the axis of the sample. For parameters and errors see :func:`slit_scene`.
    """
    scene = _scene(semi_diameter_mm, wavelength_um, 2)
    k, (distance, apart) = scene.wavenumber_per_mm, _distances(semi_diameter_mm)
    squares = np.round((scene.exit_grid.y_mm / scene.exit_grid.pitch_mm) ** 2 * 4.0)
    unique, positions = np.unique(squares[:, None] + squares, return_inverse=True)
    radii = 0.5 * scene.exit_grid.pitch_mm * np.sqrt(unique)
    r, weight = panel_nodes(0.0, semi_diameter_mm, 1e-3 * wavelength_um)
    away = np.hypot(r, distance)
    light = distance / away**2 * (1.0 / away - 1j * k) * np.exp(1j * k * away) / (2.0 * math.pi)
    light = scene.object_grid.cell * light * r * weight
    angle, widths = panel_nodes(0.0, 0.5 * math.pi, 4.0 * math.pi / (k * (semi_diameter_mm + radii[-1])))
    exact = np.zeros(len(radii), complex)
    for part in _parts(np.arange(len(angle))):
        q, along = k * np.sin(angle[part]), k * np.cos(angle[part])
        sent = (j0(np.outer(q, r)) @ light) * np.exp(1j * along * apart) * q * along * widths[part]
        exact += j0(np.outer(radii, q)) @ sent
    return _case(scene, exact[positions].reshape(scene.exit_grid.shape))


def _distances(semi_diameter_mm: float) -> tuple[float, float]:
    return APART * semi_diameter_mm, BEHIND * semi_diameter_mm


def _line_source(k: float, across_mm: Array, along_mm: float) -> NDArray[np.complex128]:
    """Return Rayleigh's kernel in two dimensions: i k cos / 2 times the Hankel function of k r."""
    away = np.hypot(across_mm, along_mm)
    x = k * away
    # Hankel's asymptotic expansion. For k r above 300 the remainder is below 1e-8.
    series = 1.0 + (0.375j + 0.1171875 / x) / x
    wave = np.sqrt(2.0 / (math.pi * x)) * np.exp(1j * (x - 0.75 * math.pi))
    return np.asarray(0.5j * k * along_mm / away * wave * series)


def panel_nodes(start: float, stop: float, width: float) -> tuple[Array, Array]:
    """Return nodes and weights of a quadrature with panels of at most `width`."""
    # Each panel has a Gauss-Legendre rule of eight nodes.
    x, weight = np.polynomial.legendre.leggauss(8)
    ends = np.linspace(start, stop, max(1, math.ceil((stop - start) / width)) + 1)
    half, middle = 0.5 * np.diff(ends), 0.5 * (ends[1:] + ends[:-1])
    return (middle[:, None] + half[:, None] * x).ravel(), (half[:, None] * weight).ravel()


def _parts(values: NDArray) -> list[NDArray]:
    return np.array_split(values, max(1, len(values) // 200))


def _scene(semi_mm: float, wavelength_um: float, dimensions: int) -> Scene:
    validate_positive("wavelength_um", wavelength_um)
    wavelength_mm = 1e-3 * wavelength_um
    if not SMALLEST * wavelength_mm <= semi_mm <= LARGEST * wavelength_mm:
        raise InputError(
            f"semi_diameter_mm = {semi_mm!r}: must be from {SMALLEST:g} to {LARGEST:g} wavelengths, "
            f"{SMALLEST * wavelength_mm:g} to {LARGEST * wavelength_mm:g} mm"
        )
    distance, behind = _distances(semi_mm)
    # Half-width of the exit grid, relative to the geometrical footprint's.
    relative_half_width = 1.2
    half = relative_half_width * semi_mm * (distance + behind) / distance
    samples = EXIT_SAMPLES if dimensions == 2 else 2 * math.ceil(half / (0.5 * wavelength_mm))
    lens = Lens(
        title="Stop in free space",
        wavelengths_um=(wavelength_um,),
        object=ObjectSpace(
            field_diameter_mm=0.2 * semi_mm,
            numerical_aperture=math.sin(math.atan(1.0 / APART)),
            working_distance_mm=distance,
        ),
        sensor=Sensor(pixel_pitch_um=wavelength_um, pixels=(1024, 1024), plane_distances_mm=(behind,)),
        surfaces=(Surface(semi_diameter_mm=semi_mm, stop=True),),
    )
    start = Grid((OBJECT_SAMPLES,) * dimensions, 0.5 * wavelength_mm, -distance)
    return Scene(lens, start, Grid((samples,) * dimensions, 2.0 * half / samples, behind), wavelength_um)


def _case(scene: Scene, exact: NDArray[np.complex128]) -> AnalyticCase:
    """Return the case with light in the central sample of the object only."""
    values = np.zeros(scene.object_grid.shape, complex)
    values[tuple(n // 2 for n in values.shape)] = 1.0
    # Relative error of the sums, from evanescent waves and panels.
    uncertainty = 1e-5
    return AnalyticCase(
        scene,
        Field(scene.object_grid, values, scene.wavelength_um),
        Field(scene.exit_grid, exact, scene.wavelength_um),
        uncertainty=uncertainty,
    )
