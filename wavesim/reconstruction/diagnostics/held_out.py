"""Pixels that are held out of a reconstruction, to test it against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.reconstruction.object_solver import Reconstructed
from wavesim.scene.engine import Engine
from wavesim.scene.settings import SettingError
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement


class HeldOut(NamedTuple):
    """Held-out pixels of a plane (flat indices), and their standard deviations."""

    pixels: NDArray[np.intp]
    sigma: NDArray[np.floating[Any]]


def is_given(plane: Measurement) -> bool:
    """Return whether a plane has pixels that the reconstruction uses."""
    return plane.sigma is None or bool(np.isfinite(plane.sigma).any())


def residual_maps_of(
    engine: Engine,
    light: Field,
    recorded: Sequence[Measurement],
    fill_factor: float,
    found: Reconstructed,
    modes: Sequence[SourceMode] = (),
) -> tuple[NDArray[np.floating[Any]], ...]:
    """Return modelled less measured amplitudes on all planes, including held-out planes.

    Parameters
    ----------
    engine, light, recorded, fill_factor
        See :func:`wavesim.reconstruct`.
    found
        Result from the planes that were not held out.
    modes
        Modes of the light; see :func:`wavesim.reconstruct`.
    """
    model = ChannelModel.of_source(engine, light, recorded, found.scale, fill_factor, modes=modes)
    modelled = model.amplitudes(found.transmission.values)
    return tuple(amplitude - plane.amplitude for amplitude, plane in zip(modelled, recorded, strict=True))


def hold_out(
    recorded: Sequence[Measurement], whole_plane: int | None = None
) -> tuple[list[Measurement], tuple[HeldOut, ...]]:
    """Return the planes without the held-out pixels, and those pixels.

    Valid pixels are drawn at random; in the returned planes their standard deviation is infinite.

    Parameters
    ----------
    recorded
        Measured planes with standard deviations.
    whole_plane
        Number (from 1) of a plane that is held out as a whole.

    Raises
    ------
    SettingError
        If there is no such plane, or no other plane.
    """
    if whole_plane is not None and not (1 <= whole_plane <= len(recorded) and len(recorded) > 1):
        raise SettingError(
            f"{{hold_out_plane}} = {whole_plane}: must be the number of a plane, from 1 to "
            f"{len(recorded)}, and there must be at least two planes"
        )
    random = np.random.default_rng(7)  # all runs choose the same pixels
    planes, held_out = [], []
    # Fraction of each plane's pixels that is held out.
    held_out_fraction = 0.02
    for plane_number, plane in enumerate(recorded, start=1):
        assert plane.sigma is not None
        flat = plane.sigma.ravel()
        if plane_number == whole_plane:
            chosen = np.arange(flat.size)
        else:
            chosen = np.unique(random.integers(0, flat.size, int(held_out_fraction * flat.size)))
        chosen = chosen[np.isfinite(flat[chosen])]
        held_out.append(HeldOut(chosen, flat[chosen]))
        sigma = plane.sigma.copy()
        sigma.ravel()[chosen] = np.inf
        planes.append(replace(plane, sigma=sigma))
    return planes, tuple(held_out)
