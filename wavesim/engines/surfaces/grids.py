"""Choice of the transverse grid for propagation through a lens, from rays.

The rays of the centre and the corners of the object grid determine how far the light extends on each surface,
and how steep it is in each medium. A margin of some Fresnel zones is added for diffraction.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
import scipy.fft

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, SamplingError
from lensdesign.raytrace.bundles import launch_compiled, pupil_fan, pupil_rings
from lensdesign.raytrace.rays import trace_compiled
from lensdesign.raytrace.status import Status
from wavesim.engines.surfaces.samples import surface_slopes
from wavesim.engines.surfaces.waves import Medium
from wavesim.fields.field import Grid
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.rays.interfaces import surface_map, validate_meridional
from wavesim.scene.engine import Cost
from wavesim.scene.scene import Scene

BAND_MARGIN, REACH_MARGIN, WINDOW_MARGIN = 1.1, 1.05, 1.02
FRESNEL_ZONES = 4.0
LARGEST_BYTES, LONGEST_SECONDS = 20e9, 3600.0
"""Limits of memory and time above which an engine runs only with `force`."""


class TotalReflectionWarning(UserWarning):
    """Some of the object's light is totally reflected and never leaves the lens."""


@dataclass(frozen=True)
class WorkingGrid:
    """Transverse grid and media of a propagation through a lens.

    Attributes
    ----------
    grid : Grid
        Transverse samples, in the plane z = 0.
    media : tuple of Medium
        Medium in front of the first surface, and behind each surface.
    reach_mm : tuple of float
        Largest distance from the grid's centre at which light meets each surface.
    heights_mm : tuple of (float, float)
        Lowest and highest point of each surface within this distance.
    reflected : float
        Fraction of the rays that are totally reflected.
    diffracted : float
        Fraction of the energy that diffraction at the rim sends beyond the bands, for light that fills the
        stop evenly.
    """

    grid: Grid
    media: tuple[Medium, ...]
    reach_mm: tuple[float, ...]
    heights_mm: tuple[tuple[float, float], ...]
    reflected: float
    diffracted: float

    @property
    def samples_on_surfaces(self) -> list[int]:
        """Number of the grid's samples on each surface within reach of the light."""
        grid = self.grid
        if grid.is_line:
            return [min(grid.size, math.ceil(2.0 * r / grid.pitch_mm)) for r in self.reach_mm]
        return [min(grid.size, math.ceil(math.pi * (r / grid.pitch_mm) ** 2)) for r in self.reach_mm]

    def transfers(
        self, scene: Scene, start_mm: float, end_mm: float
    ) -> tuple[FreeSpacePropagator, FreeSpacePropagator]:
        """Return the propagators from the object to the first plane, and from the last plane to the exit."""
        into = FreeSpacePropagator(
            scene.object_grid, self.grid.at(start_mm), scene.wavelength_um, self.media[0].index
        )
        out = FreeSpacePropagator(
            self.grid.at(end_mm),
            scene.exit_grid,
            scene.wavelength_um,
            self.media[-1].index,
            plate=scene.system.cover_glass,
        )
        return into, out


@dataclass(frozen=True)
class LightExtent:
    """Extent of an object's light within a lens, from rays.

    Attributes
    ----------
    middle_mm : (x, y)
        Point about which the lens is sampled.
    bands_per_mm, tangents : tuple of float
        Largest transverse wavenumber in each medium, and the tangent of its angle to the axis.
    reach_mm, heights_mm : tuple
        Extent on each surface, as in :class:`WorkingGrid`.
    coarsest_mm : tuple of float
        Coarsest pitch on each surface that avoids aliasing on both sides.
    reflected, diffracted : float
        As in :class:`WorkingGrid`.
    """

    middle_mm: tuple[float, float]
    bands_per_mm: tuple[float, ...]
    tangents: tuple[float, ...]
    reach_mm: tuple[float, ...]
    heights_mm: tuple[tuple[float, float], ...]
    coarsest_mm: tuple[float, ...]
    reflected: float
    diffracted: float

    def own_half_mm(self, surface: int) -> float:
        """Return the half-width of the window in which light of a surface does not wrap around."""
        low, high = self.heights_mm[surface]
        return self.reach_mm[surface] + (high - low) * max(self.tangents[surface : surface + 2])

    def leg_half_mm(self, surface: int) -> float:
        """Return the half-width of the window in which light between a surface and the next does not wrap."""
        (low, _), (_, high) = self.heights_mm[surface : surface + 2]
        own, following = self.reach_mm[surface : surface + 2]
        return 0.5 * (own + following + (high - low) * self.tangents[surface + 1])


