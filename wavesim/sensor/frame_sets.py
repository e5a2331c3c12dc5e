"""Frames of one object on several planes: read together, and refused or told of where they do not do.

Several frames of one plane, exposures of different length or repeats, become one intensity.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.runtime.threads import for_blocks, row_blocks
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.settings import FrameSetSettings, SettingError
from wavesim.sensor.exposures import (
    SaturationWarning,
    clipped_in_all,
    electrons_of,
    fixed_variance,
    known_in,
    merged_intensity,
)
from wavesim.sensor.frames import Frame, read_frame
from wavesim.sensor.measurement import Measurement, recorded_intensity
from wavesim.sensor.pixels.bad import find_bad_pixels
from wavesim.sensor.pixels.maps import PixelMaps, read_pixel_maps

SATURATED_TOLD, SATURATED_REFUSED = 1e-5, 0.02
"""Share of a plane's pixels that may be clipped in all of its frames: from the first on it is told, beyond
the second refused."""

LEAST_SIGNAL = 6.0
"""Standard deviations of a dark pixel by which the brightest exceeds the dark count, or there is no light."""

SAME_PITCH = 1e-3
"""Relative difference up to which pixel pitches are the same."""

OTHER_PICTURE, SURE = 0.05, 6.0
"""Mean square difference of two frames of one plane, less what is noise, over the mean square intensity, from
which on they are different pictures; and the standard deviations of that noise by which it must show."""

SAME_EXPOSURE, MOST_OFF = 3e-3, 0.3
"""Relative error of an exposure from which on it is told and taken out, and up to which it can be: beyond,
frames state something else than what they are."""

SEEN, NOT_CLIPPED = 20.0, 0.9
"""Pixels that tell it: standard deviations of a dark one that they show, and share of the counts at most."""

COMPARED = 4_000_000
"""Pixels, about, that two frames of one plane are compared in: of larger ones, some rows."""

ROWS = 64
"""Of a plane, for a thread at a time."""


class BadPixelWarning(UserWarning):
    """A stated number of pixels is hot or dead, and left out."""


class ExposureWarning(UserWarning):
    """A frame's light is not what its exposure says, which is taken out."""


@dataclass(frozen=True)
class PlaneFrames:
    """What the frames of one plane say of how they were recorded.

    Attributes
    ----------
    distance_mm : float
        From the exit vertex.
    exposures : tuple of float
        Of its frames, increasing.
    saturated_share : float
        Part of the pixels that are clipped in all of them.
    """

    distance_mm: float
    exposures: tuple[float, ...]
    saturated_share: float


def read_frames(
    paths: Sequence[Path],
    settings: FrameSetSettings | None = None,
    *,
    lens: Lens | None = None,
    assumed: Mapping[str, Any] | None = None,
    **changes: Any,
) -> tuple[Frame, ...]:
    """Frames in the order of their planes, those of one plane by exposure, checked to belong together.

    Parameters
    ----------
    paths
        TIFF or PNG files.
    settings
        What stands in for what they do not say.
    lens
        The design, whose pixel pitch, wavelength and planes are taken where neither files nor settings say
        them: the wavelength of a design that has one, its planes in the order of the files if there are as
        many.
    assumed
        What is taken, told by a warning, where neither these nor files nor settings say it.
    **changes
        Settings by name, in place of those of `settings`.

    Raises
    ------
    InputError
        If a file cannot be read or is named twice, two frames differ in size, pitch or wavelength, those of
        one plane show different pictures, a frame is empty, or a plane is saturated in all of its frames; or
        if there are not as many distances or exposures as frames.

    Warns
    -----
    SaturationWarning
        If a few pixels are clipped in all frames of a plane.
    BadPixelWarning, ExposureWarning
        If pixels are hot or dead, or exposures other than stated.
    AssumedWarning
        For each frame, what was taken of the design.
    """
    settings = (settings or FrameSetSettings()).replaced(**changes)
    if lens is not None:
        validate_lengths(lens, settings)
    given = _given(len(paths), settings)
    for number, path in enumerate(paths):
        if path in paths[:number]:
            raise InputError(f"{path}: is named twice: a frame counts once")
    taken = [dict(assumed or {}) | own for own in _assumed(len(paths), lens)]
    read = [read_frame(path, known, **own) for path, known, own in zip(paths, taken, given, strict=True)]
    _refuse_unlike(paths, read)
    order = sorted(
        zip(paths, read, strict=True),
        key=lambda one: (one[1].settings.plane_distance_mm, one[1].settings.exposure),
    )
    named = [path for path, _ in order]
    frames = _without_bad(_with_maps(named, [frame for _, frame in order], settings))
    checked = []
    for _, group in groupby(
        zip(named, frames, strict=True), key=lambda one: one[1].settings.plane_distance_mm
    ):
        plane = _with_true_exposures(list(group))
        for shorter, longer in pairwise(plane):
            _refuse_other_picture(shorter, longer)
        _check_saturation(plane)
        checked += [frame for _, frame in plane]
    return tuple(checked)


