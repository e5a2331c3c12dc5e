"""The light behind an unknown object, as far as its frames tell it: how much of it goes to the rim."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.fields.field import Field
from wavesim.rays.maps import RIM_ARMS, inside_border, moved
from wavesim.rays.ray_bundles import open_pupil, trace_bundle
from wavesim.scene.light import Light
from wavesim.scene.scene import Scene
from wavesim.sensor.exposures import electrons_of
from wavesim.sensor.frame_sets import frames_by_plane
from wavesim.sensor.frames import Frame

RING = 0.1
"""Of the footprint's radius: pixels so near to its border, inside, show the light at the rim."""

SURE = 2.0
"""Standard deviations of the mean over such pixels by which it may be larger."""

MOST_FAULTY, FAULTY_FRACTION = 4, 0.002
"""Number of pixels that may be faulty, and besides these the fraction of the pixels on the ring."""

ROWS = 64


def light_of_frames(scene: Scene, frames: Sequence[Frame], illumination: Field) -> Light:
    """The illumination, and scattered light: as much as brings to the rim what frames show there.

    On the nearest plane light lies by its direction. What pixels next to the footprint's border hold is taken
    for light that fills the aperture evenly; where none lie there, all light is.

    Parameters
    ----------
    scene
        From the object to the pixels of the nearest plane, one sample for each.
    frames
        Of one plane or more.
    illumination
        On the object grid of the scene.
    """
    middle = scene.object_grid.centre_mm
    pupil = open_pupil(scene, middle, scene.exit_grid.z_mm, RIM_ARMS)
    rim = trace_bundle(scene, np.asarray(middle), pupil.rim, scene.exit_grid.z_mm)
    plane = sorted(frames_by_plane(frames)[0], key=lambda frame: frame.settings.exposure)
    read = [_of_footprint(frame, scene, rim.sensor_mm) for frame in plane]
    clear = [ring for _, ring in read if ring.is_clear] or [read[0][1]]
    total, ring = read[0][0], clear[-1]
    if ring.pixels == 0 or total <= 0.0:
        return Light(illumination, 1.0)
    lit = np.isfinite(rim.amplitude)
    # Of even light, one unit in each direction: on the border's pixels, and in all.
    border = float(np.mean(rim.amplitude[lit] ** 2)) * scene.exit_grid.cell
    return Light(illumination, min(max(ring.most / border * _area(rim.cosines) / total, 0.0), 1.0))


@dataclass(frozen=True)
class _Ring:
    """Light of the pixels next to the border.

    Attributes
    ----------
    pixels : int
        Number of pixels.
    most : float
        Mean light of a pixel, as large as it may well be.
    is_clear : bool
        Whether no more pixels are clipped than may be faulty.
    """

    pixels: int
    most: float
    is_clear: bool


def _ring_of(light: Array, clipped: int) -> _Ring:
    """The mean over pixels, of which a few may hold anything.

    Faulty pixels, hits of cosmic rays or damaged bytes would otherwise pass for light at the rim. The
    brightest pixels count as the brightest one behind them (a winsorized mean). Light that is spread over
    more pixels loses next to nothing by that.
    """
    count = len(light)
    faulty = min(MOST_FAULTY + round(FAULTY_FRACTION * count), count // 2)
    if count == 0:
        return _Ring(0, 0.0, clipped == 0)
    held = np.partition(light, count - 1 - faulty)
    held = np.minimum(held, held[count - 1 - faulty])
    mean, deviation = float(held.mean()), float(held.std())
    return _Ring(count, mean + SURE * deviation / math.sqrt(count), clipped <= faulty)


def _of_footprint(frame: Frame, scene: Scene, border_mm: Array) -> tuple[float, _Ring]:
    """Light of a frame for an exposure of 1: all within the footprint, and on the ring inside its border."""
    width = RING * float(np.mean(np.linalg.norm(border_mm - border_mm.mean(axis=0), axis=1)))
    y, x = scene.exit_grid.y_mm, scene.exit_grid.x_mm
    total, clipped, lights = 0.0, 0, list[Array]()
    for start in range(0, len(y), ROWS):
        rows = slice(start, start + ROWS)
        inside, within = (inside_border(moved(border_mm, by), (y[rows], x)) for by in (0.0, -width))
        # Negative where noise is: dark pixels must be dark in the mean.
        light, near = electrons_of(frame, rows) / frame.settings.exposure, inside & ~within
        total += float(light[inside].sum())
        lights.append(light[near])
        clipped += int(np.count_nonzero(frame.counts[rows][near] >= frame.settings.clipped_counts))
    return total, _ring_of(np.concatenate(lights), clipped)


def _area(border: Array) -> float:
    """Inside a closed border of points (y, x)."""
    y, x = border.T
    turned = np.roll(border, -1, axis=0)
    return 0.5 * abs(float(np.sum(y * turned[:, 1] - x * turned[:, 0])))
