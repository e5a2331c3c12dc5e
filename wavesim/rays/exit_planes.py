"""Plane behind a lens, free of folds, on which rays carry a field, with free space behind it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.fields.field import Grid
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.rays.maps import check_no_fold, sample_points
from wavesim.rays.ray_bundles import FoldError, RayBundle, open_pupil, trace_bundle
from wavesim.scene.scene import Scene

FINENESS, ZONES = 0.85, 6.0

Samples = list[tuple[tuple[float, float], Array]]
"""Object points (x, y) with stop points that are open to each, shape (n, 2)."""


@dataclass(frozen=True)
class ExitPlane:
    """Plane on which the tiles' fields are summed, and its propagator to the exit grid.

    Attributes
    ----------
    grid : Grid
        Samples of the plane; the exit grid itself where `beyond` is None.
    beyond : FreeSpacePropagator or None
        Free space from there to the exit grid.
    """

    grid: Grid
    beyond: FreeSpacePropagator | None


def exit_plane(scene: Scene, plane_z_mm: float | None) -> ExitPlane:
    """Return the given plane, or choose one.

    Raises
    ------
    FoldError
        If rays fold on the plane asked for, or on every plane.
    """
    target = scene.exit_grid
    # The open part of the stop is the same for every plane behind the lens.
    samples = _samples(scene, target.z_mm if plane_z_mm is None else plane_z_mm)
    if plane_z_mm is None:
        plane_z_mm = _chosen_z_mm(scene, samples)
    bundles = _bundles(scene, samples, plane_z_mm)
    for point, bundle in bundles:
        check_no_fold(bundle, point, plane_z_mm)
    if plane_z_mm == target.z_mm:
        return ExitPlane(target, None)
    grid = _covering_grid(scene, plane_z_mm, [bundle for _, bundle in bundles])
    index = float(scene.system.index[0, -1])
    return ExitPlane(grid, FreeSpacePropagator(grid, target, scene.wavelength_um, index))


def _chosen_z_mm(scene: Scene, samples: Samples) -> float:
    """Return the exit grid's plane, or the plane farthest from folds if a caustic lies in front of it."""
    last = scene.exit_grid.z_mm
    first = scene.lens.exit_vertex_z_mm
    here = _quality(scene, samples, last)
    # Smallest cross-section of a ray tube, relative to that at the exit vertex.
    narrowest = 0.6
    if last == first or (here.narrowing >= narrowest and here.caustics == 0):
        return last
    # Candidate planes between exit vertex and exit grid, where rays fold on the exit grid.
    candidates = 33
    planes = [float(z) for z in np.linspace(first, last, candidates)[:-1]]
    found = [_quality(scene, samples, z) for z in planes]
    best = max(range(len(planes)), key=lambda i: found[i].evenness)
    if max(found[best].evenness, here.evenness) <= 0.0:
        raise FoldError(
            f"the rays fold on every plane from the exit vertex, z = {planes[0]:g} mm, to the exit grid, "
            f"z = {last:g} mm: stop the lens down, or use another engine"
        )
    return planes[best] if found[best].evenness > 0.0 else last


@dataclass(frozen=True)
class _Quality:
    """Return the distance of rays from a fold on a plane.

    Attributes
    ----------
    evenness : float
        Least over largest determinant of the map from stop to plane; 0 where it folds.
    narrowing : float
        Smallest cross-section of a ray tube, relative to the exit vertex; 0 where the map folds.
    caustics : int
        Most that light has touched.
    """

    evenness: float
    narrowing: float
    caustics: int


def _quality(scene: Scene, samples: Samples, plane_z_mm: float) -> _Quality:
    evenness, narrowing, most = 1.0, np.inf, 0
    apart = plane_z_mm - scene.lens.exit_vertex_z_mm
    for point, bundle in _bundles(scene, samples, plane_z_mm):
        try:
            most = max(most, check_no_fold(bundle, point, plane_z_mm))
        except FoldError:
            return _Quality(0.0, 0.0, most)
        size = np.abs(bundle.determinant[bundle.ok])
        before = np.abs(np.linalg.det(bundle.jacobian_before(apart)))[bundle.ok]
        evenness = min(evenness, float(size.min() / size.max()))
        narrowing = min(narrowing, float(np.min(size / np.maximum(before, 1e-300))))
    return _Quality(evenness, narrowing, most)


def _samples(scene: Scene, plane_z_mm: float) -> Samples:
    """Return the centre and the corners of the object grid, with stop points that are open to each."""
    grid = scene.object_grid
    ends = [(a[0], a[-1]) for a in (grid.x_mm, grid.y_mm)]
    points = {grid.centre_mm} | {(float(x), float(y)) for x in ends[0] for y in ends[1]}
    sample_order = {True: 64, False: 16}
    order = sample_order[grid.is_line]
    return [(p, sample_points(open_pupil(scene, p, plane_z_mm), order)) for p in sorted(points)]


def _bundles(
    scene: Scene, samples: Samples, plane_z_mm: float
) -> list[tuple[tuple[float, float], RayBundle]]:
    """Trace the sampled rays."""
    return [(p, trace_bundle(scene, np.asarray(p), stop, plane_z_mm)) for p, stop in samples]


def _covering_grid(scene: Scene, plane_z_mm: float, bundles: list[RayBundle]) -> Grid:
    """Return the samples that contain all of the light on the plane."""
    ends = np.concatenate([b.sensor_mm[b.ok] for b in bundles])
    sine = max(float(np.abs(b.slopes[b.ok]).max()) for b in bundles)
    wavelength_mm = 1e-3 * scene.wavelength_um
    apart = abs(scene.exit_grid.z_mm - plane_z_mm)
    zone = math.sqrt(wavelength_mm / max(apart, wavelength_mm))
    pitch = FINENESS * 0.5 * wavelength_mm / (sine + zone)
    low, high = ends.min(axis=0), ends.max(axis=0)
    room = ZONES * pitch
    shape = tuple(math.ceil((h - b + 2.0 * room) / pitch) for b, h in zip(low, high, strict=True))
    middle = 0.5 * (low + high)
    centre = (0.0 if len(shape) == 1 else float(middle[1]), float(middle[0]))
    return Grid(shape, pitch, plane_z_mm, centre)