def _with_maps(paths: Sequence[Path], frames: Sequence[Frame], settings: FrameSetSettings) -> list[Frame]:
    """Frames with what is known of their pixels."""
    own = frames[0].settings
    maps = read_pixel_maps(
        frames[0].counts.shape,
        own.offset_counts,
        own.gain_electrons_per_count,
        flat=settings.flat,
        dark=settings.dark,
        bad=settings.bad_pixels,
    )
    if maps is None:
        return list(frames)
    if maps.dark_electrons is not None:
        dark = own.offset_counts + float(maps.dark_electrons.mean()) / own.gain_electrons_per_count
        for path, frame in zip(paths, frames, strict=True):
            if dark > float(frame.counts.mean()):
                raise InputError(
                    f"{settings.dark}: has {dark:.4g} counts in the mean, more than {path} with "
                    f"{frame.counts.mean():.4g}: must be a picture without light"
                )
    return [replace(frame, maps=maps) for frame in frames]


def _without_bad(frames: Sequence[Frame]) -> list[Frame]:
    """Frames whose hot and dead pixels are marked, too."""
    planes = frames_by_plane(frames)
    result = list[Frame]()
    for plane, found in zip(planes, find_bad_pixels(planes), strict=True):
        maps = plane[0].maps or PixelMaps()
        new = found if maps.bad is None else found & ~maps.bad
        if not new.any():
            result += plane
            continue
        warnings.warn(
            f"plane at {plane[0].settings.plane_distance_mm:g} mm: {np.count_nonzero(new)} pixels are hot or "
            "dead; they are left out",
            BadPixelWarning,
            stacklevel=3,
        )
        maps = replace(maps, bad=found if maps.bad is None else found | maps.bad)
        result += [replace(frame, maps=maps) for frame in plane]
    return result


def _with_true_exposures(plane: Sequence[tuple[Path, Frame]]) -> list[tuple[Path, Frame]]:
    """Frames of one plane whose exposures are those of their light, from the shortest's on."""
    result = [plane[0]]
    for path, frame in plane[1:]:
        factor, deviation = _exposure_ratio(result[-1][1], frame)
        off = abs(factor - 1.0)
        if max(SAME_EXPOSURE, SURE * deviation) < off <= MOST_OFF:
            warnings.warn(
                f"{path}: is {100.0 * (factor - 1.0):+.2g} % brighter than its exposure says, against "
                f"{result[-1][0]}: that is taken out",
                ExposureWarning,
                stacklevel=3,
            )
            settings = frame.settings.replaced(exposure=factor * frame.settings.exposure)
            frame = replace(frame, settings=settings)
        result.append((path, frame))
    return result


def _exposure_ratio(short: Frame, long: Frame) -> tuple[float, float]:
    """Light of a longer exposure over what a shorter one and both exposures say, and its deviation."""
    ratio = long.settings.exposure / short.settings.exposure
    clear = NOT_CLIPPED * (long.settings.clipped_counts - long.settings.offset_counts)
    most = clear * long.settings.gain_electrons_per_count
    least = SEEN * math.sqrt(fixed_variance(short) + 1.0)
    shorter = longer = scatter = 0.0
    every = 1 + short.counts.size // COMPARED
    for block in row_blocks(len(short.counts)):
        rows = slice(block.start, block.stop, every)
        two = electrons_of(long, rows)
        # Chosen by the frame whose noise is less: chosen by both, the noise of the other would choose, too.
        chosen = known_in(short, rows) & known_in(long, rows) & (two > least * ratio) & (two < most)
        one = electrons_of(short, rows)[chosen]
        shorter += float(one.sum())
        longer += float(two[chosen].sum()) / ratio
        scatter += float(np.sum(np.maximum(one, 0.0) * (1.0 + 1.0 / ratio) + fixed_variance(short)))
    return (longer / shorter, math.sqrt(scatter) / shorter) if shorter > 0.0 else (1.0, math.inf)


def _given(count: int, settings: FrameSetSettings) -> list[dict[str, Any]]:
    """For each frame, the settings that stand in for what it does not say."""
    told = settings.model_dump(exclude_none=True, exclude={"flat", "dark", "bad_pixels"})
    for name in ("plane_distance_mm", "exposure"):
        if name in told and len(told[name]) != count:
            said = ",".join(f"{number:g}" for number in told[name])
            raise SettingError(f"{{{name}}} = {said!r}: must be {count} numbers, one of each frame")
    return [
        {name: value[frame] if isinstance(value, tuple) else value for name, value in told.items()}
        for frame in range(count)
    ]


def _assumed(count: int, lens: Lens | None) -> list[dict[str, Any]]:
    """For each frame, what a design says of it."""
    if lens is None:
        return [{}] * count
    told: dict[str, Any] = {"pixel_pitch_um": lens.sensor.pixel_pitch_um}
    if len(lens.wavelengths_um) == 1:
        told["wavelength_um"] = lens.wavelengths_um[0]
    planes = lens.sensor.plane_distances_mm
    if len(planes) != count:
        return [told] * count
    return [told | {"plane_distance_mm": distance} for distance in planes]


