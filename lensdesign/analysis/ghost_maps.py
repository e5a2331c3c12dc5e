"""Irradiance of ghosts on a recording plane, as maps that rays fill.

A map holds smooth light: the mean over interference fringes with the direct light. It is accurate to the
noise of its rays, some percent in a cell, and does not resolve the image of a point where a ghost is focused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from lensdesign.analysis.double_reflections import on_sensor, reflecting_pairs, sensor_system
from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.raytrace.bundles import directions_of, largest_cosine
from lensdesign.raytrace.ghosts import ghost_system
from lensdesign.raytrace.polarization import jones_matrices
from lensdesign.raytrace.rays import trace_compiled


@dataclass(frozen=True, eq=False)
class GhostMap:
    """Light of one ghost on a part of a recording plane.

    Attributes
    ----------
    first, second : str
        Surfaces in the order in which they reflect; see
        :class:`lensdesign.analysis.double_reflections.GhostPath`.
    fractions : ndarray, shape (cells, cells)
        Power in every cell as a fraction of that of the direct light on the whole plane; y increases with the
        row, x with the column.
    """

    first: str
    second: str
    fractions: Array

    @property
    def power(self) -> float:
        """Power in the map as a fraction of that of the direct light."""
        return float(self.fractions.sum())


def ghost_maps(
    lens: Lens,
    points_mm: Array,
    weights: Array,
    plane_distance_mm: float,
    size_mm: tuple[float, float],
    *,
    wavelength_um: float | None = None,
    cells: int = 48,
    rays: int = 100_000,
    only_beyond_lens: bool = False,
    seed: int = 0,
    object_z_mm: float | None = None,
    pose: Pose = Pose(),
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
    sensor_pose: Pose = Pose(),
) -> tuple[GhostMap, ...]:
    """Trace the light of object points along all paths with two reflections, and collect it in cells.

    Parameters
    ----------
    lens
        The nominal lens with its coatings; ideal ones reflect nothing.
    points_mm, weights
        Object points (x, y), shape (n, 2), and their powers. They radiate evenly over all direction cosines.
    plane_distance_mm
        Distance of the recording plane from the exit vertex.
    size_mm
        Width and height of the part of the plane, about the axis.
    wavelength_um
        Vacuum wavelength (default: the first of the design).
    cells
        Number of cells along each side.
    rays
        Number of rays that are launched.
    only_beyond_lens
        Whether to omit paths between two surfaces of the lens itself.
    seed
        Seed of the rays.
    object_z_mm
        z of the object points (default: that of the design).
    pose, surface_perturbations, sensor_pose
        Deviations of the lens and of the sensor; see
        :func:`lensdesign.analysis.double_reflections.ghost_paths`. Cells move with the sensor.

    Returns
    -------
    tuple of GhostMap
        Maps of the paths that reach the plane.

    Raises
    ------
    InputError
        If no ray passes the lens, or a coating's table ends before the angles of the rays.

    Examples
    --------
    >>> import numpy as np
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml").with_coating("bare")
    >>> (found,) = ghost_maps(lens, np.zeros((1, 2)), np.ones(1), 2.0, lens.sensor.size_mm, rays=4000)
    >>> found.first, found.second, 0.005 < found.power < 0.02
    ('surface 2', 'surface 1', True)
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    system, names = sensor_system(
        lens, wavelength, plane_distance_mm, pose, surface_perturbations, sensor_pose
    )
    random = np.random.default_rng(seed)
    chosen = random.choice(len(points_mm), rays, p=np.asarray(weights) / np.sum(weights))
    radius, angle = largest_cosine(lens) * np.sqrt(random.random(rays)), 2.0 * np.pi * random.random(rays)
    directions = directions_of(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))
    z_mm = lens.object_z_mm if object_z_mm is None else object_z_mm
    origins = np.column_stack([np.asarray(points_mm)[chosen], np.full(rays, z_mm)])
    direct = trace_compiled(system, origins, directions, record_hits=True)
    if not np.any(direct.ok):
        raise InputError("no ray of the object points passes the lens: there is no light for a ghost")
    passed = direct.ok
    origins, directions, direct = origins[passed], directions[passed], direct.selected(passed)
    total = float(np.sum(jones_matrices(system, origins, direct).transmittance))
    if total == 0.0:
        raise InputError("the coatings transmit no light")
    first_back = len(lens.surfaces) if only_beyond_lens else 1
    ends = [0.5 * np.array([-side, side]) for side in reversed(size_mm)]
    found = []
    for front, back in reflecting_pairs(lens, names, first_back):
        if system.coatings[front].is_ideal or system.coatings[back].is_ideal:
            continue
        ghost = ghost_system(system, front, back)
        arrived = trace_compiled(ghost, origins, directions, record_hits=True)
        power = np.nan_to_num(jones_matrices(ghost, origins, arrived).transmittance) * arrived.ok
        x, y, _ = on_sensor(system, arrived).T
        cells_of_power, _, _ = np.histogram2d(y, x, cells, range=ends, weights=power)
        smooth = _smoothed(cells_of_power)
        if smooth.sum() > 0.0:
            found.append(GhostMap(names[back], names[front], smooth / total))
    return tuple(found)


def sum_on_pixels(maps: Sequence[GhostMap], shape: tuple[int, int]) -> Array:
    """Return the sum of maps on pixels, bilinearly interpolated; its sum is the power of all maps.

    Parameters
    ----------
    maps
        Maps of equal size; with none of them, the result is 0.
    shape
        Rows and columns of the pixels that cover the same part of the plane.
    """
    if not maps:
        return np.zeros(shape)
    total = sum((one.fractions for one in maps), np.zeros_like(maps[0].fractions))
    rows, columns = (
        np.clip((np.arange(count) + 0.5) / count * cells - 0.5, 0.0, cells - 1.0)
        for count, cells in zip(shape, total.shape, strict=True)
    )
    along = np.array([np.interp(columns, np.arange(total.shape[1]), row) for row in total])
    low = np.minimum(rows.astype(int), total.shape[0] - 2)
    part = (rows - low)[:, None]
    values = (1.0 - part) * along[low] + part * along[low + 1]
    size = float(values.sum())
    return np.asarray(values * (float(total.sum()) / size if size > 0.0 else 0.0))


def _smoothed(values: Array) -> Array:
    """Return cells smoothed over one cell, with the same total, to reduce the noise of rays."""
    smooth = gaussian_filter(values, 1.0, mode="nearest")
    total = float(smooth.sum())
    return np.asarray(smooth * (float(values.sum()) / total if total > 0.0 else 0.0))
