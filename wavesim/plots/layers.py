"""Fields and frames as layers of a page that zooms: values with their range, scale and colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.plots.objects import LIT, phase_reach
from wavesim.plots.pyramid import Function, Level, halved, picture_levels
from wavesim.sensor.frames import Frame
from wavesim.sensor.merged_exposures import fixed_variance

Plane = Literal["object", "sensor"]


@dataclass(frozen=True, eq=False)
class PictureLayer:
    """A picture of a page.

    Attributes
    ----------
    name : str
        Name of the picture.
    unit : str
        Unit of the values; may be empty.
    plane : {"object", "sensor"}
        Plane of the picture. The view stays the same between layers of one plane.
    pitch_um : float
        Sample pitch (um).
    centre_um : (x, y)
        Centre of the picture.
    levels : list of Level
        The picture and its halvings; the first row has the largest y. NaN means no value.
    low, high : float
        Range of the colours.
    beyond : (bool, bool)
        Whether there are values below and above the range; they look like its ends.
    logarithmic : bool
        Whether colours follow the logarithm of the values; `low` is above 0 then.
    colours : str
        One of Matplotlib's colour maps.
    """

    name: str
    unit: str
    plane: Plane
    pitch_um: float
    centre_um: tuple[float, float]
    levels: Sequence[Level]
    low: float
    high: float
    beyond: tuple[bool, bool]
    logarithmic: bool
    colours: str


def field_layers(
    values: Any, pitch_um: float, centre_um: tuple[float, float] = (0.0, 0.0), name: str = ""
) -> list[PictureLayer]:
    """Return the amplitude of a field as a layer, and its phase unless it is 0 everywhere.

    Parameters
    ----------
    values
        Complex or real values, shape (ny, nx); y increases with the row.
    pitch_um
        Sample pitch in um.
    centre_um
        Centre of the samples (x, y) in um.
    name
        Text before "amplitude" and "phase" in the names of the layers.

    Returns
    -------
    list of PictureLayer
        One or two layers.
    """
    upright, some = values[::-1], _some(values)
    # Quantile of amplitudes at the upper end of the colours, so that single samples may exceed it.
    quantile = 0.9999
    brightest = max(float(np.quantile(np.abs(some), quantile)), 1e-12)

    def layer(
        what: str, unit: str, levels: Sequence[Level], low: float, high: float, beyond: bool, colours: str
    ) -> PictureLayer:
        label, open_ended = f"{name} {what}".strip(), (beyond and low < 0.0, beyond)
        return PictureLayer(
            label, unit, "object", pitch_um, centre_um, levels, low, high, open_ended, False, colours
        )

    above = any(np.abs(row).max() > brightest for row in values)
    layers = [layer("amplitude", "", picture_levels(upright, "amplitude"), 0.0, brightest, above, "gray")]
    if np.iscomplexobj(values) and any(np.any(row.imag) for row in values):
        reach = phase_reach(np.angle(some[np.abs(some) > LIT * brightest]))
        turn = reach == math.pi
        levels = [
            Level(level.stored, _phase_where_lit(LIT * brightest))
            for level in picture_levels(upright, "phase_rad")
        ]
        colours = "twilight" if turn else "RdBu_r"
        layers.append(layer("phase", "rad", levels, -reach, reach, not turn, colours))
    return layers


def frame_layer(frame: Frame, name: str, centre_um: tuple[float, float] = (0.0, 0.0)) -> PictureLayer:
    """Return the electrons in the pixels of a frame as a layer, on a logarithmic scale.

    The scale begins at the noise of a dark pixel.

    Parameters
    ----------
    frame
        A recorded frame.
    name
        Name of the layer.
    centre_um
        Centre of the pixels (x, y) in um.
    """
    settings = frame.settings
    gain, offset = settings.gain_electrons_per_count, settings.offset_counts

    def electrons(counts: Any) -> Any:
        return np.float32(gain) * (counts - np.float32(offset))

    levels = [Level(frame.counts[::-1], electrons)]
    levels += picture_levels(halved(levels[0].stored, electrons), "electrons")
    low = max(math.sqrt(fixed_variance(frame)), 1e-3)
    high = max(float(electrons(frame.counts.max())), 10.0 * low)
    beyond = float(electrons(frame.counts.min())) < low, False
    pitch_um = settings.pixel_pitch_um
    return PictureLayer(
        name, "electrons", "sensor", pitch_um, centre_um, levels, low, high, beyond, True, "inferno"
    )


def _some(values: Any) -> Any:
    """Return evenly spaced samples, about a million at most."""
    # Most samples from which ranges are found.
    most_samples = 1_000_000
    step = max(1, math.ceil(math.sqrt(values.size / most_samples)))
    return values[::step, ::step]


def _phase_where_lit(least: float) -> Function:
    def phase(values: Any) -> Array:
        return np.where(np.abs(values) > least, np.angle(values), np.nan)

    return phase
