"""Sensor windows, footprints and phase diversity of recording planes, and the engine for imaging."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np
import scipy.fft

from lensdesign.analysis.exit_beam import footprint
from lensdesign.analysis.paraxial import first_order
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, Sensor
from lensdesign.lens.poses import Pose
from wavesim.engines.choosing import engine_for
from wavesim.engines.registry import AUTO, settings_of
from wavesim.engines.surfaces.grids import LARGEST_BYTES
from wavesim.scene.engine import Engine
from wavesim.scene.polarization import SCALAR
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene
from wavesim.scene.settings import EngineSettings
from wavesim.scene.system_state import AS_DESIGNED, SystemState, state_of
from wavesim.sensor.sensor import FootprintWarning, sensor_grid
from wavesim.targets.patch import Patch

WINDOW_MARGIN, OVERSAMPLING = 1.02, 2
"""Width of a sensor window over the footprint, and samples per pixel of the field on it."""

LARGEST_CUT = 0.2
"""Largest fraction of the footprint's area that may lie outside the sensor."""

LEAST_DIVERSITY = 10.0
"""Phase diversity below which a warning is issued; see :func:`diversity`."""

TILE_ERROR = 0.05
"""Default of the allowed relative error of a tiled engine that is selected by name."""


class DiversityWarning(UserWarning):
    """Warning that the recording planes are too close to each other to determine the phase."""


def imaging_engine(
    scene: Scene,
    settings: EngineSettings,
    *,
    runs: int,
    light: Light,
    memory_gb: float = 1e-9 * LARGEST_BYTES,
) -> Engine:
    """Return the engine that the settings select; the default of the allowed error is that of imaging.

    Parameters
    ----------
    scene
        Object grid, lens and exit grid.
    settings
        Engine, allowed error, and further settings of the engine.
    runs, light, memory_gb
        See :func:`wavesim.engine_for`.

    Raises
    ------
    InputError, SamplingError
        If a setting is invalid or no engine meets the error limit; see :func:`wavesim.engine_for`.
    """
    name, error = settings.engine, settings.error
    if error is None and name != AUTO and "error" in settings_of(name):
        error = TILE_ERROR
    return engine_for(
        scene, name, error=error, memory_gb=memory_gb, runs=runs, light=light, **settings.details()
    )


def footprint_mm(
    lens: Lens, patch: Patch, plane_distance_mm: float, state: SystemState | Pose = AS_DESIGNED
) -> float:
    """Return the diameter, in mm, of a disc about the sensor's centre that contains a patch's light.

    Parameters and errors are those of :func:`light_radius_mm`. The disc is the smallest one if object and
    sensor are not displaced.
    """
    state = state_of(state)
    radius_mm = light_radius_mm(lens, patch, plane_distance_mm, state)
    return 2.0 * (radius_mm + math.hypot(*state.sensor_shift_mm[:2]))


def light_radius_mm(lens: Lens, patch: Patch, plane_distance_mm: float, state: SystemState) -> float:
    """Return the largest distance from the axis, in mm, of a patch's rays on a plane.

    Raises
    ------
    DesignError
        If no ray passes the lens.
    """
    x, y, z = state.object_shift_mm
    # Light of a displaced object crosses the nominal object plane outside the field stop by this margin.
    margin = math.hypot(x, y) + abs(z) * math.tan(math.asin(min(lens.object.numerical_aperture, 0.99)))
    margin += math.hypot(*patch.field_stop_at_mm)
    space = lens.object.replaced(field_diameter_mm=patch.field_stop_mm + 2.0 * margin)
    lit = lens.replaced(object=space)
    found = footprint(lit, patch.wavelength_um, plane_distance_mm, state.pose, state.surface_perturbations)
    return found.radius_mm


def sensor_window(
    lens: Lens,
    patch: Patch,
    plane_distances_mm: Sequence[float],
    pixels: int | tuple[int, int] | None = None,
    state: SystemState | Pose = AS_DESIGNED,
) -> Sensor:
    """Return the central window of the design's sensor that a patch illuminates.

    Parameters
    ----------
    lens, patch
        Lens and patch of the object.
    plane_distances_mm
        Distances of the recording planes from the exit vertex.
    pixels
        Number of pixels along each side, or (across, down). Default: enough for the footprint on all planes.
    state
        Position errors of lens, object and sensor.

    Raises
    ------
    InputError
        If the sensor has fewer pixels than requested.
    """
    if pixels is None:
        widest = max(footprint_mm(lens, patch, z, state) for z in plane_distances_mm)
        pixels = pixels_across(lens.sensor, widest)
    return central_window(lens.sensor, plane_distances_mm, pixels)


def pixels_across(sensor: Sensor, width_mm: float) -> tuple[int, int]:
    """Return the pixels (across, down) of a window over light of a width, at most those of the sensor."""
    needed = _pixels_over(width_mm, sensor)
    across, down = (min(needed, most) for most in sensor.pixels)
    return across, down


def _pixels_over(width_mm: float, sensor: Sensor) -> int:
    return scipy.fft.next_fast_len(math.ceil(1e3 * WINDOW_MARGIN * width_mm / sensor.pixel_pitch_um))


