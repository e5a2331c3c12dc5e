"""Angular width or bandwidth of the light source, found from the frames of an unknown object.

A source of the width w blurs a plane's intensity by an amount that grows as w^2, whether w is an angle or a
band of wavelengths. An object is sought for some iterations with a source of one width. The intensities of
the result, I(w) with that source and I(0) with a coherent one, then give the blur of the measured intensity
by least squares:

    measured = I(w) + (k - 1) (I(w) - I(0)),    w <- w sqrt(k).

The search for the object continues from there until the width converges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.forward.forward_model import ForwardModel
from wavesim.reconstruction.object_solver import reconstruct
from wavesim.scene.engine import Engine
from wavesim.scene.settings import ReconstructionSettings
from wavesim.scene.source import Source, SourceMode
from wavesim.sensor.measurement import Measurement

Array = NDArray[np.floating[Any]]

MOST_WIDTHS, ITERATIONS = 8, 6
"""Largest number of widths, and iterations of the object with each."""

BROADEST = 3.0
"""Largest bandwidth that is sought, over the one that shifts the steepest light by a speckle.

Each wavelength needs an engine, and a broader band needs more of them.
"""


def find_source(
    engine: Engine,
    light: Field,
    recorded: Sequence[Measurement],
    settings: ReconstructionSettings,
    progress: Callable[[str], None],
) -> tuple[Source, Field]:
    """Return the source of the light, and the object found with it.

    Parameters
    ----------
    engine, light, recorded
        See :func:`wavesim.reconstruct`; the planes have standard deviations.
    settings
        Settings of the reconstruction. Either `source_deg` or `bandwidth_nm` is "find".
    progress
        Called with a message for each width that is tried.
    """
    if settings.bandwidth_nm == "find":
        assert settings.source_deg != "find"
        known = Source(width_deg=settings.source_deg)
        coherent_width, message = coherent_nm(light), "bandwidth of the light: {:.3g} nm"
        largest_width = BROADEST * coherent_width
    else:
        known = Source(bandwidth_nm=settings.bandwidth_nm)
        coherent_width, message = coherent_deg(light), "width of the source: {:.3g}°"
        largest_width = math.inf

    def source_of(width: float) -> Source:
        is_band = settings.bandwidth_nm == "find"
        return replace(known, bandwidth_nm=width) if is_band else replace(known, width_deg=width)

    width, start = coherent_width, light.with_values(np.ones_like(light.values))
    # Relative change of the width at which the search ends.
    tolerance = 0.02
    # Largest factor by which the width changes at a time.
    largest_factor = 2.0
    # Smallest width over that at which half of the object is lit coherently. Narrower sources are points.
    least_width = 0.1
    for _ in range(MOST_WIDTHS):
        progress(message.format(width))
        modes = modes_on(light, source_of(width))
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
            for of in (modes, modes_on(light, known))
        )
        ratio = blur_ratio(recorded, wide, wide.amplitudes(start.values), point.amplitudes(start.values))
        factor = math.sqrt(min(max(ratio, largest_factor**-2), largest_factor**2))
        previous, width = width, min(width * factor, largest_width)
        if width < least_width * coherent_width:
            return source_of(0.0), start
        if abs(width - previous) < tolerance * previous:
            break
    return source_of(width), start


def modes_on(light: Field, source: Source) -> list[SourceMode]:
    """Return the few modes of a source that a reconstruction uses for the light on an object."""
    return source.few_modes(light.wavelength_um, samples=max(light.grid.shape))


def coherent_deg(light: Field) -> float:
    """Return the source width in deg whose light is coherent over about half of the lit object.

    It is the wavelength over the diameter of the lit area.
    """
    return math.degrees(1e-3 * light.wavelength_um / _diameter_mm(light))


def coherent_nm(light: Field) -> float:
    """Return the bandwidth in nm over which the steepest light shifts on the sensor by one speckle.

    Light of all directions that the samples hold forms about D / (2 p) speckles from the axis to the rim, for
    samples of the pitch p over the diameter D of the lit area. A relative change of the wavelength stretches
    the picture by the same factor.
    """
    return 1e3 * light.wavelength_um * 2.0 * light.grid.pitch_mm / _diameter_mm(light)


def _diameter_mm(light: Field) -> float:
    lit = np.abs(light.values) > 1e-3 * np.abs(light.values).max()
    return 2.0 * math.sqrt(np.count_nonzero(lit) * light.grid.cell / math.pi)


def blur_ratio(
    recorded: Sequence[Measurement],
    model: ForwardModel,
    wide: Sequence[Array],
    point: Sequence[Array],
) -> float:
    """Return the blur of measured planes over that of a source: 1 for equal blur, 0 for a coherent source.

    Parameters
    ----------
    recorded
        Measured planes.
    model
        Forward model, which holds the weights of the planes.
    wide, point
        Amplitudes on the planes for the source, and for a coherent one.
    """
    cross = power = 0.0
    for plane, weight, broad, sharp in zip(recorded, model.weights, wide, point, strict=True):
        slope = (broad**2 - sharp**2) / np.maximum(2.0 * broad, 1e-6 * broad.max())
        weighted = slope if weight is None else weight * slope
        cross += float(np.vdot(weighted, plane.amplitude - broad))
        power += float(np.vdot(weighted, slope))
    return 1.0 + cross / power if power > 0.0 else 1.0
