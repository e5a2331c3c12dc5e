"""A point through the plano-hyperbolic lens, which images it stigmatically to infinity.

Light from the focus meets a hyperboloid of conic constant -n^2 and vertex radius (n - 1) f, runs along the
axis inside the glass and leaves through the plane back without refraction: by Fermat's principle the surface
f + n z = sqrt(r^2 + (f + z)^2) makes all optical paths to a plane behind equal. From the focus at the angle
theta the surface is at the distance f (n - 1) / (n cos(theta) - 1). See M. Born and E. Wolf, "Principles of
Optics", section 4.2.2 (Cartesian surfaces).
"""

from __future__ import annotations

import math

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive
from lensdesign.lens.lens import Lens, ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from wavesim.analytic.cylinder import SCENE_INDEX
from wavesim.analytic.registry import AnalyticCase
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

NUMERICAL_APERTURE = 0.5


def focal_length_mm(semi_diameter_mm: float, index: float, numerical_aperture: float) -> float:
    """Return the focal length f of the lens whose edge, at `semi_diameter_mm`, has the given aperture."""
    cosine = math.sqrt(1.0 - numerical_aperture**2)
    return semi_diameter_mm * (index * cosine - 1.0) / ((index - 1.0) * numerical_aperture)


def point_field(y_mm: Array, wavenumber_per_mm: float, numerical_aperture: float) -> Array:
    """Return a band-limited point: the integral of cos^2(pi p / (2 NA)) exp(i k p y) dp over abs(p) < NA."""
    x = wavenumber_per_mm * numerical_aperture * y_mm / math.pi
    return np.asarray(numerical_aperture * (np.sinc(x) + 0.5 * (np.sinc(x - 1.0) + np.sinc(x + 1.0))))


def collimated_amplitude(
    y_mm: Array, focal_length_mm: float, index: float, wavenumber_per_mm: float, numerical_aperture: float
) -> Array:
    """Return the modulus of the field of :func:`point_field` behind the lens, with ideal coatings.

    Energy stays between neighbouring rays: `|u|^2 dy = (2 pi / k) g(theta)^2 d theta`, with
    g = cos^2(pi p / (2 NA)) cos(theta) the object's spectrum over angles, p = sin(theta), and
    dy / d theta = f (n - 1) (n - cos(theta)) / (n cos(theta) - 1)^2.
    """
    f, n = focal_length_mm, index
    curvature = 1.0 / ((n - 1.0) * f)
    sag = curvature * y_mm**2 / (1.0 + np.sqrt(1.0 + (n * n - 1.0) * (curvature * y_mm) ** 2))
    sine = y_mm / np.hypot(y_mm, f + sag)
    cosine = (f + sag) / np.hypot(y_mm, f + sag)
    spectrum = np.cos(0.5 * math.pi * sine / numerical_aperture) ** 2 * cosine
    stretch = f * (n - 1.0) * (n - cosine) / (n * cosine - 1.0) ** 2
    inside = np.abs(sine) < numerical_aperture
    return np.where(inside, spectrum * np.sqrt(2.0 * math.pi / (wavenumber_per_mm * stretch)), 0.0)


def stigmatic_scene(semi_diameter_mm: float = 8.25, wavelength_um: float = 0.532) -> AnalyticCase:
    """Return the case of a band-limited point of NA 0.5 in the focus, and the plane wave behind the lens.

    Parameters
    ----------
    semi_diameter_mm
        Semi-diameter of the lens; all other lengths are proportional to it.
    wavelength_um
        Vacuum wavelength.

    Returns
    -------
    AnalyticCase
        `exact` is accurate to first order in wavelength over focal length. Its uncertainty is the next order:
        the phase k d^2 / (2 f) due to the object's width d.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    validate_positive("wavelength_um", wavelength_um)
    wavelength_mm = 1e-3 * wavelength_um
    if not (math.isfinite(semi_diameter_mm) and semi_diameter_mm >= 200.0 * wavelength_mm):
        raise InputError(
            f"semi_diameter_mm = {semi_diameter_mm!r}: must be at least 200 wavelengths, "
            f"{200.0 * wavelength_mm:g} mm"
        )
    n, na, k = SCENE_INDEX, NUMERICAL_APERTURE, 2.0 * math.pi / wavelength_mm
    f = focal_length_mm(semi_diameter_mm, n, na)
    thickness, behind = 0.73 * semi_diameter_mm, 0.1 * semi_diameter_mm
    exit_samples = 4096
    exit_pitch = max(2.0 * semi_diameter_mm / exit_samples, 0.5 * wavelength_mm)
    object_pitch = 0.25 * wavelength_mm
    # Zeros of the object's sinc within the object grid on each side; the field beyond is below 5e-6.
    object_zeros = 40
    object_half = object_zeros * math.pi / (k * na)
    scene = Scene(
        lens=_lens(semi_diameter_mm, f, thickness, behind, wavelength_um),
        object_grid=Grid((2 * math.ceil(object_half / object_pitch),), object_pitch, -f),
        exit_grid=Grid((2 * math.ceil(semi_diameter_mm / exit_pitch),), exit_pitch, thickness + behind),
        wavelength_um=wavelength_um,
    )
    start = point_field(scene.object_grid.y_mm, k, na).astype(complex)
    phase = k * (f + n * thickness + behind) - 0.25 * math.pi
    end = collimated_amplitude(scene.exit_grid.y_mm, f, n, k, na) * np.exp(1j * phase)
    # Root mean square of the spectrum's second derivative, over that of the spectrum.
    width = (math.pi / na) ** 2 / math.sqrt(3.0)
    return AnalyticCase(
        scene,
        Field(scene.object_grid, start, wavelength_um),
        Field(scene.exit_grid, end, wavelength_um),
        uncertainty=width / (2.0 * k * f),
    )


def _lens(
    semi_diameter_mm: float,
    focal_length_mm: float,
    thickness_mm: float,
    behind_mm: float,
    wavelength_um: float,
) -> Lens:
    return Lens(
        title="Plano-hyperbolic lens",
        wavelengths_um=(wavelength_um,),
        object=ObjectSpace(
            field_diameter_mm=0.1 * semi_diameter_mm,
            numerical_aperture=NUMERICAL_APERTURE,
            working_distance_mm=focal_length_mm,
        ),
        sensor=Sensor(pixel_pitch_um=3.2, pixels=(9344, 7000), plane_distances_mm=(behind_mm,)),
        surfaces=(
            Surface(
                radius_mm=(SCENE_INDEX - 1.0) * focal_length_mm,
                conic=-(SCENE_INDEX**2),
                thickness_mm=thickness_mm,
                material=SCENE_INDEX,
                semi_diameter_mm=semi_diameter_mm,
                stop=True,
            ),
            Surface(semi_diameter_mm=1.02 * semi_diameter_mm),
        ),
    )