@dataclass(frozen=True)
class _Bundle:
    """Extent of the rays on each surface about the centre, and their largest sine in each medium."""

    reach_mm: Array
    sines: Array
    reflected: float


def check_grid_size(engine: str, samples: int, cost: Cost, force: bool) -> None:
    """Check that a run stays within the limits of memory and time, unless it is forced.

    Parameters
    ----------
    engine
        Name of the engine.
    samples
        Samples of the largest grid.
    cost
        Prediction of the engine.
    force
        Whether to skip the check.

    Raises
    ------
    SamplingError
        If a limit is exceeded; the message contains samples, memory and hours.
    """
    seconds = cost.setup_seconds + cost.seconds
    if force or (cost.peak_bytes <= LARGEST_BYTES and seconds <= LONGEST_SECONDS):
        return
    raise SamplingError(
        f"engine {engine}: {samples:.3g} samples take {cost.peak_bytes:.3g} bytes and "
        f"{seconds / 3600:.3g} hours; allowed: {LARGEST_BYTES:.3g} bytes and {LONGEST_SECONDS / 3600:.3g} h: "
        "use a line, a smaller object or lens, or another engine, or set force = True"
    )


def working_grid(
    scene: Scene,
    pitch_mm: float | None = None,
    half_width_mm: float | None = None,
    zones: float = FRESNEL_ZONES,
) -> WorkingGrid:
    """Choose the transverse grid, or check a given one.

    Parameters
    ----------
    scene
        Lens, grids and wavelength.
    pitch_mm, half_width_mm
        Pitch and half-width of the grid. Default: by the extent of the light.
    zones
        Margin for diffraction at the rim, in Fresnel zones of the object.

    Raises
    ------
    InputError
        If fewer than three rays pass the lens, the lens does not lie behind the object, or a figure deflects
        rays out of the plane of a line.
    SamplingError
        If the given pitch or width cannot sample the field, or the light is too oblique.

    Warns
    -----
    TotalReflectionWarning
        If some of the rays never leave the lens.
    """
    light = light_extent(scene, zones)
    grid = sampled(scene, light, min(light.coarsest_mm), _narrowest_mm(light), pitch_mm, half_width_mm)
    media = tuple(
        Medium(grid, scene.wavelength_um, float(n), band)
        for n, band in zip(scene.system.index[0], light.bands_per_mm, strict=True)
    )
    return WorkingGrid(grid, media, light.reach_mm, light.heights_mm, light.reflected, light.diffracted)


def light_extent(scene: Scene, zones: float = FRESNEL_ZONES) -> LightExtent:
    """Measure extent and steepness of an object's light within a lens by tracing rays.

    Parameters
    ----------
    scene, zones
        As in :func:`working_grid`.

    Raises
    ------
    InputError
        If fewer than three rays pass the lens, the lens does not lie behind the object, or a figure deflects
        rays out of the plane of a line.
    SamplingError
        If the light is too oblique.

    Warns
    -----
    TotalReflectionWarning
        If some of the rays never leave the lens.
    """
    middle = scene.system.vertex[0, 0, :2].copy()
    if scene.object_grid.is_line:
        middle[0] = 0.0
    _first_leg_mm(scene)
    bundle = _bundle(scene, middle)
    bands, tangents = _bands(scene, bundle.sines, zones)
    reach = _reach(scene, bundle, middle, zones)
    profiles = [_profile(scene, i, middle, r) for i, r in enumerate(reach)]
    if bundle.reflected > 0.0:
        warnings.warn(_reflection_message(bundle.reflected), TotalReflectionWarning, stacklevel=5)
    return LightExtent(
        (float(middle[0]), float(middle[1])),
        tuple(bands),
        tuple(tangents),
        tuple(reach),
        tuple((low, high) for low, high, _ in profiles),
        tuple(_coarsest_mm(scene, bands, [slope for _, _, slope in profiles])),
        bundle.reflected,
        _diffracted(scene, bundle, bands),
    )


