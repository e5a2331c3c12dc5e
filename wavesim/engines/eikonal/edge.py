"""The edge of the aperture in the light of eikonal tiles: how it is drawn, and the errors that remain.

The edge has one of three forms. *Fresnel*: each flat tile has the diffraction of its centre
(:mod:`wavesim.rays.edge_diffraction`). *Sharp*: where rays do not determine that diffraction, the footprint
ends abruptly, at the same samples for neighbouring tiles. *Soft*: tiles of a hierarchy are usually so wide
that the fringes of their points differ by a period. The Fresnel integrals F(x) have little more than their
rise in common. A real rise 3 e^2 - 2 e^3 over the right width approximates them nearly as well, at the cost
of a slightly wider footprint.

Errors at the edge are proportional to the amplitude there. An object that fills the aperture evenly has the
mean amplitude there; most objects have far less.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import SamplingError
from wavesim.engines.eikonal.plan import Tile
from wavesim.fields.field import Grid
from wavesim.rays.edge_diffraction import fresnel_edge
from wavesim.rays.maps import RIM_ARMS, RayMap, RayMapError, inside_border, moved, ray_map
from wavesim.rays.ray_bundles import FoldError, open_pupil, shoot, trace_bundle
from wavesim.scene.engine import ErrorTerm
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene

SOFT = 2.7
"""Width of the soft rise in x that minimizes the difference to F, also in the mean over a tile's points."""

FARTHEST, STEP, NODES = 60.0, 2e-3, 8
"""Largest x and step at which F is sampled, and number of points of a tile across the rim."""


def edge_map(
    scene: Scene, point_mm: tuple[float, float], plane_z_mm: float, reach_mm: float
) -> RayMap | None:
    """Return the ray map of an object point with the diffraction at the edge, if rays determine it.

    They do not where rays outside the rim are too irregular, such as for a figure that is measured up to it.
    Arguments are those of :func:`wavesim.rays.maps.ray_map`.
    """
    try:
        found = ray_map(scene, point_mm, plane_z_mm, reach_mm, edge=True)
    except (FoldError, RayMapError):
        return None
    return found if found.resolves_edge else None


def edge_terms(scene: Scene, tile: Tile, carrier: RayMap) -> tuple[ErrorTerm, ErrorTerm]:
    """Return the error terms of tiles that each have the edge of their centre, Fresnel's or a sharp one.

    They assume an object that fills the aperture evenly.

    Parameters
    ----------
    scene
        Lens and object plane.
    tile
        A typical tile.
    carrier
        Ray map of its centre.
    """
    movement, diffraction = _sharp_edge_errors(scene, tile, carrier)
    beyond = ""
    if carrier.edge is not None:
        beyond, diffraction = ", beyond Fresnel's", _fresnel_edge_error(scene, tile, carrier, diffraction)
    return (
        ErrorTerm("movement of the aperture's edge over a tile", movement, at_rim=True),
        ErrorTerm(f"diffraction at the aperture's edge{beyond}", diffraction, at_rim=True),
    )


def soft_edge_term(carrier: RayMap, spans_mm: Array, rise: float) -> ErrorTerm:
    """Return the error term of one soft edge for all points of a tile, for an evenly filled aperture.

    Parameters
    ----------
    carrier
        Ray map of a tile's centre, with its edge.
    spans_mm
        Extent of the tile, shape (2, 2).
    rise
        Width of the edge, in the squared relative distance to the rim.
    """
    edge, rim = carrier.edge, carrier.rim_mm
    assert edge is not None
    assert carrier.stop is not None
    away = rim - rim.mean(axis=0)
    turned = np.roll(away, -1, axis=0)
    parts = 0.5 * np.abs(away[:, 0] * turned[:, 1] - away[:, 1] * turned[:, 0])
    # Relative distance from the rim to the footprint's centre over which x is taken as linear.
    inward_fraction = 0.01
    inwards = carrier.pupil.inwards(carrier.stop.at(rim - inward_fraction * away)[::-1].T)
    # A relative distance s from the rim to the centre is 2 s of a sector's area.
    per_x = 2.0 * inward_fraction / (edge.rate * inwards)
    shift = 0.5 * edge.shift_per_mm * float(np.mean(np.ptp(spans_mm, axis=1)))
    lost = missed(rise * _x_per_square(carrier), shift)
    return ErrorTerm(
        f"diffraction at the aperture's edge, soft over {100.0 * rise:.2g} % of the footprint and equal for "
        "all points of a tile",
        math.sqrt(min(1.0, lost * float(parts @ per_x / np.sum(parts)))),
        at_rim=True,
    )


