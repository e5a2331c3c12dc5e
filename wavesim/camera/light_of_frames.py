"""The light behind an unknown object, as far as its frames tell it: how much of it goes to the rim."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.camera.exposures import electrons_of
from wavesim.camera.frame_sets import frames_by_plane
from wavesim.camera.frames import Frame
from wavesim.fields.field import Field
from wavesim.rays.maps import RIM_ARMS, inside_border, moved
from wavesim.rays.ray_bundles import open_pupil, trace_bundle
from wavesim.scene.light import Light
from wavesim.scene.scene import Scene

RING = 0.1
"""Of the footprint's radius: pixels so near to its border, inside, show the light at the rim."""

SURE = 2.0
"""Standard deviations of the mean over such pixels by which it may be larger."""

FEW, BRIGHTEST = 5, 0.002
"""Number of such pixels, and fraction of them, that count no more than the next brightest: hot pixels, cosmic
rays and damaged files must not decide which engine is taken."""

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
    clear = [ring for _, ring in read if ring.clipped == 0] or [read[0][1]]
    total, ring = read[0][0], clear[-1]
    if ring.pixels == 0 or total <= 0.0:
        return Light(illumination, 1.0)
    lit = np.isfinite(rim.amplitude)
    # Of even light, one unit in each direction: on the border's pixels, and in all.
    border = float(np.mean(rim.amplitude[lit] ** 2)) * scene.exit_grid.cell
    return Light(illumination, min(max(ring.most / border * _area(rim.cosines) / total, 0.0), 1.0))


class _Ring:
    """Light of the pixels next to the footprint's border, and how many of them were clipped."""

    def __init__(self) -> None:
        self.clipped = 0
        self._values: list[Array] = []

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return sum(len(values) for values in self._values)

    def add(self, values: Array, clipped: int) -> None:
        self.clipped += clipped
        self._values.append(values.astype(np.float32))

    @property
    def most(self) -> float:
        """The mean, as large as it may well be; a few pixels brighter than all others do not change it."""
        values = np.concatenate(self._values)
        few = min(max(FEW, int(BRIGHTEST * len(values))), len(values) - 1)
        limit = np.partition(values, len(values) - 1 - few)[len(values) - 1 - few]
        values = np.minimum(values, limit).astype(float)
        return float(values.mean() + SURE * values.std() / math.sqrt(len(values)))


def _of_footprint(frame: Frame, scene: Scene, border_mm: Array) -> tuple[float, _Ring]:
    """Light of a frame for an exposure of 1: all within the footprint, and on the ring inside its border."""
    width = RING * float(np.mean(np.linalg.norm(border_mm - border_mm.mean(axis=0), axis=1)))
    y, x = scene.exit_grid.y_mm, scene.exit_grid.x_mm
    total, ring = 0.0, _Ring()
    for start in range(0, len(y), ROWS):
        rows = slice(start, start + ROWS)
        inside, within = (inside_border(moved(border_mm, by), (y[rows], x)) for by in (0.0, -width))
        # Negative where noise is: dark pixels must be dark in the mean.
        light, near = electrons_of(frame, rows) / frame.settings.exposure, inside & ~within
        total += float(light[inside].sum())
        ring.add(
            light[near], int(np.count_nonzero(frame.counts[rows][near] >= frame.settings.clipped_counts))
        )
    return total, ring


def _area(border: Array) -> float:
    """Inside a closed border of points (y, x)."""
    y, x = border.T
    turned = np.roll(border, -1, axis=0)
    return 0.5 * abs(float(np.sum(y * turned[:, 1] - x * turned[:, 0])))