def sampled(
    scene: Scene,
    light: LightExtent,
    coarsest_mm: float,
    narrowest_mm: float,
    pitch_mm: float | None,
    half_width_mm: float | None,
) -> Grid:
    """Return a grid about the centre of the lens that is fine and wide enough, or the given one.

    Raises
    ------
    InputError
        If the given pitch or width is not finite and above 0.
    SamplingError
        If the given pitch or width cannot sample the field.
    """
    # Pitch, as a fraction of the coarsest that samples the field.
    fineness = 0.9
    pitch = fineness * coarsest_mm if pitch_mm is None else pitch_mm
    half = WINDOW_MARGIN * narrowest_mm if half_width_mm is None else half_width_mm
    _check(pitch, coarsest_mm, half, narrowest_mm)
    count = scipy.fft.next_fast_len(math.ceil(2.0 * half / pitch))
    return Grid((count,) * len(scene.object_grid.shape), pitch, 0.0, light.middle_mm)


def _check(pitch: float, coarsest: float, half: float, narrowest: float) -> None:
    if not (math.isfinite(pitch) and pitch > 0.0 and math.isfinite(half) and half > 0.0):
        raise InputError(f"working grid pitch_mm = {pitch!r}, half_width_mm = {half!r}: must be above 0")
    if pitch > coarsest:
        raise SamplingError(
            f"working grid pitch_mm = {pitch:.4g}: too coarse for the steepest light on the surfaces; "
            f"must be at most {coarsest:.4g} mm"
        )
    if half < narrowest:
        raise SamplingError(
            f"working grid half_width_mm = {half:.4g}: too narrow, so that light wraps around; must be at "
            f"least {narrowest:.4g} mm"
        )


def _bundle(scene: Scene, middle: Array) -> _Bundle:
    grid, lens = scene.object_grid, scene.lens
    (x, y), half = grid.centre_mm, grid.half_widths_mm
    if grid.is_line:
        points, pupil = [(x, y), (x, y - half[0]), (x, y + half[0])], pupil_fan(65).points
    else:
        points = [(x, y)] + [(x + i * half[1], y + j * half[0]) for i in (-1, 1) for j in (-1, 1)]
        pupil = pupil_rings(6, 24, edge=True).points
    origins, directions = launch_compiled(
        scene.system, points, pupil, grid.z_mm, lens.stop_index, lens.stop_semi_diameter_mm * (1.0 - 1e-9)
    )
    rays = trace_compiled(scene.system, origins, directions, record_hits=True)
    reflected = float(np.mean(rays.status == Status.TOTAL_REFLECTION))
    if np.count_nonzero(rays.ok) < 3:
        why = f": {_reflection_message(reflected)}" if reflected > 0.0 else ""
        raise InputError(
            f"fewer than three rays from the object grid at {grid.centre_mm} mm get through{why}"
        )
    if any(scene.system.figures):
        validate_meridional(scene, rays)
    assert rays.hits is not None
    hits = rays.hits[rays.ok]
    legs = np.diff(np.concatenate([origins[rays.ok, None], hits], axis=1), axis=1)
    legs /= np.linalg.norm(legs, axis=-1, keepdims=True)
    headings = np.concatenate([legs, rays.direction[rays.ok, None]], axis=1)
    return _Bundle(
        np.max(np.linalg.norm(hits[..., :2] - middle, axis=-1), axis=0),
        np.max(np.linalg.norm(headings[..., :2], axis=-1), axis=0),
        reflected,
    )


def _reflection_message(fraction: float) -> str:
    return (
        f"total reflection: {100.0 * fraction:.3g} % of the rays from the object's middle and rim never "
        "leave the lens"
    )