def _refuse_unlike(paths: Sequence[Path], frames: Sequence[Frame]) -> None:
    """Refuse frames of different sensors or light, and such without light."""
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
        brightest, settings = int(frame.counts.max()), frame.settings
        dark = math.sqrt(fixed_variance(frame)) / settings.gain_electrons_per_count
        if brightest < settings.offset_counts + LEAST_SIGNAL * dark:
            raise InputError(
                f"{path}: is empty: no pixel exceeds {brightest} counts, and dark ones have "
                f"{settings.offset_counts:g}"
            )


def _refuse_other_picture(shorter: tuple[Path, Frame], longer: tuple[Path, Frame]) -> None:
    """Refuse frames that state one plane and cannot be exposures of one intensity.

    Compared are pixels that neither clips, in electrons of the shorter exposure.
    """
    (path, short), (other, long) = shorter, longer
    ratio = long.settings.exposure / short.settings.exposure
    excess = scatter = size = 0.0
    seen = LEAST_SIGNAL * math.sqrt(fixed_variance(short))
    every = 1 + short.counts.size // COMPARED
    for block in row_blocks(len(short.counts)):
        rows = slice(block.start, block.stop, every)
        known = known_in(short, rows) & known_in(long, rows)
        one, two = electrons_of(short, rows), electrons_of(long, rows) / ratio
        # Dark signals of pixels differ, and of a faint picture they are most of what is seen. The longer
        # exposure chooses: where the shorter one does, its noise would.
        known &= (two > seen) | (one > 5.0 * seen)
        one, two = one[known], two[known]
        noise = np.maximum(two, 0.0) * (1.0 + 1.0 / ratio)
        noise += fixed_variance(short) + fixed_variance(long) / ratio**2
        excess += float(np.sum((one - two) ** 2 - noise))
        scatter += float(np.sum(2.0 * noise**2 + noise))
        size += float(np.sum(np.maximum(np.abs(one), np.abs(two)) ** 2))
    if excess > SURE * math.sqrt(scatter) and excess > OTHER_PICTURE * size:
        raise InputError(
            f"{path} and {other}: both state plane_distance_mm = {short.settings.plane_distance_mm:g}, but "
            "show different intensities: frames of one plane must be exposures of the same light, of which "
            "each states its exposure"
        )


def _check_saturation(plane: Sequence[tuple[Path, Frame]]) -> None:
    frames = [frame for _, frame in plane]
    share = float(np.mean(clipped_in_all(frames)))
    clipped = frames[0].settings.clipped_counts
    named = ", ".join(str(path) for path, _ in plane)
    where = "" if len(plane) == 1 else " in each of these frames of one plane"
    said = f"{named}: {100.0 * share:.2g} % of the pixels are saturated{where}, at {clipped} counts or more"
    if share > SATURATED_REFUSED:
        raise InputError(f"{said}; at most {100.0 * SATURATED_REFUSED:g} % may be: expose less")
    if share > SATURATED_TOLD:
        warnings.warn(f"{said}; they are left out: expose less", SaturationWarning, stacklevel=3)


def validate_same_pitch(frames: Sequence[Frame], lens: Lens) -> None:
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


def frames_by_plane(frames: Sequence[Frame]) -> list[tuple[Frame, ...]]:
    """Frames of one plane together, in the order of the planes' distances."""

    def distance(frame: Frame) -> float:
        return frame.settings.plane_distance_mm

    return [tuple(group) for _, group in groupby(sorted(frames, key=distance), key=distance)]


def planes_of_frames(frames: Sequence[Frame]) -> tuple[PlaneFrames, ...]:
    """What is told of each plane beside its intensity, in the order of the planes' distances."""
    return tuple(
        PlaneFrames(
            plane[0].settings.plane_distance_mm,
            tuple(sorted(frame.settings.exposure for frame in plane)),
            float(np.mean(clipped_in_all(plane))),
        )
        for plane in frames_by_plane(frames)
    )


def recorded_planes(frames: Sequence[Frame]) -> list[Measurement]:
    """Amplitudes and what noise leaves of them, at distances from the nearest plane; in single precision.

    Frames of one plane become one intensity, each pixel of which takes from every frame what it tells
    (:func:`wavesim.sensor.exposures.merged_intensity`).
    """
    by_plane = frames_by_plane(frames)
    first = by_plane[0][0].settings.plane_distance_mm
    return [_recorded(plane, plane[0].settings.plane_distance_mm - first) for plane in by_plane]


def _recorded(plane: Sequence[Frame], distance_mm: float) -> Measurement:
    shape = plane[0].counts.shape
    amplitude, sigma = np.empty(shape, np.float32), np.empty(shape, np.float32)

    def rows(start: int, stop: int) -> None:
        part = recorded_intensity(distance_mm, *merged_intensity(plane, slice(start, stop)))
        amplitude[start:stop], sigma[start:stop] = part.amplitude, part.sigma

    for_blocks(rows, len(amplitude), ROWS)
    return Measurement(distance_mm, amplitude, sigma)
