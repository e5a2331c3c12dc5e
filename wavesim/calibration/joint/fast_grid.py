"""Room beside the pixels where Fourier transforms of as many rows or columns are slow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.fft

from wavesim.scene.scene import Scene
from wavesim.sensor.measurement import Measurement


def with_fast_shape(scene: Scene, recorded: Sequence[Measurement]) -> tuple[Scene, tuple[Measurement, ...]]:
    """The same with some more pixels about the middle, of which nothing is known.

    A transform of 438 samples (2, 3 and 73) takes three times as long as one of 440.

    Parameters
    ----------
    scene
        To all pixels.
    recorded
        Planes, with `sigma` if there are to be more pixels: others stay as they are.
    """
    grid = scene.exit_grid
    more = [scipy.fft.next_fast_len(count) - count for count in grid.shape]
    if not any(more) or any(plane.sigma is None for plane in recorded):
        return scene, tuple(recorded)
    sides = [(count // 2, count - count // 2) for count in more]
    y_mm, x_mm = (0.5 * grid.pitch_mm * (after - before) for before, after in sides)
    wider = replace(
        grid,
        shape=tuple(count + added for count, added in zip(grid.shape, more, strict=True)),
        centre_mm=(grid.centre_mm[0] + x_mm, grid.centre_mm[1] + y_mm),
    )
    # Amplitudes that are those beside them, so that a plane's mean, of which backgrounds are shares, stays.
    planes = [
        replace(
            plane,
            amplitude=np.pad(plane.amplitude, sides, mode="edge"),
            sigma=np.pad(np.asarray(plane.sigma), sides, constant_values=np.inf),
        )
        for plane in recorded
    ]
    return replace(scene, exit_grid=wider), tuple(planes)
