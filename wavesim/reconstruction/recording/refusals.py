"""What a reconstruction of an object cannot work with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lensdesign.errors import InputError, validate_choice, validate_positive, validate_whole_number
from wavesim.fields.field import Field
from wavesim.reconstruction.from_field import validate_planes
from wavesim.scene.engine import Grids
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement

WIDEST_PIXEL = 2.0
"""Side of the square over which a picture may be averaged, in pixels: more than 1 where it is blurred."""


def validate_numbers(
    kind: str, tv_weight: float | str, iterations: int, scale: float | None, fill_factor: float
) -> None:
    """Refuse settings out of their range; all as of :func:`wavesim.reconstruct`."""
    validate_choice("kind", kind, ("complex", "amplitude"))
    if tv_weight != "auto" and (
        isinstance(tv_weight, str) or not (math.isfinite(tv_weight) and tv_weight >= 0.0)
    ):
        raise InputError(f"tv_weight = {tv_weight!r}: must be finite and not negative, or 'auto'")
    validate_whole_number("iterations", iterations, 1)
    if scale is not None:
        validate_positive("scale", scale)
    if not 0.0 <= fill_factor <= WIDEST_PIXEL:
        raise InputError(f"fill_factor = {fill_factor!r}: must be from 0 to {WIDEST_PIXEL:g}")


def validate_measurements(
    grids: Grids,
    illumination: Field,
    recorded: Sequence[Measurement],
    start: Any,
    modes: Sequence[SourceMode],
    rows: Sequence[slice],
) -> None:
    """Refuse light, planes or a start that are none of an engine; as of :func:`wavesim.reconstruct`."""
    if illumination.grid != grids.object_grid:
        raise InputError(f"illumination: its grid {illumination.grid} is not the engine's object grid")
    if not np.any(np.abs(illumination.values) > 0.0):
        raise InputError("illumination: is all dark")
    if not recorded:
        raise InputError("recorded: must be one plane at least")
    shape = grids.exit_grid.shape
    if rows:
        shape = (shape[0] // len(rows), *shape[1:])
    validate_planes(recorded, shape, "the exit grid's")
    if not (start is None or start == "amplitude" or isinstance(start, Field)):
        raise InputError(f"start = {start!r}: must be a field, or 'amplitude'")
    if isinstance(start, Field) and start.grid.shape != illumination.grid.shape:
        raise InputError(f"start: its shape {start.grid.shape} is not that of the object grid")
    if any(mode.wavelength_um != illumination.wavelength_um for mode in modes):
        raise InputError(f"modes: must all be of {illumination.wavelength_um:g} um, as the illumination is")