def shared_spans(
    scene: Scene, tiles: Sequence[Tile], carriers: Sequence[RayMap], axes: Sequence[Array]
) -> list[NDArray[np.intp]]:
    """Return the samples of a plane inside the footprints of each tile and of all its neighbours.

    This applies to sharp edges; edges with Fresnel diffraction are computed for each tile. The result has the
    form of :meth:`RayMap.row_spans` for each tile.

    Raises
    ------
    SamplingError
        If neighbouring footprints overlap too little.
    """
    # Width of the region, in Fresnel zones on the stop, within which tiles share one footprint if edges are
    # sharp. Where the object as a whole sends no light, the fields of its tiles cancel each other. Edges that
    # are finer than diffraction allows would disturb this cancellation.
    shared_zones = 2.5
    width = shared_zones * _zone_mm(scene, float(scene.system.vertex[0, scene.lens.stop_index, 2]))
    groups = [_group(scene.object_grid, tile, width) for tile in tiles]
    common: dict[tuple[int, ...], NDArray[np.intp]] = {}
    for group, carrier in zip(groups, carriers, strict=True):
        spans = carrier.row_spans(axes)
        if group in common:
            first = np.maximum(common[group][:, 0], spans[:, 0])
            spans = np.column_stack([first, np.maximum(np.minimum(common[group][:, 1], spans[:, 1]), first)])
        common[group] = spans
    # Least fraction of its footprint that a tile must share with its neighbours.
    least_shared = 0.7
    for group, carrier in zip(groups, carriers, strict=True):
        own, shared = (int(np.sum(s[:, 1] - s[:, 0])) for s in (carrier.row_spans(axes), common[group]))
        if shared < least_shared * own:
            raise SamplingError(
                f"plane z = {carrier.plane_z_mm:g} mm: neighbouring tiles illuminate different parts of it, "
                "since it lies near an image of the object; choose plane_z_mm nearer to the lens"
            )
    return [common[group] for group in groups]


def _group(grid: Grid, tile: Tile, width_mm: float) -> tuple[int, ...]:
    counts = [max(1, math.ceil(2.0 * half / width_mm)) for half in grid.half_widths_mm]
    middles = [0.5 * (part.start + part.stop) for part in tile.part]
    return tuple(int(m * c / n) for m, c, n in zip(middles, counts, grid.shape, strict=True))


def _zone_mm(scene: Scene, z_mm: float) -> float:
    """Return the radius of the first Fresnel zone of an object point on a plane."""
    return math.sqrt(1e-3 * scene.wavelength_um * (z_mm - scene.object_grid.z_mm))


def _sharp_edge_errors(scene: Scene, tile: Tile, carrier: RayMap) -> tuple[float, float]:
    """Return the relative errors of the field from a moving footprint, and from a sharp edge.

    Both follow from fractions of the evenly lit footprint near its rim: the strip by which the footprints of
    the tile's points differ from the centre's, and the first Fresnel zone between the lens and the plane.
    """
    distances = []
    for corner in ([o[end] for o in tile.offsets_mm] for end in (0, -1)):
        point = np.array(tile.centre_mm)
        point[1] += corner[0]
        if len(corner) == 2:
            point[0] += corner[1]
        points = np.broadcast_to(point, carrier.pupil.rim.shape)
        end = shoot(scene, points, carrier.pupil.rim, carrier.plane_z_mm, clip=False).position
        axes = [1] if carrier.pupil.is_line else [1, 0]
        distances.append(np.mean(np.linalg.norm(end[:, axes] - carrier.rim_mm, axis=1)))
    # Fraction of the displacement between the footprints of a tile's ends and of its centre that counts as
    # lost. The mean point of a tile is half as far away, and edges with diffraction differ by less than sharp
    # ones. The second value is measured.
    lost_strip = {"sharp": 0.5, "drawn": 0.2}
    strip = lost_strip["sharp" if carrier.edge is None else "drawn"] * float(np.nanmax(distances))
    apart = max(carrier.plane_z_mm - float(scene.system.vertex[0, 0, 2]), 0.0)
    zone = math.sqrt(1e-3 * scene.wavelength_um * apart)
    per_mm = rim_fraction_per_mm(carrier.rim_mm)
    return tuple(min(1.0, math.sqrt(per_mm * width)) for width in (strip, 0.1 * zone))  # type: ignore[return-value]