def central_window(
    whole: Sensor, plane_distances_mm: Sequence[float], pixels: int | tuple[int, int]
) -> Sensor:
    """Return the central window of a sensor with a number of pixels along each side, or (across, down).

    Raises
    ------
    InputError
        If the sensor has fewer pixels.
    """
    if isinstance(pixels, tuple):
        if not all(1 <= n <= most for n, most in zip(pixels, whole.pixels, strict=True)):
            across, down = whole.pixels
            raise InputError(
                f"pixels = {pixels[0]} x {pixels[1]}: must be from 1 x 1 to the sensor's {across} x {down}"
            )
        return whole.replaced(pixels=pixels, plane_distances_mm=tuple(sorted(plane_distances_mm)))
    if not 1 <= pixels <= min(whole.pixels):
        raise InputError(f"pixels = {pixels}: must be from 1 to the sensor's {min(whole.pixels)}")
    return whole.replaced(pixels=(pixels, pixels), plane_distances_mm=tuple(sorted(plane_distances_mm)))


def check_footprint(
    lens: Lens,
    patch: Patch,
    sensor: Sensor,
    plane_distances_mm: Sequence[float],
    state: SystemState | Pose = AS_DESIGNED,
) -> None:
    """Check that a patch's light falls on the sensor.

    Raises
    ------
    InputError
        If more than the fraction `LARGEST_CUT` of the footprint lies outside the sensor.

    Warns
    -----
    FootprintWarning
        If a smaller fraction lies outside.
    """
    for distance in plane_distances_mm:
        check_width(footprint_mm(lens, patch, distance, state), sensor, distance)


def check_width(width_mm: float, sensor: Sensor, plane_distance_mm: float) -> None:
    """Check that a footprint of a width on a plane falls on the sensor; see :func:`check_footprint`."""
    lost = _fraction_outside(width_mm, sensor.size_mm)
    if lost <= 0.0:
        return
    across, down = sensor.size_mm
    message = (
        f"plane at {plane_distance_mm:g} mm: the light's footprint of {width_mm:.4g} mm reaches beyond the "
        f"sensor's {across:.4g} mm x {down:.4g} mm with {100.0 * lost:.2g} % of its area: use a "
        "smaller patch, more pixels or a nearer plane"
    )
    if lost > LARGEST_CUT:
        raise InputError(message)
    warnings.warn(message, FootprintWarning, stacklevel=3)


def _fraction_outside(width_mm: float, sides_mm: tuple[float, float]) -> float:
    """Return the fraction of a disc's area outside a rectangle with the same centre."""
    samples = np.linspace(-0.5, 0.5, 801) * width_mm
    x, y = samples[None, :], samples[:, None]
    disc = np.hypot(x, y) <= 0.5 * width_mm
    outside = (np.abs(x) > 0.5 * sides_mm[0]) | (np.abs(y) > 0.5 * sides_mm[1])
    return float(np.mean(outside[disc]))


def diversity(lens: Lens, patch: Patch, plane_distances_mm: Sequence[float]) -> float:
    """Return the phase diversity of the outermost planes, dz w^2 / (lambda f^2).

    Light of a field stop of width w leaves the lens within angles of w / f. Its finest detail on a plane has
    the width lambda f / w. Over the distance dz, parts of the light shift against each other by dz w / f.
    The phase diversity is this shift in units of the finest detail. Wavelength and focal length are those in
    the medium in front of the sensor.

    Parameters
    ----------
    lens, patch
        Lens and patch of the object.
    plane_distances_mm
        Distances of the recording planes; the diversity of a single plane is 0.
    """
    focal_mm = first_order(lens, patch.wavelength_um).efl_mm
    separation_mm = max(plane_distances_mm) - min(plane_distances_mm)
    wavelength_mm = 1e-3 * patch.wavelength_um / lens.sensor_medium_index(patch.wavelength_um)
    return separation_mm * (patch.field_stop_mm / focal_mm) ** 2 / wavelength_mm


def check_diversity(lens: Lens, patch: Patch, plane_distances_mm: Sequence[float]) -> float:
    """Return the phase diversity (:func:`diversity`), with a warning if it is low.

    Warns
    -----
    DiversityWarning
        If the diversity is below `LEAST_DIVERSITY`.
    """
    value = diversity(lens, patch, plane_distances_mm)
    if value < LEAST_DIVERSITY:
        warnings.warn(
            f"little diversity between planes {', '.join(f'{z:g}' for z in plane_distances_mm)} mm: "
            f"dz w^2 / (lambda f^2) = {value:.3g}, which should be {LEAST_DIVERSITY:g} or more; the phase "
            "may not be found: use planes farther from each other, or a larger field stop",
            DiversityWarning,
            stacklevel=2,
        )
    return value


def exit_scene(
    lens: Lens, patch: Patch, sensor: Sensor, first_mm: float, pose: Pose = Pose(), oversampling: int = 1
) -> Scene:
    """Return the scene between a patch and a sensor window on the first plane.

    Parameters
    ----------
    lens, patch
        Lens and patch of the object.
    sensor
        Sensor window.
    first_mm
        Distance of the first plane from the exit vertex.
    pose
        Pose of the mounted lens.
    oversampling
        Samples per pixel.
    """
    grid = sensor_grid(sensor, lens.exit_vertex_z_mm + first_mm, oversampling)
    # Reconstructions use scalar waves, whatever error they allow.
    return Scene(lens, patch.grid, grid, patch.wavelength_um, pose, polarization=SCALAR)


def light_window(sensor: Sensor, footprint_mm: float) -> Sensor:
    """Return a sensor window, widened where necessary to cover light of a diameter about its centre."""
    needed = _pixels_over(footprint_mm, sensor)
    across, down = (max(n, needed) for n in sensor.pixels)
    return sensor.replaced(pixels=(across, down))
