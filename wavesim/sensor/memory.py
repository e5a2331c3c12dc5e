"""Memory estimate of a simulated imaging run: the arrays that it allocates, and the phases that need them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lensdesign.lens.lens import Sensor
from wavesim.runtime.inventory import ArrayGroup, Inventory, work
from wavesim.scene.engine import Engine, Tiled
from wavesim.sensor.pixel_integration import Phase, light_across
from wavesim.sensor.recording import BAND_ROWS, Recording
from wavesim.sensor.windows import OVERSAMPLING
from wavesim.targets.patch import LIGHT_BYTES


def imaging_arrays(
    engine: Engine, sensor: Sensor, windows: Sequence[Sensor], recording: Recording
) -> Inventory:
    """Return the arrays that :func:`image_patch` and the writing of its results allocate.

    Parameters
    ----------
    engine
        Engine for the first plane.
    sensor, windows, recording
        See :func:`image_patch`.
    """
    across, down = sensor.pixels
    frames = len(windows) * len(recording.exposures)
    modes = len(recording.state.source.modes(engine.scene.wavelength_um))
    sums = 0 if modes == 1 else 2 * len(windows)
    objects, carrying = engine.scene.object_grid.shape, Phase.CARRYING
    # Memory of the process itself: libraries and compiled loops.
    process_bytes = 300_000_000
    common = (
        work("the process itself", process_bytes, Phase.LIGHTING | carrying),
        work("creation of the light", LIGHT_BYTES * math.prod(objects), Phase.LIGHTING),
        ArrayGroup("transmission, field behind the object, and picture", objects, np.complex64, carrying, 3),
        work("the engine's work", engine.cost().peak_bytes_in_single, carrying),
        ArrayGroup("frames", (down, across), np.uint16, carrying, frames),
        ArrayGroup("intensities of modes and their sums", (down, across), np.float64, carrying, sums),
    )
    if not isinstance(engine, Tiled):
        window = max(w.pixels[0] * w.pixels[1] for w in windows) * OVERSAMPLING**2
        # With several planes: two fields and the work arrays of the free-space propagation between them.
        fields = 1 if len(windows) == 1 else 4
        return (*common, ArrayGroup("fields on planes", (window,), np.complex128, carrying, fields))
    row = max(window.pixels[0] for window in windows) * OVERSAMPLING
    band = (min(BAND_ROWS, down * OVERSAMPLING), row)
    tiles = len(windows) * modes
    return (
        *common,
        ArrayGroup("bands of a field", band, np.complex64, carrying, 4),
        light_across(sensor, np.complex64, OVERSAMPLING),
        ArrayGroup("light on pixels", (down, across), np.float64, carrying),
        ArrayGroup("tiles of a plane", (engine.sums_bytes,), np.uint8, carrying, tiles, lies="file"),
    )