def _fresnel_edge_error(scene: Scene, tile: Tile, carrier: RayMap, sharp: float) -> float:
    """Return the relative error of an edge with Fresnel diffraction, from the error of a sharp edge.

    Light beyond the band of the object grid before the rim still has a sharp edge.
    """
    assert carrier.edge is not None
    resolved = carrier.edge.resolved_to(tile.width_mm)
    limit = 0.5e-3 * scene.wavelength_um / tile.pitch_mm
    cut = float(np.mean(np.any(np.abs(carrier.maps.at(carrier.rim_mm)[2:]) > limit, axis=0)))
    # Energy that diffraction moves beyond x = 1 from a sharp edge, as a fraction of all that it moves; beyond
    # x it is this fraction over x. The x is that of :mod:`wavesim.rays.edge_diffraction`.
    far_energy = 0.35
    unresolved = min(1.0, far_energy / resolved + cut)
    # Error of Fresnel's edge as a multiple of the squared error of a sharp edge: the next order in wavelength
    # over distance. Measured on twins of the paper's lens.
    second_order = 0.5
    return min(sharp, math.hypot(second_order * sharp**2, sharp * math.sqrt(unresolved)))


def rim_fraction_per_mm(rim_mm: Array) -> float:
    """Return the fraction of the footprint in a strip along its rim, per mm of the strip's width."""
    if rim_mm.shape[1] == 1:
        return 2.0 / float(np.ptp(rim_mm))
    y, x = rim_mm.T
    following = np.roll(rim_mm, -1, axis=0)
    area = 0.5 * abs(float(np.sum(y * following[:, 1] - x * following[:, 0])))
    return float(np.sum(np.linalg.norm(following - rim_mm, axis=1))) / area


def _x_per_square(carrier: RayMap) -> float:
    """Return the mean derivative of x with respect to the squared relative distance to the rim."""
    assert carrier.edge is not None
    return 0.5 * float(np.mean(carrier.edge.rate * carrier.pupil.reach))


def softness(carrier: RayMap) -> float:
    """Return the rise's width in the squared relative distance to the rim; 0 where it is unknown."""
    # Largest width of the rise in the squared relative distance to the rim; rays extend to 1.1.
    softest = 0.15
    return min(SOFT / _x_per_square(carrier), softest) if carrier.edge is not None else 0.0


def missed(width: float, shift: float) -> float:
    """Return the integral over x of the squared difference between a soft edge and F, shifted over a tile."""
    x = np.arange(-FARTHEST, FARTHEST, STEP)
    e = np.clip(0.5 + x / max(width, STEP), 0.0, 1.0)
    soft = e * e * (3.0 - 2.0 * e)
    points, weights = np.polynomial.legendre.leggauss(NODES)
    each = [np.sum(np.abs(fresnel_edge(x + shift * p) - soft) ** 2) for p in points]
    # Beyond, half of the mean of 1 / (pi x^2) to either side.
    return float(0.5 * STEP * (weights @ each) + 0.5 / (math.pi * FARTHEST))


