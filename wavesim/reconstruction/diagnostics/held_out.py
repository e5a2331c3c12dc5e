"""Pixels that a reconstruction is not given, to compare it with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.from_object import Reconstructed
from wavesim.scene.engine import Engine
from wavesim.scene.settings import SettingError
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement

SHARE = 0.02
"""Of each plane's pixels."""

SEED = 7
"""Of their choice, which is the same for all runs."""


class HeldOut(NamedTuple):
    """Of one plane: flat indices of pixels, and their standard deviations."""

    pixels: NDArray[np.intp]
    sigma: NDArray[np.floating[Any]]


def is_given(plane: Measurement) -> bool:
    """Whether anything is known of a plane."""
    return plane.sigma is None or bool(np.isfinite(plane.sigma).any())


def maps_of_all(
    engine: Engine,
    light: Field,
    recorded: Sequence[Measurement],
    fill_factor: float,
    found: Reconstructed,
    modes: Sequence[SourceMode] = (),
) -> tuple[NDArray[np.floating[Any]], ...]:
    """Amplitude of a result less the recorded one on all planes, those too that it was not given.

    Parameters
    ----------
    engine, light, recorded, fill_factor
        As of :func:`wavesim.reconstruct`.
    found
        From the planes of which something is known.
    modes
        As of :func:`wavesim.reconstruct`.
    """
    model = ForwardModel(engine, light, recorded, found.scale, fill_factor, modes=modes)
    made = model.amplitudes(found.transmission.values)
    return tuple(own - plane.amplitude for own, plane in zip(made, recorded, strict=True))


def hold_out(
    recorded: Sequence[Measurement], whole_plane: int | None = None
) -> tuple[list[Measurement], tuple[HeldOut, ...]]:
    """The planes without a share of their pixels, which are those that are known and drawn by chance.

    Parameters
    ----------
    recorded
        With standard deviations.
    whole_plane
        Number, from 1, of a plane that is held out altogether.

    Raises
    ------
    SettingError
        If there is no such plane, or no other.
    """
    if whole_plane is not None and not (1 <= whole_plane <= len(recorded) and len(recorded) > 1):
        raise SettingError(
            f"{{hold_out_plane}} = {whole_plane}: must be from 1 to {len(recorded)}, and one of two planes "
            "at least"
        )
    random = np.random.default_rng(SEED)
    planes, held = [], []
    for number, plane in enumerate(recorded, start=1):
        assert plane.sigma is not None
        flat = plane.sigma.ravel()
        if number == whole_plane:
            chosen = np.arange(flat.size)
        else:
            chosen = np.unique(random.integers(0, flat.size, int(SHARE * flat.size)))
        chosen = chosen[np.isfinite(flat[chosen])]
        held.append(HeldOut(chosen, flat[chosen]))
        sigma = plane.sigma.copy()
        sigma.ravel()[chosen] = np.inf
        planes.append(replace(plane, sigma=sigma))
    return planes, tuple(held)
