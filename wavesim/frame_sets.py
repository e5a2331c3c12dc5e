"""Frames of one object on several planes: read together, and refused or told of where they do not do."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from lensdesign.system import Lens
from wavesim.frames import Frame, read_frame
from wavesim.retrieval import Recorded, recorded_intensity
from wavesim.sensor import SaturationWarning, estimate_intensity

SATURATED_TOLD, SATURATED_REFUSED = 1e-5, 0.02
"""Share of a frame's pixels that may be clipped: from the first on it is told, beyond the second refused."""

LEAST_SIGNAL = 6.0
"""Standard deviations of a dark pixel by which the brightest exceeds the dark count, or there is no light."""

SAME_PITCH = 1e-3
"""Relative difference up to which pixel pitches are the same."""


def read_frames(paths: Sequence[Path], given: Sequence[Mapping[str, Any]]) -> tuple[Frame, ...]:
    """Frames in the order of their planes, checked to belong together.

    Parameters
    ----------
    paths
        TIFF files.
    given
        For each, the settings that stand in for what it does not say.

    Raises
    ------
    InputError
        If a file cannot be read, two frames differ in size, pitch or wavelength, lie on one plane, or one is
        saturated or empty.

    Warns
    -----
    SaturationWarning
        If a few pixels are clipped.
    """
    frames = [read_frame(path, **settings) for path, settings in zip(paths, given, strict=True)]
    first = frames[0]
    for path, frame in zip(paths, frames, strict=True):
        here, there = frame.counts.shape[::-1], first.counts.shape[::-1]
        if here != there:
            raise InputError(
                f"{path}: {here[0]} x {here[1]} pixels; {paths[0]} has {there[0]} x {there[1]}: frames that "
                "are used together must have the same size"
            )
        for name in ("pixel_pitch_um", "wavelength_um"):
            one, other = getattr(frame.settings, name), getattr(first.settings, name)
            if not math.isclose(one, other, rel_tol=1e-6):
                raise InputError(
                    f"{path}: {name} = {one:g}; that of {paths[0]} is {other:g}: must be the same"
                )
        _check_light(frame, path)
    order = sorted(range(len(frames)), key=lambda i: frames[i].settings.plane_distance_mm)
    for i, j in pairwise(order):
        if frames[i].settings.plane_distance_mm == frames[j].settings.plane_distance_mm:
            raise InputError(
                f"{paths[i]} and {paths[j]}: both state plane_distance_mm = "
                f"{frames[i].settings.plane_distance_mm:g}: frames must be of different planes"
            )
    return tuple(frames[i] for i in order)


def _check_light(frame: Frame, path: Path) -> None:
    settings = frame.settings
    dark = math.hypot(
        settings.read_noise_electrons / settings.gain_electrons_per_count, 1.0 / math.sqrt(12.0)
    )
    brightest = int(frame.counts.max())
    if brightest < settings.offset_counts + LEAST_SIGNAL * dark:
        raise InputError(
            f"{path}: is empty: no pixel exceeds {brightest} counts, and dark ones have "
            f"{settings.offset_counts:g}"
        )
    share = float(np.mean(frame.saturated))
    clipped = settings.clipped_counts
    said = f"{path}: {100.0 * share:.2g} % of the pixels are saturated, at {clipped} counts or more"
    if share > SATURATED_REFUSED:
        raise InputError(f"{said}; at most {100.0 * SATURATED_REFUSED:g} % may be: expose less")
    if share > SATURATED_TOLD:
        warnings.warn(f"{said}; they are left out: expose less", SaturationWarning, stacklevel=3)


def refuse_other_pitch(frames: Sequence[Frame], lens: Lens) -> None:
    """Refuse frames whose pixels are not those of the design's sensor.

    Raises
    ------
    InputError
        If the pitch differs, or a frame has more pixels than the sensor.
    """
    pitch, own = frames[0].settings.pixel_pitch_um, lens.sensor.pixel_pitch_um
    if not math.isclose(pitch, own, rel_tol=SAME_PITCH):
        raise InputError(
            f"frames have pixel_pitch_um = {pitch:g}, the design's sensor {own:g}: give the design of this "
            "sensor, or the frames' true pitch"
        )
    rows, columns = frames[0].counts.shape
    across, down = lens.sensor.pixels
    if columns > across or rows > down:
        raise InputError(
            f"frames have {columns} x {rows} pixels, the design's sensor {across} x {down}: these are not "
            "its frames"
        )


def recorded_planes(frames: Sequence[Frame]) -> list[Recorded]:
    """Amplitudes and what noise leaves of them, at distances from the first frame's plane."""
    first = frames[0].settings.plane_distance_mm
    planes = []
    for frame in frames:
        plane = recorded_intensity(frame.settings.plane_distance_mm - first, *estimate_intensity(frame))
        sigma = None if plane.sigma is None else plane.sigma.astype(np.float32)
        planes.append(Recorded(plane.distance_mm, plane.amplitude.astype(np.float32), sigma))
    return planes