def edge_illumination(scene: Scene, tiles: Sequence[Tile], plane_z_mm: float, light: Light) -> float:
    """Return the amplitude of an object's light at the aperture's rim, relative to an evenly filled aperture.

    The spectra are those of single tiles, since each tile has its own rim: light that the cut between tiles
    diffracts to the rim causes errors, too. The result is the root of the mean energy in a direction next to
    the rim, over the mean in all directions that the lens transmits. The brighter one of the rim's two sides
    counts. The result is 1 if the lens transmits no light.

    Parameters
    ----------
    scene, tiles
        Lens, and the tiles of its object.
    plane_z_mm
        z of a plane behind the lens that rays reach.
    light
        Light behind the object.
    """
    rims = _Rims(scene, tiles, plane_z_mm)
    found = np.zeros(3)
    for tile in tiles:
        values = light.field.values[tile.part]
        if np.any(values):
            found += _densities(values, tile, rims.of(tile), 1e-3 * scene.wavelength_um)
    *at_rim, transmitted = found
    if transmitted == 0.0:
        return 1.0
    return math.sqrt((1.0 - light.even) * max(at_rim) / transmitted + light.even)


class _Rims:
    """Direction cosines of the rim as a linear function of the object point, from some tiles far apart."""

    def __init__(self, scene: Scene, tiles: Sequence[Tile], plane_z_mm: float) -> None:
        centres = np.array([tile.centre_mm for tile in tiles])
        diagonal = centres @ [[1.0, 1.0], [1.0, -1.0]]
        ends = {*np.argmin(diagonal, axis=0).tolist(), *np.argmax(diagonal, axis=0).tolist(), len(tiles) // 2}
        self._middle = centres[len(tiles) // 2]
        found = [_rim_cosines(scene, tiles[i].centre_mm, plane_z_mm) for i in sorted(ends)]
        terms = self._terms(centres[sorted(ends)])
        flat = np.reshape(found, (len(found), -1))
        self._shape = found[0].shape
        self._slopes = np.linalg.lstsq(terms, flat)[0]

    def _terms(self, points_mm: Array) -> Array:
        return np.column_stack([np.ones(len(points_mm)), points_mm - self._middle])

    def of(self, tile: Tile) -> Array:
        """Return the rim's direction cosines for a tile's centre, shape (arms, d), in the order (y, x)."""
        return np.reshape(self._terms(np.array([tile.centre_mm])) @ self._slopes, self._shape)


def _rim_cosines(scene: Scene, point_mm: tuple[float, float], plane_z_mm: float) -> Array:
    pupil = open_pupil(scene, point_mm, plane_z_mm, RIM_ARMS)
    return trace_bundle(scene, np.asarray(point_mm), pupil.rim, plane_z_mm).cosines


def _densities(values: NDArray, tile: Tile, rim: Array, wavelength_mm: float) -> Array:
    """Return the mean energy in a direction: next to the rim outside and inside, and over the aperture."""
    middle = rim.mean(axis=0)
    radius = float(np.mean(np.linalg.norm(rim - middle, axis=1)))
    # Least number of bins of a spectrum over the aperture's radius.
    bins = 8.0
    least = math.ceil(bins * wavelength_mm / (tile.pitch_mm * radius))
    # A line has only two rim points to average over, and needs a finer spectrum.
    shape = [scipy.fft.next_fast_len(max((3 - values.ndim) * n, least)) for n in values.shape]
    energy = scipy.fft.fftshift(np.abs(scipy.fft.fftn(values, shape)) ** 2)
    axes = [wavelength_mm * scipy.fft.fftshift(scipy.fft.fftfreq(n, tile.pitch_mm)) for n in shape]
    resolved = wavelength_mm / (min(values.shape) * tile.pitch_mm)
    # Width of the rim, relative to the aperture's radius, unless a tile's light resolves directions less
    # finely. It is measured: predictions with this value bound the errors of all objects.
    rim_width = 0.05
    width = max(rim_width * radius, resolved)
    beyond, inside, within = (inside_border(moved(rim, by), axes) for by in (width, 0.0, -width))
    parts = (beyond & ~inside, inside & ~within, inside)
    return np.array([energy[part].mean() if part.any() else 0.0 for part in parts])
