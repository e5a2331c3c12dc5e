"""Stop points of the nominal lens's extreme rays, so that sampled extremes are the true ones.

Rings over the stop miss the steepest ray by up to a thousandth of its angle when that ray passes between
them. Merits of largest angles and distances therefore trace the extreme rays of the nominal lens as well: the
nominal score then equals what :func:`lensdesign.analysis.spread.largest_spread` finds. A perturbation moves
an extreme ray over the stop, which changes the extreme to second order only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.bundles import PupilSamples, launch_pairs, pupil_rings
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.rays import trace_compiled

START_RINGS, START_ARMS, STARTS, APART = 12, 48, 10, 0.15
"""Where searches of a stop point start: the largest of so many samples that lie so far from each other."""

FIRST_STEP, SHRINKING, ITERATIONS, GRID = 0.15, 0.4, 14, 7
"""Search of a stop point: half width of the first grid, its reduction, how often, points along each side."""

SAME_POINT = 1e-6
"""Stop points that are nearer to each other than this are one."""


def with_extreme_rays(
    lens: Lens,
    field_points_mm: Sequence[tuple[float, float]],
    stop: PupilSamples,
    wavelength_um: float,
    plane_distances_mm: Sequence[float],
) -> PupilSamples:
    """Add the stop points of extreme rays to samples of the stop, with weight 0.

    Extreme are, at each field point, the ray with the largest angle behind the lens and the rays that land
    farthest from the axis on each plane.

    Parameters
    ----------
    lens
        The nominal lens.
    field_points_mm
        Object points (x, y).
    stop
        Samples of the stop, as fractions of its semi-diameter.
    wavelength_um
        Vacuum wavelength.
    plane_distances_mm
        Planes, from the exit vertex.
    """
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
            found = [turned for point in by_height[key] for turned in _turned(point, field, height)]
        else:
            found = search.stop_points(field)
        for point in found:
            if np.min(np.linalg.norm(points - point, axis=1)) > SAME_POINT:
                points = np.concatenate([points, point[None]])
    return PupilSamples(points, np.append(stop.weights, np.zeros(len(points) - len(stop.points))))


def _turned(point: Array, field_mm: Array, height_mm: float) -> tuple[Array, Array]:
    """A stop point found for a field point on the y axis, and its mirror image, turned to a field point."""
    along = field_mm / height_mm if height_mm > 0.0 else np.array([0.0, 1.0])
    across = np.array([along[1], -along[0]])
    return point[1] * along + point[0] * across, point[1] * along - point[0] * across


class _ExtremeSearch:
    """Extreme rays of one lens at one wavelength."""

    def __init__(self, lens: Lens, wavelength_um: float, plane_distances_mm: Sequence[float]) -> None:
        self.lens, self.system = lens, compile_system(lens, wavelength_um)
        self.planes_mm = tuple(plane_distances_mm)

    def values(self, field_mm: Array, points: Array) -> Array:
        """Sine of the angle, and distance from the axis on each plane; shape (1 + planes, n)."""
        lens = self.lens
        origins, directions = launch_pairs(
            self.system,
            np.broadcast_to(field_mm, points.shape),
            points,
            lens.object_z_mm,
            lens.stop_index,
            lens.stop_semi_diameter_mm,
        )
        rays = trace_compiled(self.system, origins, directions, lens.exit_vertex_z_mm, threads=1)
        slopes = rays.direction[..., :2] / np.where(rays.ok, rays.direction[..., 2], 1.0)[..., None]
        across = [rays.direction[..., :2], *(rays.position[..., :2] + z * slopes for z in self.planes_mm)]
        found = np.hypot(*np.moveaxis(np.stack(across), -1, 0))
        return np.where(rays.ok, found, -np.inf)

    def stop_points(self, field_mm: Array) -> list[Array]:
        """Stop point of each extreme ray of a field point; none where no ray passes."""
        samples = pupil_rings(START_RINGS, START_ARMS, edge=True).points
        found = []
        for which, values in enumerate(self.values(field_mm, samples)):
            ends = [self._climbed(field_mm, which, start) for start in _starts(samples, values)]
            if ends:
                found.append(max(ends, key=lambda end: end[0])[1])
        return found

    def _climbed(self, field_mm: Array, which: int, point: Array) -> tuple[float, Array]:
        """The largest value near a stop point and where it is, by grids that shrink around the best."""
        steps = np.linspace(-1.0, 1.0, GRID)
        offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        half_width = FIRST_STEP
        for _ in range(ITERATIONS):
            points = point + half_width * offsets
            radii = np.linalg.norm(points, axis=1)
            points /= np.maximum(radii, 1.0)[:, None]
            values = self.values(field_mm, points)[which]
            best = int(np.argmax(values))
            value, point = float(values[best]), points[best]
            half_width *= SHRINKING
        return value, point


def _starts(samples: Array, values: Array) -> list[Array]:
    """The samples of the largest values, each some distance from the others; none where all are missing."""
    chosen: list[Array] = []
    for index in np.argsort(-values):
        near = any(np.linalg.norm(samples[index] - other) < APART for other in chosen)
        if len(chosen) == STARTS or not np.isfinite(values[index]):
            break
        if not near:
            chosen.append(samples[index])
    return chosen
