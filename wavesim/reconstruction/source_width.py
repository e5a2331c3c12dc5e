"""How wide the light's source is, from the frames themselves, with an object that nobody knows.

A source of the diameter w washes a plane's intensity out by an amount that grows as w^2. An object is
sought for a while in the light of one width; then the intensities that it gives, I(w) in that light and I(0)
in that of a point, tell by least squares how much more or less they ought to be washed out:

    recorded = I(w) + (k - 1) (I(w) - I(0)),    w <- w sqrt(k),

and the object is sought on from where it is, until the width rests.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.from_object import reconstruct
from wavesim.scene.engine import Engine
from wavesim.scene.settings import ReconstructionSettings
from wavesim.scene.source import Source
from wavesim.sensor.measurement import Measurement

Array = NDArray[np.floating[Any]]

TURNS, ITERATIONS = 8, 6
"""Widths at most, and iterations of the object in the light of each."""

AT_REST = 0.02
"""Relative change of the width from one turn to the next at which it rests."""

MOST = 2.0
"""Factor by which a width changes in one turn at most."""

LEAST = 0.1
"""Of the width at which the object's light is coherent over half of it: narrower sources are points."""


def found_width(
    engine: Engine,
    light: Field,
    recorded: Sequence[Measurement],
    settings: ReconstructionSettings,
    tell: Callable[[str], None],
) -> tuple[float, Field]:
    """Diameter of the source in deg, 0 for a point, and the object that was found with it.

    Parameters
    ----------
    engine, light, recorded
        As of :func:`wavesim.reconstruct`, the planes with standard deviations.
    settings
        Kind of object, and all else.
    tell
        Told each width that is tried.
    """
    first = coherent_deg(light)
    width, start = first, light.with_values(np.ones_like(light.values))
    for _ in range(TURNS):
        tell(f"width of the source: {width:.3g} deg")
        modes = Source(width).few_modes(light.wavelength_um)
        found = reconstruct(
            engine,
            light,
            recorded,
            kind=settings.kind,
            tv_weight=settings.tv_weight,
            iterations=ITERATIONS,
            scale=settings.scale,
            start=start,
            fill_factor=settings.fill_factor,
            modes=modes,
        )
        start = found.transmission
        wide, point = (
            ForwardModel(engine, light, recorded, found.scale, settings.fill_factor, modes=of)
            for of in (modes, ())
        )
        ratio = washed_out(recorded, wide, wide.amplitudes(start.values), point.amplitudes(start.values))
        before, width = width, width * math.sqrt(min(max(ratio, MOST**-2), MOST**2))
        if width < LEAST * first:
            return 0.0, start
        if abs(width - before) < AT_REST * before:
            break
    return width, start


def coherent_deg(light: Field) -> float:
    """Width of a source whose light is coherent over about half of the lit object: wavelength / diameter."""
    lit = np.abs(light.values) > 1e-3 * np.abs(light.values).max()
    diameter_mm = 2.0 * math.sqrt(np.count_nonzero(lit) * light.grid.cell / math.pi)
    return math.degrees(1e-3 * light.wavelength_um / diameter_mm)


def washed_out(
    recorded: Sequence[Measurement],
    model: ForwardModel,
    wide: Sequence[Array],
    point: Sequence[Array],
) -> float:
    """How much more planes are washed out than in the light of a wide source: 1 for as much, 0 for a point's.

    Parameters
    ----------
    recorded
        The planes.
    model
        Which has their weights.
    wide, point
        Amplitudes on the planes in the light of the source, and in that of a point.
    """
    met = own = 0.0
    for plane, weight, broad, sharp in zip(recorded, model.weights, wide, point, strict=True):
        slope = (broad**2 - sharp**2) / np.maximum(2.0 * broad, 1e-6 * broad.max())
        counted = slope if weight is None else weight * slope
        met += float(np.vdot(counted, plane.amplitude - broad))
        own += float(np.vdot(counted, slope))
    return 1.0 + met / own if own > 0.0 else 1.0
