"""The transverse grid on which a field is carried through a lens, chosen from rays before any field is.

The rays of the object grid's middle and corners tell how far the light reaches on each surface, and how
steeply it travels in each medium. Beside them there is room for diffraction: some Fresnel zones.
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
STEEPEST_SINE = 0.98
FINENESS = 0.9
"""Pitch chosen, as a share of the coarsest that holds the field."""
PROFILE_POINTS = 257
LARGEST_BYTES, LONGEST_SECONDS = 20e9, 3600.0
"""More is only done when forced."""


class TotalReflectionWarning(UserWarning):
    """Some of the object's light is totally reflected, and never leaves the lens."""


@dataclass(frozen=True)
class WorkingGrid:
    """Where and in which media a field is carried through a lens.

    Attributes
    ----------
    grid : Grid
        Transverse samples, in the plane z = 0.
    media : tuple of Medium
        In front of the first surface, and behind each.
    reach_mm : tuple of float
        Of each surface, the distance from the middle of the grid up to which light meets it.
    heights_mm : tuple of (float, float)
        Of each surface, the lowest and the highest point within reach.
    reflected : float
        Share of the rays that are totally reflected.
    spared : float
        Of the energy of light that fills the stop evenly, what its rim turns beyond the bands.
    """

    grid: Grid
    media: tuple[Medium, ...]
    reach_mm: tuple[float, ...]
    heights_mm: tuple[tuple[float, float], ...]
    reflected: float
    spared: float

    @property
    def samples_on_surfaces(self) -> list[int]:
        """Of each surface, the number of the grid's samples within reach."""
        grid = self.grid
        if grid.is_line:
            return [min(grid.size, math.ceil(2.0 * r / grid.pitch_mm)) for r in self.reach_mm]
        return [min(grid.size, math.ceil(math.pi * (r / grid.pitch_mm) ** 2)) for r in self.reach_mm]

    def transfers(
        self, scene: Scene, start_mm: float, end_mm: float
    ) -> tuple[FreeSpacePropagator, FreeSpacePropagator]:
        """From the object to the grid's first plane, and from its last one to the exit."""
        into = FreeSpacePropagator(
            scene.object_grid, self.grid.at(start_mm), scene.wavelength_um, self.media[0].index
        )
        out = FreeSpacePropagator(
            self.grid.at(end_mm), scene.exit_grid, scene.wavelength_um, self.media[-1].index
        )
        return into, out


@dataclass(frozen=True)
class LightWithin:
    """What rays tell of an object's light within a lens.

    Attributes
    ----------
    middle_mm : (x, y)
        About which the lens is sampled.
    bands_per_mm, tangents : tuple of float
        In each medium, the largest transverse wave number, and the tangent of its angle to the axis.
    reach_mm, heights_mm : tuple
        Of each surface, as of :class:`WorkingGrid`.
    coarsest_mm : tuple of float
        Of each surface, the pitch at which neither side mistakes one wave of its band for another.
    reflected, spared : float
        As of :class:`WorkingGrid`.
    """

    middle_mm: tuple[float, float]
    bands_per_mm: tuple[float, ...]
    tangents: tuple[float, ...]
    reach_mm: tuple[float, ...]
    heights_mm: tuple[tuple[float, float], ...]
    coarsest_mm: tuple[float, ...]
    reflected: float
    spared: float

    def own_half_mm(self, surface: int) -> float:
        """Half of the window in which light of a surface that leaves on one side does not come in again."""
        low, high = self.heights_mm[surface]
        return self.reach_mm[surface] + (high - low) * max(self.tangents[surface : surface + 2])

    def leg_half_mm(self, surface: int) -> float:
        """The same of light between a surface and the next."""
        (low, _), (_, high) = self.heights_mm[surface : surface + 2]
        here, there = self.reach_mm[surface : surface + 2]
        return 0.5 * (here + there + (high - low) * self.tangents[surface + 1])


@dataclass(frozen=True)
class _Bundle:
    """How far the rays of each surface reach from the middle, and how steep they are in each medium."""

    reach_mm: Array
    sines: Array
    reflected: float


def check_grid_size(engine: str, samples: int, cost: Cost, force: bool) -> None:
    """Refuse what takes more memory or time than one run may, unless it is forced.

    Parameters
    ----------
    engine
        Name.
    samples
        Of the largest grid.
    cost
        As the engine predicts it.
    force
        Whether to let it run all the same.

    Raises
    ------
    SamplingError
        If it is refused; names samples, memory and hours.
    """
    seconds = cost.setup_seconds + cost.seconds
    if force or (cost.peak_bytes <= LARGEST_BYTES and seconds <= LONGEST_SECONDS):
        return
    raise SamplingError(
        f"engine {engine}: {samples:.3g} samples take {cost.peak_bytes:.3g} bytes and "
        f"{seconds / 3600:.3g} hours, over {LARGEST_BYTES:.3g} bytes or {LONGEST_SECONDS / 3600:.3g} h: use "
        "a line, a smaller object or lens, or another engine, or run it all the same with force = True"
    )


