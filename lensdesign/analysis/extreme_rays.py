"""Stop points of the extreme rays of the nominal lens, which make sampled extremes exact.

Rings over the stop underestimate the largest angle by up to a thousandth if the steepest ray passes between
them. Merits of largest angles and distances therefore also trace the extreme rays of the nominal lens. The
nominal value then equals that of :func:`lensdesign.analysis.exit_beam.largest_spread_angle`. A perturbation
moves an extreme ray over the stop, which changes the extreme to second order only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.bundles import PupilSamples, launch_pairs, pupil_rings
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.rays import trace_compiled


def with_extreme_rays(
    lens: Lens,
    field_points_mm: Sequence[tuple[float, float]],
    stop: PupilSamples,
    wavelength_um: float,
    plane_distances_mm: Sequence[float],
) -> PupilSamples:
    """Return samples of the stop with the stop points of extreme rays added, with weight 0.

    The extreme rays of a field point are the ray with the largest angle behind the lens and, for each plane,
    the ray that lands farthest from the axis.

    Parameters
    ----------
    lens
        The nominal lens.
    field_points_mm
        Object points (x, y).
    stop
        Samples of the stop, relative to its semi-diameter.
    wavelength_um
        Vacuum wavelength.
    plane_distances_mm
        Distances of planes from the exit vertex.
    """
    smallest_distance = 1e-6  # a stop point that is nearer to another one is not added
    search = _ExtremeSearch(lens, wavelength_um, plane_distances_mm)
    symmetric = all(surface.shape.ROTATIONAL for surface in lens.surfaces)
    by_height: dict[float, list[Array]] = {}
    points = stop.points
    for field in np.array(field_points_mm, float).reshape(-1, 2):
        if symmetric:
            height = float(np.hypot(*field))
            key = round(height, 9)
            if key not in by_height:
                by_height[key] = search.stop_points(np.array([0.0, height]))
            found = [rotated for point in by_height[key] for rotated in _rotated(point, field, height)]
        else:
            found = search.stop_points(field)
        for point in found:
            if np.min(np.linalg.norm(points - point, axis=1)) > smallest_distance:
                points = np.concatenate([points, point[None]])
    return PupilSamples(points, np.append(stop.weights, np.zeros(len(points) - len(stop.points))))


def _rotated(point: Array, field_mm: Array, height_mm: float) -> tuple[Array, Array]:
    """Rotate a stop point of a field point on the y axis to another azimuth; also return its mirror image."""
    along = field_mm / height_mm if height_mm > 0.0 else np.array([0.0, 1.0])
    across = np.array([along[1], -along[0]])
    return point[1] * along + point[0] * across, point[1] * along - point[0] * across


class _ExtremeSearch:
    """Extreme rays of one lens at one wavelength."""

    def __init__(self, lens: Lens, wavelength_um: float, plane_distances_mm: Sequence[float]) -> None:
        self.lens, self.system = lens, compile_system(lens, wavelength_um)
        self.planes_mm = tuple(plane_distances_mm)

    def values(self, field_mm: Array, points: Array) -> Array:
        """Return the sine of the angle and the distances from the axis on the planes, (1 + planes, n)."""
        lens = self.lens
        origins, directions = launch_pairs(
            self.system,
            np.broadcast_to(field_mm, points.shape),
            points,
            lens.object_z_mm,
            lens.stop_index,
            lens.stop_semi_diameter_mm,
        )
        in_air, plate = self.system.without_cover_glass(), self.system.cover_glass
        rays = trace_compiled(in_air, origins, directions, lens.exit_vertex_z_mm, threads=1)
        cosines = np.where(rays.ok[..., None], rays.direction[..., :2], 0.0)
        shift = 0.0 if plate is None else plate.lateral_shift_mm(cosines)
        slopes = rays.direction[..., :2] / np.where(rays.ok, rays.direction[..., 2], 1.0)[..., None]
        behind = rays.position[..., :2] + shift
        across = [rays.direction[..., :2], *(behind + z * slopes for z in self.planes_mm)]
        found = np.hypot(*np.moveaxis(np.stack(across), -1, 0))
        return np.where(rays.ok, found, -np.inf)

    def stop_points(self, field_mm: Array) -> list[Array]:
        """Return the stop point of each extreme ray of a field point; none where no ray passes."""
        samples = pupil_rings(rings=12, arms=48, edge=True).points
        values = self.values(field_mm, samples)
        starts = [(quantity, start) for quantity, own in enumerate(values) for start in _starts(samples, own)]
        if not starts:
            return []
        quantities = np.array([quantity for quantity, _ in starts])
        largest, ends = self._maximize(field_mm, quantities, np.stack([start for _, start in starts]))
        groups = [np.flatnonzero(quantities == quantity) for quantity in np.unique(quantities)]
        return [ends[rows[np.argmax(largest[rows])]] for rows in groups]

    def _maximize(self, field_mm: Array, quantities: Array, points: Array) -> tuple[Array, Array]:
        """Return the largest value near each stop point and its position, by shrinking grids."""
        steps = np.linspace(-1.0, 1.0, 7)
        offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        rows, half_width = np.arange(len(points)), 0.15
        for _ in range(14):
            grids = points[:, None] + half_width * offsets
            radii = np.linalg.norm(grids, axis=-1)
            grids /= np.maximum(radii, 1.0)[..., None]
            values = self.values(field_mm, grids.reshape(-1, 2)).reshape(-1, *grids.shape[:2])
            values = values[quantities, rows]
            best = np.argmax(values, axis=1)
            largest, points = values[rows, best], grids[rows, best]
            half_width *= 0.4
        return largest, points


def _starts(samples: Array, values: Array) -> list[Array]:
    """Return up to 10 samples of the largest values that are at least 0.15 apart; none without rays."""
    chosen: list[Array] = []
    for index in np.argsort(-values):
        near = any(np.linalg.norm(samples[index] - other) < 0.15 for other in chosen)
        if len(chosen) == 10 or not np.isfinite(values[index]):
            break
        if not near:
            chosen.append(samples[index])
    return chosen
