"""The first iterations of a large object: on half of its samples, through the lens stopped down.

Light of low angles needs fewer samples, goes through less of the lens and falls on fewer pixels: an iteration
takes less than half of the time. Pixels that light of higher angles reaches as well tell nothing there. What
comes out is where iterations on all samples begin: what they find late are the coarse parts of an object.
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

ITERATIONS, ROUNDS = 4, 2
"""On half of the samples, and rounds behind the lens in each; more of them win nothing on all."""

BAND_SHARE = 0.9
"""Of the angles that half of the samples hold, what the lens may pass."""

LEAST, MOST = 0.35, 0.8
"""Share of the aperture: with less, little is begun, with more, little is saved."""

ARMS, POINTS = 72, 8
"""Rays along the rim of a footprint, and object points about the light."""

LIT = 1e-3
"""Of the brightest amplitude, from which on an object sample counts as lit."""


class CoarseProblem(NamedTuple):
    """A smaller problem: from half of the object's samples to the middle of the pixels."""

    scene: Scene
    light: Field
    recorded: list[Measurement]


def coarse_problem(scene: Scene, light: Field, recorded: Sequence[Measurement]) -> CoarseProblem | None:
    """What light of low angles tells of an object; None where that saves little.

    Parameters
    ----------
    scene
        From the object to the first plane.
    light
        On the object's samples, field stop included.
    recorded
        Planes, with `sigma`.
    """
    own, grid = scene.object_grid, scene.exit_grid
    aperture = scene.lens.object.numerical_aperture
    held = BAND_SHARE * 0.25e-3 * scene.wavelength_um / own.pitch_mm
    if own.is_line or not LEAST < held / aperture < MOST:
        return None
    half = _half(light)
    narrow = replace(scene, lens=stopped_down(scene.lens, held), object_grid=half.grid)
    points = _about(light)
    rims = [[_rim(narrow, point, plane) for point in points] for plane in recorded]
    margin_mm = math.sqrt(1e-3 * scene.wavelength_um * abs(grid.z_mm))
    reached = np.concatenate([rim for plane in rims for rim in plane])
    rows, columns = (
        _window(axis, low - margin_mm, high + margin_mm)
        for axis, low, high in zip(
            (grid.y_mm, grid.x_mm), reached.min(axis=0), reached.max(axis=0), strict=True
        )
    )
    y, x = grid.y_mm[rows], grid.x_mm[columns]
    window = Grid((len(y), len(x)), grid.pitch_mm, grid.z_mm, (0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1])))
    cut = [
        _told(plane, rim, (y, x), (rows, columns), margin_mm)
        for plane, rim in zip(recorded, rims, strict=True)
    ]
    known = [plane for plane in cut if plane.sigma is not None and np.isfinite(plane.sigma).any()]
    return CoarseProblem(replace(narrow, exit_grid=window), half, known) if known else None


def _window(axis: Array, low: float, high: float) -> slice:
    """Samples between two places, and some more for the sake of Fourier transforms."""
    start, stop = (int(place) for place in np.searchsorted(axis, [low, high]))
    count = min(scipy.fft.next_fast_len(max(stop - start, 1)), len(axis))
    start = min(max(start - (count - stop + start) // 2, 0), len(axis) - count)
    return slice(start, start + count)


def _half(light: Field) -> Field:
    """The light on half of the samples along each side, each of which stands for two."""
    grid = light.grid
    count = [2 * (n // 2) for n in grid.shape]
    values = light.values[: count[0], : count[1]]
    blocks = values.reshape(count[0] // 2, 2, count[1] // 2, 2)
    y, x = (0.5 * (axis[0] + axis[n - 1]) for axis, n in zip((grid.y_mm, grid.x_mm), count, strict=True))
    half = Grid((count[0] // 2, count[1] // 2), 2.0 * grid.pitch_mm, grid.z_mm, (float(x), float(y)))
    return Field(half, blocks.mean(axis=(1, 3)).astype(values.dtype), light.wavelength_um)


def on_all_samples(values: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Values on half of the samples, linearly in between; beyond the last, as that."""
    result = values
    for axis, count in enumerate(shape):
        last = len(result) - 1 if axis == 0 else result.shape[1] - 1
        place = np.clip(0.5 * np.arange(count) - 0.25, 0.0, last)
        low = np.minimum(place.astype(int), max(last - 1, 0))
        part = (place - low).astype(values.real.dtype)
        part = part[:, None] if axis == 0 else part
        result = (1 - part) * result.take(low, axis) + part * result.take(np.minimum(low + 1, last), axis)
    return result


def _about(light: Field) -> list[tuple[float, float]]:
    """Points (x, y) whose polygon holds all but the outermost of what is lit."""
    size = np.abs(light.values)
    lit = size > LIT * size.max(initial=0.0)
    rows, grid = np.flatnonzero(lit.any(axis=1)), light.grid
    ends = [lit[rows].argmax(axis=1), lit.shape[1] - 1 - lit[rows, ::-1].argmax(axis=1)]
    points = np.concatenate([np.column_stack([grid.x_mm[end], grid.y_mm[rows]]) for end in ends])
    turn = 2.0 * np.pi * np.arange(POINTS) / POINTS
    farthest = np.argmax(points @ np.stack([np.cos(turn), np.sin(turn)]), axis=0)
    return [(float(x), float(y)) for x, y in points[farthest]]


def _rim(scene: Scene, point_mm: tuple[float, float], plane: Measurement) -> Array:
    """Where an object point's light ends on a plane, (y, x) of the pixels' grid."""
    z_mm = scene.exit_grid.z_mm + plane.distance_mm
    rim = border_of(scene, point_mm, open_pupil(scene, point_mm, z_mm, ARMS), z_mm)
    return np.asarray(rim - np.array(plane.shift_mm)[::-1])


def _told(
    plane: Measurement,
    rims: Sequence[Array],
    axes: tuple[Array, Array],
    window: tuple[slice, slice],
    margin_mm: float,
) -> Measurement:
    """A plane's window; only pixels that no light of higher angles reaches tell anything."""
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
