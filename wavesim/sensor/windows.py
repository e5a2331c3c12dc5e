"""From a patch of the object to frames: engine, sensor window, recording planes, and what they can tell."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np
import scipy.fft

from lensdesign.analysis.paraxial import first_order
from lensdesign.analysis.spread import footprint
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, Sensor
from lensdesign.lens.poses import Pose
from wavesim.engines.choosing import engine_for
from wavesim.engines.registry import AUTO, settings_of
from wavesim.engines.surfaces.grids import LARGEST_BYTES
from wavesim.scene.engine import Engine
from wavesim.scene.light import Light
from wavesim.scene.placement import NOMINAL, Placement, placed
from wavesim.scene.scene import Scene
from wavesim.scene.settings import EngineSettings
from wavesim.sensor.sensor import FootprintWarning, sensor_grid
from wavesim.targets.patch import Patch

WINDOW_MARGIN, OVERSAMPLING = 1.02, 2
"""Sensor windows are wider than the footprint by this factor; samples per pixel of what falls on them."""

LARGEST_CUT = 0.2
"""Share of the footprint that may lie beside the sensor; a larger one is refused."""

LEAST_DIVERSITY = 10.0
"""Below which planes tell too little of the phase; see :func:`diversity`."""

TILE_ERROR = 0.05
"""Relative error that tiles of an engine named may leave, if nothing else is said."""


class DiversityWarning(UserWarning):
    """Recording planes are so near each other that their intensities tell little of the phase."""


def imaging_engine(
    scene: Scene,
    settings: EngineSettings,
    *,
    runs: int,
    light: Light,
    memory_gb: float = 1e-9 * LARGEST_BYTES,
) -> Engine:
    """The engine that settings ask for; where they allow no error, with the one that does for imaging.

    Parameters
    ----------
    scene
        What is to be carried where.
    settings
        Engine, error, and details.
    runs, light, memory_gb
        As of :func:`wavesim.engine_for`.

    Raises
    ------
    InputError, SamplingError
        As :func:`wavesim.engine_for`.
    """
    name, error = settings.engine, settings.error
    if error is None and name != AUTO and "error" in settings_of(name):
        error = TILE_ERROR
    return engine_for(
        scene, name, error=error, memory_gb=memory_gb, runs=runs, light=light, **settings.details()
    )


def footprint_mm(
    lens: Lens, patch: Patch, plane_distance_mm: float, placement: Placement | Pose = NOMINAL
) -> float:
    """Diameter of a disc about the sensor's middle that holds a patch's light on a plane, by rays.

    The smallest one where object and sensor stand in their places.

    Raises
    ------
    DesignError
        If no ray passes the lens.
    """
    place = placed(placement)
    x, y, z = place.object_shift_mm
    # Light of a displaced object crosses the design's object plane so much beside the field stop.
    beside = math.hypot(x, y) + abs(z) * math.tan(math.asin(min(lens.object.numerical_aperture, 0.99)))
    beside += math.hypot(*patch.field_stop_at_mm)
    space = lens.object.replaced(field_diameter_mm=patch.field_stop_mm + 2.0 * beside)
    lit = lens.replaced(object=space)
    found = footprint(lit, patch.wavelength_um, plane_distance_mm, place.pose, place.surface_perturbations)
    return 2.0 * (found.radius_mm + math.hypot(*place.sensor_shift_mm[:2]))


def sensor_window(
    lens: Lens,
    patch: Patch,
    plane_distances_mm: Sequence[float],
    pixels: int | tuple[int, int] | None = None,
    placement: Placement | Pose = NOMINAL,
) -> Sensor:
    """The middle of the design's sensor, as much of it as a patch's light falls on.

    Parameters
    ----------
    lens, patch
        What is imaged.
    plane_distances_mm
        Recording planes, from the exit vertex.
    pixels
        Along each side, or across and down; left out, what just holds the footprint on all planes.
    placement
        Where lens, object and sensor are.

    Raises
    ------
    InputError
        If more pixels are asked for than the sensor has.
    """
    whole = lens.sensor
    if isinstance(pixels, tuple):
        if not all(1 <= n <= most for n, most in zip(pixels, whole.pixels, strict=True)):
            across, down = whole.pixels
            raise InputError(
                f"pixels = {pixels[0]} x {pixels[1]}: must be from 1 x 1 to the sensor's {across} x {down}"
            )
        return whole.replaced(pixels=pixels, plane_distances_mm=tuple(sorted(plane_distances_mm)))
    if pixels is not None and not 1 <= pixels <= min(whole.pixels):
        raise InputError(f"pixels = {pixels}: must be from 1 to the sensor's {min(whole.pixels)}")
    if pixels is None:
        widest = max(footprint_mm(lens, patch, z, placement) for z in plane_distances_mm)
        pixels = scipy.fft.next_fast_len(math.ceil(1e3 * WINDOW_MARGIN * widest / whole.pixel_pitch_um))
    across, down = (min(pixels, most) for most in whole.pixels)
    return whole.replaced(pixels=(across, down), plane_distances_mm=tuple(sorted(plane_distances_mm)))


def check_footprint(
    lens: Lens,
    patch: Patch,
    sensor: Sensor,
    plane_distances_mm: Sequence[float],
    placement: Placement | Pose = NOMINAL,
) -> None:
    """Tell where a patch's light falls beside the pixels.

    Raises
    ------
    InputError
        If more than `LARGEST_CUT` of the footprint does.

    Warns
    -----
    FootprintWarning
        If a part of it does.
    """
    for distance in plane_distances_mm:
        width = footprint_mm(lens, patch, distance, placement)
        lost = _share_beside(width, sensor.size_mm)
        if lost <= 0.0:
            continue
        across, down = sensor.size_mm
        said = (
            f"plane at {distance:g} mm: the light's footprint of {width:.4g} mm reaches beyond the sensor's "
            f"{across:.4g} mm x {down:.4g} mm with {100.0 * lost:.2g} % of its area; take a "
            "smaller patch, more pixels or a nearer plane"
        )
        if lost > LARGEST_CUT:
            raise InputError(said)
        warnings.warn(said, FootprintWarning, stacklevel=2)


def _share_beside(width_mm: float, sides_mm: tuple[float, float]) -> float:
    """Part of a disc's area outside a rectangle with the same middle."""
    samples = np.linspace(-0.5, 0.5, 801) * width_mm
    x, y = samples[None, :], samples[:, None]
    disc = np.hypot(x, y) <= 0.5 * width_mm
    beside = (np.abs(x) > 0.5 * sides_mm[0]) | (np.abs(y) > 0.5 * sides_mm[1])
    return float(np.mean(beside[disc]))


