"""First iterations of a large object: on half of its samples along each side, through the lens stopped down.

Light at small angles needs fewer samples, uses less of the lens and reaches fewer pixels. An iteration
therefore takes less than half of the time. Pixels that light at larger angles also reaches are ignored. The
result is the start of the iterations on all samples, which would find the coarse parts of an object last.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.scaling import stopped_down
from wavesim.fields.field import Field, Grid
from wavesim.rays.maps import border_of, moved, row_spans
from wavesim.rays.ray_bundles import open_pupil
from wavesim.scene.scene import Scene
from wavesim.sensor.measurement import Measurement

ITERATIONS, INNER_ITERATIONS = 4, 2
"""Iterations on half of the samples, and inner iterations of each. More of them do not improve the start."""

LEAST_APERTURE, LARGEST_APERTURE = 0.35, 0.8
"""Range of the reduced aperture over that of the lens. Below it little is found, above it little time is
saved.
"""

ARMS, POINTS = 72, 8
"""Number of rays along the rim of a footprint, and of object points around the light."""


class CoarseProblem(NamedTuple):
    """A smaller problem: half of the object's samples along each side, and pixels near the middle of the
    sensor.
    """

    scene: Scene
    light: Field
    recorded: list[Measurement]


def coarse_problem(scene: Scene, light: Field, recorded: Sequence[Measurement]) -> CoarseProblem | None:
    """Return the problem for light at small angles, or None where that would save little time.

    Parameters
    ----------
    scene
        Scene from the object to the first plane.
    light
        Field on the object's samples, with the field stop applied.
    recorded
        Measured planes with `sigma`.
    """
    object_grid, grid = scene.object_grid, scene.exit_grid
    aperture = scene.lens.object.numerical_aperture
    # Numerical aperture of the lens over the largest that half of the samples can represent.
    band_fraction = 0.9
    passed_aperture = band_fraction * 0.25e-3 * scene.wavelength_um / object_grid.pitch_mm
    if object_grid.is_line or not LEAST_APERTURE < passed_aperture / aperture < LARGEST_APERTURE:
        return None
    half = _on_half_samples(light)
    narrow = replace(scene, lens=stopped_down(scene.lens, passed_aperture), object_grid=half.grid)
    points = _points_around(light)
    rims = [[_rim(narrow, point, plane) for point in points] for plane in recorded]
    margin_mm = math.sqrt(1e-3 * scene.wavelength_um * abs(grid.z_mm))
    border = np.concatenate([rim for plane in rims for rim in plane])
    rows, columns = (
        _window(axis, low - margin_mm, high + margin_mm)
        for axis, low, high in zip(
            (grid.y_mm, grid.x_mm), border.min(axis=0), border.max(axis=0), strict=True
        )
    )
    y, x = grid.y_mm[rows], grid.x_mm[columns]
    window = Grid((len(y), len(x)), grid.pitch_mm, grid.z_mm, (0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1])))
    planes = [
        _windowed_plane(plane, rim, (y, x), (rows, columns), margin_mm)
        for plane, rim in zip(recorded, rims, strict=True)
    ]
    known = [plane for plane in planes if plane.sigma is not None and np.isfinite(plane.sigma).any()]
    return CoarseProblem(replace(narrow, exit_grid=window), half, known) if known else None


def _window(axis: Array, low: float, high: float) -> slice:
    """Return a slice between two positions, enlarged to a length that suits Fourier transforms."""
    start, stop = (int(position) for position in np.searchsorted(axis, [low, high]))
    count = min(scipy.fft.next_fast_len(max(stop - start, 1)), len(axis))
    start = min(max(start - (count - stop + start) // 2, 0), len(axis) - count)
    return slice(start, start + count)


def _on_half_samples(light: Field) -> Field:
    """Return the light on half of the samples along each side, as means over 2 x 2 samples."""
    grid = light.grid
    count = [2 * (n // 2) for n in grid.shape]
    values = light.values[: count[0], : count[1]]
    blocks = values.reshape(count[0] // 2, 2, count[1] // 2, 2)
    y, x = (0.5 * (axis[0] + axis[n - 1]) for axis, n in zip((grid.y_mm, grid.x_mm), count, strict=True))
    half = Grid((count[0] // 2, count[1] // 2), 2.0 * grid.pitch_mm, grid.z_mm, (float(x), float(y)))
    return Field(half, blocks.mean(axis=(1, 3)).astype(values.dtype), light.wavelength_um)


def on_all_samples(values: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Interpolate values on half of the samples linearly to all samples; they are constant beyond the
    last.
    """
    result = values
    for axis, count in enumerate(shape):
        last = len(result) - 1 if axis == 0 else result.shape[1] - 1
        position = np.clip(0.5 * np.arange(count) - 0.25, 0.0, last)
        low = np.minimum(position.astype(int), max(last - 1, 0))
        fraction = (position - low).astype(values.real.dtype)
        fraction = fraction[:, None] if axis == 0 else fraction
        result = (1 - fraction) * result.take(low, axis) + fraction * result.take(
            np.minimum(low + 1, last), axis
        )
    return result


def _points_around(light: Field) -> list[tuple[float, float]]:
    """Return points (x, y) whose polygon contains nearly all of the lit area."""
    size = np.abs(light.values)
    # Fraction of the peak amplitude above which an object sample counts as lit.
    lit_fraction = 1e-3
    lit = size > lit_fraction * size.max(initial=0.0)
    rows, grid = np.flatnonzero(lit.any(axis=1)), light.grid
    ends = [lit[rows].argmax(axis=1), lit.shape[1] - 1 - lit[rows, ::-1].argmax(axis=1)]
    points = np.concatenate([np.column_stack([grid.x_mm[end], grid.y_mm[rows]]) for end in ends])
    angle = 2.0 * np.pi * np.arange(POINTS) / POINTS
    farthest = np.argmax(points @ np.stack([np.cos(angle), np.sin(angle)]), axis=0)
    return [(float(x), float(y)) for x, y in points[farthest]]


def _rim(scene: Scene, point_mm: tuple[float, float], plane: Measurement) -> Array:
    """Return the border of an object point's light on a plane, as (y, x) on the pixels' grid."""
    z_mm = scene.exit_grid.z_mm + plane.distance_mm
    rim = border_of(scene, point_mm, open_pupil(scene, point_mm, z_mm, ARMS), z_mm)
    return np.asarray(rim - np.array(plane.shift_mm)[::-1])


def _windowed_plane(
    plane: Measurement,
    rims: Sequence[Array],
    axes: tuple[Array, Array],
    window: tuple[slice, slice],
    margin_mm: float,
) -> Measurement:
    """Return a plane's window, with infinite sigma in pixels that light at larger angles reaches."""
    inner = [moved(rim, -margin_mm) for rim in rims]
    spans = np.stack([row_spans(rim, axes) for rim in inner])
    first, end = spans[:, :, 0].max(axis=0)[:, None], spans[:, :, 1].min(axis=0)[:, None]
    column = np.arange(len(axes[1]))
    assert plane.sigma is not None
    sigma = np.where((column >= first) & (column < end), plane.sigma[window], np.inf)
    return replace(
        plane,
        amplitude=np.ascontiguousarray(plane.amplitude[window]),
        sigma=sigma.astype(plane.sigma.dtype, copy=False),
        background=None if plane.background is None else np.ascontiguousarray(plane.background[window]),
    )
