"""Whether reconstructions that start elsewhere end at the same object."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from wavesim.fields.field import Field
from wavesim.reconstruction.from_field import agreement
from wavesim.reconstruction.from_object import Reconstructed, reconstruct
from wavesim.scene.engine import Engine
from wavesim.scene.settings import ReconstructionSettings
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement

PHASE_RAD = 1.0
"""Root mean square of the phases from which complex objects start; amplitudes start between 0 and 1."""


def agreement_of_starts(
    engine: Engine,
    light: Field,
    recorded: Sequence[Measurement],
    settings: ReconstructionSettings,
    found: Reconstructed,
    tell: Callable[[str], None],
    modes: Sequence[SourceMode] = (),
) -> float | None:
    """Smallest correlation of the lit objects that several starts end at; None of a single one.

    Parameters
    ----------
    engine, light, recorded
        As of :func:`wavesim.reconstruct`.
    settings
        How many starts, and all else.
    found
        From the usual start.
    tell
        Told which start is on.
    modes
        As of :func:`wavesim.reconstruct`.
    """
    if settings.starts == 1:
        return None
    ends = [light.with_values(light.values * found.transmission.values)]
    for seed in range(1, settings.starts):
        tell(f"start {seed + 1} of {settings.starts}")
        random = np.random.default_rng(seed)
        if settings.kind == "amplitude":
            first = random.random(light.grid.shape)
        else:
            first = np.exp(1j * PHASE_RAD * random.standard_normal(light.grid.shape))
        other = reconstruct(
            engine,
            light,
            recorded,
            kind=settings.kind,
            tv_weight=settings.tv_weight,
            iterations=settings.most_iterations,
            until_noise=True,
            scale=settings.scale,
            start=light.with_values(first.astype(light.values.dtype)),
            fill_factor=settings.fill_factor,
            modes=modes,
        )
        ends.append(light.with_values(light.values * other.transmission.values))
    return agreement(ends)