def diversity(lens: Lens, patch: Patch, plane_distances_mm: Sequence[float]) -> float:
    """How much of the phase the outermost planes tell: dz w^2 / (lambda f^2).

    Light of a field stop of width w leaves the lens within angles of w / f, and its finest detail on a plane
    is lambda f / w wide: over dz its parts move against each other by so many details.

    Parameters
    ----------
    lens, patch
        What is imaged.
    plane_distances_mm
        Two or more; of one plane it is 0.
    """
    focal_mm = first_order(lens, patch.wavelength_um).efl_mm
    between = max(plane_distances_mm) - min(plane_distances_mm)
    return between * (patch.field_stop_mm / focal_mm) ** 2 / (1e-3 * patch.wavelength_um)


def check_diversity(lens: Lens, patch: Patch, plane_distances_mm: Sequence[float]) -> float:
    """The figure of :func:`diversity`, told if it is low.

    Warns
    -----
    DiversityWarning
        If it is below `LEAST_DIVERSITY`.
    """
    figure = diversity(lens, patch, plane_distances_mm)
    if figure < LEAST_DIVERSITY:
        warnings.warn(
            f"little diversity between planes {', '.join(f'{z:g}' for z in plane_distances_mm)} mm: "
            f"dz w^2 / (lambda f^2) = {figure:.3g}, which should be {LEAST_DIVERSITY:g} or more; the phase "
            "may not be found: take planes farther from each other, or a larger field stop",
            DiversityWarning,
            stacklevel=2,
        )
    return figure


def exit_scene(
    lens: Lens, patch: Patch, sensor: Sensor, first_mm: float, pose: Pose = Pose(), oversampling: int = 1
) -> Scene:
    """The scene between a patch and a sensor window on its first plane.

    Parameters
    ----------
    lens, patch
        What is imaged.
    sensor
        The window.
    first_mm
        Plane, from the exit vertex.
    pose
        Of the lens as mounted.
    oversampling
        Samples per pixel.
    """
    grid = sensor_grid(sensor, lens.exit_vertex_z_mm + first_mm, oversampling)
    return Scene(lens, patch.grid, grid, patch.wavelength_um, pose)


def light_window(
    lens: Lens, patch: Patch, sensor: Sensor, distance_mm: float, placement: Placement | Pose = NOMINAL
) -> Sensor:
    """A sensor window, widened where a patch's light on a plane is wider, so that none of it is lost."""
    width = WINDOW_MARGIN * footprint_mm(lens, patch, distance_mm, placement)
    needed = scipy.fft.next_fast_len(math.ceil(1e3 * width / sensor.pixel_pitch_um))
    across, down = (max(n, needed) for n in sensor.pixels)
    return sensor.replaced(pixels=(across, down))