def _bands(scene: Scene, sines: Array, zones: float) -> tuple[list[float], list[float]]:
    """Return the largest transverse wavenumber in each medium, and the tangent of its angle."""
    k = scene.wavenumber_per_mm * scene.system.index[0]
    zone = np.sqrt(k / _first_leg_mm(scene))
    steepest_sine = 0.98
    if np.max(sines) > steepest_sine:
        raise SamplingError(
            f"light at {math.degrees(math.asin(np.max(sines))):.3g} degrees to the axis: at most "
            f"{math.degrees(math.asin(steepest_sine)):.3g} degrees can be propagated between planes"
        )
    band = np.minimum(k * sines * BAND_MARGIN + zones * zone, steepest_sine * k)
    return list(band), list(band / np.sqrt(k * k - band * band))


def _diffracted(scene: Scene, bundle: _Bundle, bands: list[float]) -> float:
    """Return the fraction of evenly distributed energy that the rim diffracts beyond the band."""
    stop, k = scene.lens.stop_index, scene.wavenumber_per_mm * scene.system.index[0]
    beyond = np.maximum(np.array(bands) - k * bundle.sines, 1e-300)[stop + 1 :]
    # The spectrum of an edge falls as 1 / q; a slit has two edges, a disc twice as much rim for its area.
    rim = 2.0 / bundle.reach_mm[stop:] * (0.5 if scene.object_grid.is_line else 1.0)
    return float(min(1.0, np.max(rim / (2.0 * math.pi * beyond))))


def _reach(scene: Scene, bundle: _Bundle, middle: Array, zones: float) -> list[float]:
    zone = zones * math.sqrt(1e-3 * scene.wavelength_um * _first_leg_mm(scene))
    offset = np.linalg.norm(scene.system.vertex[0, :, :2] - middle, axis=-1)
    light = REACH_MARGIN * bundle.reach_mm + zone
    return [float(r) for r in np.minimum(light, scene.system.semi_diameter + offset)]


def _first_leg_mm(scene: Scene) -> float:
    leg = float(scene.system.vertex[0, 0, 2]) - scene.object_grid.z_mm
    if leg <= 0.0:
        raise InputError(f"the front vertex lies {-leg:g} mm in front of the object grid: must lie behind it")
    return leg


def _profile(scene: Scene, surface: int, middle: Array, reach_mm: float) -> tuple[float, float, float]:
    """Return lowest point, highest point and largest slope of a surface along the grid's central lines."""
    t = np.linspace(-reach_mm, reach_mm, 257)
    x, y = np.full_like(t, middle[0]), middle[1] + t
    if not scene.object_grid.is_line:
        x, y = np.append(x, middle[0] + t), np.append(y, np.full_like(t, middle[1]))
    found = surface_map(scene.system, surface, x, y)
    z = found.z_mm[found.inside]
    slopes = surface_slopes(scene.system, surface, x[found.inside], y[found.inside], z)
    if z.size == 0 or not np.isfinite(slopes).all():
        raise InputError(
            f"surface {surface} does not exist over the grid's centre where light meets it: reduce its "
            "tilt or decenter"
        )
    return float(np.min(z)), float(np.max(z)), float(np.max(np.abs(slopes)))


def _coarsest_mm(scene: Scene, bands: list[float], slopes: list[float]) -> list[float]:
    k = scene.wavenumber_per_mm * scene.system.index[0]
    result = []
    for i, slope in enumerate(slopes):
        lifts = {side: k[side] - math.sqrt(k[side] ** 2 - bands[side] ** 2) for side in (i, i + 1)}
        rate = max(2.0 * bands[side] + slope * lift for side, lift in lifts.items())
        result.append(float(2.0 * math.pi / rate))
    return result


def _narrowest_mm(light: LightExtent) -> float:
    """Return the half-width of the window in which no light of the band wraps around."""
    surfaces = range(len(light.reach_mm))
    return max([light.own_half_mm(i) for i in surfaces] + [light.leg_half_mm(i) for i in surfaces[:-1]])