def working_grid(
    scene: Scene,
    pitch_mm: float | None = None,
    half_width_mm: float | None = None,
    zones: float = FRESNEL_ZONES,
) -> WorkingGrid:
    """Choose the grid, or check one that is asked for.

    Parameters
    ----------
    scene
        What is carried where.
    pitch_mm, half_width_mm
        Of the grid; chosen if left out.
    zones
        Room beside the rays for light that the rim turns, in Fresnel zones of the object.

    Raises
    ------
    InputError
        If hardly a ray gets through the lens, it does not stand behind the object, or a figure turns rays out
        of the plane of a line.
    SamplingError
        If the pitch or the width asked for cannot hold the field, or light runs along the planes.

    Warns
    -----
    TotalReflectionWarning
        If some of the rays never leave the lens.
    """
    light = light_within(scene, zones)
    grid = sampled(scene, light, min(light.coarsest_mm), _narrowest_mm(light), pitch_mm, half_width_mm)
    media = tuple(
        Medium(grid, scene.wavelength_um, float(n), band)
        for n, band in zip(scene.system.index[0], light.bands_per_mm, strict=True)
    )
    return WorkingGrid(grid, media, light.reach_mm, light.heights_mm, light.reflected, light.spared)


def light_within(scene: Scene, zones: float = FRESNEL_ZONES) -> LightWithin:
    """How far the light of an object reaches within a lens, and how steep it is, from rays.

    Parameters
    ----------
    scene, zones
        As of :func:`working_grid`.

    Raises
    ------
    InputError, SamplingError
        As :func:`working_grid`.

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
    return LightWithin(
        (float(middle[0]), float(middle[1])),
        tuple(bands),
        tuple(tangents),
        tuple(reach),
        tuple((low, high) for low, high, _ in profiles),
        tuple(_coarsest_mm(scene, bands, [slope for _, _, slope in profiles])),
        bundle.reflected,
        _spared(scene, bundle, bands),
    )


def sampled(
    scene: Scene,
    light: LightWithin,
    coarsest_mm: float,
    narrowest_mm: float,
    pitch_mm: float | None,
    half_width_mm: float | None,
) -> Grid:
    """Grid about the middle of the lens that is fine and wide enough, or is asked for.

    Raises
    ------
    SamplingError, InputError
        If the pitch or the width asked for cannot hold the field.
    """
    pitch = FINENESS * coarsest_mm if pitch_mm is None else pitch_mm
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
            f"at most {coarsest:.4g} mm holds it"
        )
    if half < narrowest:
        raise SamplingError(
            f"working grid half_width_mm = {half:.4g}: too narrow, light would come in again on the other "
            f"side; at least {narrowest:.4g} mm"
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


def _reflection_message(share: float) -> str:
    return f"total reflection: {100.0 * share:.3g} % of the rays from the object's middle and rim never leave"


def _bands(scene: Scene, sines: Array, zones: float) -> tuple[list[float], list[float]]:
    """Largest transverse wave number in each medium, and the tangent of its angle."""
    k = scene.wavenumber_per_mm * scene.system.index[0]
    zone = np.sqrt(k / _first_leg_mm(scene))
    if np.max(sines) > STEEPEST_SINE:
        raise SamplingError(
            f"light at {math.degrees(math.asin(np.max(sines))):.3g} degrees to the axis: at most "
            f"{math.degrees(math.asin(STEEPEST_SINE)):.3g} degrees can be carried from plane to plane"
        )
    band = np.minimum(k * sines * BAND_MARGIN + zones * zone, STEEPEST_SINE * k)
    return list(band), list(band / np.sqrt(k * k - band * band))


def _spared(scene: Scene, bundle: _Bundle, bands: list[float]) -> float:
    """Of evenly lit energy, what a straight edge turns by more than the band is wide beyond the rays."""
    stop, k = scene.lens.stop_index, scene.wavenumber_per_mm * scene.system.index[0]
    beyond = np.maximum(np.array(bands) - k * bundle.sines, 1e-300)[stop + 1 :]
    # An edge's spectrum is 1 / q; a slit has two of them, a disc twice as much rim for its area.
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
    """Lowest and highest point, and largest slope, of a surface along the grid's middle lines."""
    t = np.linspace(-reach_mm, reach_mm, PROFILE_POINTS)
    x, y = np.full_like(t, middle[0]), middle[1] + t
    if not scene.object_grid.is_line:
        x, y = np.append(x, middle[0] + t), np.append(y, np.full_like(t, middle[1]))
    found = surface_map(scene.system, surface, x, y)
    z = found.z_mm[found.inside]
    slopes = surface_slopes(scene.system, surface, x[found.inside], y[found.inside], z)
    if z.size == 0 or not np.isfinite(slopes).all():
        raise InputError(
            f"surface {surface} is not there over the grid's middle where light meets it: it is tilted or "
            "decentered too far"
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


def _narrowest_mm(light: LightWithin) -> float:
    """Half of the window in which light of the band that leaves on one side does not come in on the other."""
    surfaces = range(len(light.reach_mm))
    return max([light.own_half_mm(i) for i in surfaces] + [light.leg_half_mm(i) for i in surfaces[:-1]])
