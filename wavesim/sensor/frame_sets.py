"""Frames of one object on several planes: reading, consistency checks, and merging of exposures.

Several frames of one plane (different exposures, or repeats) are merged into one intensity.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.runtime.threads import for_blocks, row_blocks
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.settings import FrameSetSettings, SettingError
from wavesim.sensor.camera_checks import clipping_counts, contradicts_black_level, dark_part
from wavesim.sensor.camera_noise import SaturationWarning
from wavesim.sensor.frames import Frame, read_frame
from wavesim.sensor.measurement import Measurement, recorded_intensity
from wavesim.sensor.merged_exposures import (
    clipped_in_all,
    electrons_of,
    fixed_variance,
    fraction_per_intensity,
    known_in,
    merged_intensity,
)
from wavesim.sensor.orientations import ORIENTATIONS
from wavesim.sensor.pixels.bad_pixels import find_bad_pixels
from wavesim.sensor.pixels.maps import PixelMaps, read_pixel_maps

SATURATED_WARNING, SATURATED_ERROR = 1e-5, 0.02
"""Fractions of a plane's pixels that are clipped in all of its frames: the first causes a warning, the
second an error."""

LEAST_SIGNAL = 6.0
"""Least excess of the brightest pixel over the dark count, in standard deviations of a dark pixel."""

OTHER_PICTURE, SURE = 0.05, 6.0
"""Two frames of one plane show different pictures if their mean square difference, less that of the noise,
exceeds this fraction of the mean square intensity and this number of standard deviations."""

SAME_EXPOSURE, LARGEST_EXPOSURE_ERROR = 3e-3, 0.3
"""Range of relative exposure errors that are corrected with a warning. Above it, the frames are not exposures
of the same light."""

LEAST_VISIBLE, NOT_CLIPPED = 20.0, 0.9
"""Pixels that determine an exposure ratio: least signal in standard deviations of a dark pixel, and largest
fraction of the clipping level."""

COMPARED = 4_000_000
"""Approximate number of pixels compared between two frames of one plane; larger frames are subsampled."""


class BadPixelWarning(UserWarning):
    """Warning that hot or dead pixels were found and are ignored."""


class ExposureWarning(UserWarning):
    """Warning that the light of a frame contradicts its stated exposure, which is corrected."""


@dataclass(frozen=True)
class PlaneFrames:
    """Recording conditions of the frames of one plane.

    Attributes
    ----------
    distance_mm : float
        Distance of the plane from the exit vertex.
    exposures : tuple of float
        Exposures of the frames, increasing.
    saturated_share : float
        Fraction of the pixels that are clipped in all frames.
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
    """Read frames, and check that they belong together.

    Parameters
    ----------
    paths
        TIFF or PNG files.
    settings
        Settings of the recording, which override those in the files. Default: `FrameSetSettings()`.
    lens
        Design that supplies missing values: the pixel pitch; the wavelength, if the design has one; and the
        plane distances in the order of the files, if their numbers agree.
    assumed
        Values, by setting, that are used with a warning if no other source states them.
    **changes
        Settings by name, which replace those of `settings`.

    Returns
    -------
    tuple of Frame
        The frames in the order of their plane distances, then of their exposures. They have pixel maps and
        corrected exposures.

    Raises
    ------
    InputError
        If a file cannot be read or is named twice, if a frame is empty, if its darkest pixels contradict the
        stated offset, or if a plane is saturated in all of its frames. Also if two frames differ in size,
        pitch or wavelength, if frames of one plane show different pictures, or if there are not as many
        distances or exposures as frames.

    Warns
    -----
    SaturationWarning
        If a few pixels are clipped in all frames of a plane, or a frame is clipped below its largest count.
    BadPixelWarning, ExposureWarning
        If pixels are hot or dead, or exposures differ from the stated ones.
    AssumedWarning
        For each frame with values that the design or `assumed` supplied.

    Examples
    --------
    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image, read_frames, write_frame
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> taken = image(lens, "star", patch_mm=0.03, planes_mm=(0.03, 0.3), engine="eikonal", error=0.1)
    >>> paths = [folder / "near.tif", folder / "far.tif"]  # any folder
    >>> for frame, path in zip(taken.frames, paths):
    ...     write_frame(frame, path)
    >>> [frame.settings.plane_distance_mm for frame in read_frames(paths)]
    [0.03, 0.3]
    """
    settings = (settings or FrameSetSettings()).replaced(**changes)
    if lens is not None:
        validate_lengths(lens, settings)
    given = _given(len(paths), settings)
    for index, path in enumerate(paths):
        if path in paths[:index]:
            raise InputError(f"{path}: is named twice: name each frame once")
    defaults = [dict(assumed or {}) | values for values in _assumed(len(paths), lens)]
    read = [read_frame(path, known, **own) for path, known, own in zip(paths, defaults, given, strict=True)]
    read = [_with_clipping(path, frame) for path, frame in zip(paths, read, strict=True)]
    _check_consistent(paths, read)
    order = sorted(
        zip(paths, read, strict=True),
        key=lambda pair: (pair[1].settings.plane_distance_mm, pair[1].settings.exposure),
    )
    ordered_paths = [path for path, _ in order]
    frames = _without_bad(_with_maps(ordered_paths, [frame for _, frame in order], settings))
    _check_black_level(ordered_paths, frames)
    checked = []
    for _, group in groupby(
        zip(ordered_paths, frames, strict=True), key=lambda pair: pair[1].settings.plane_distance_mm
    ):
        plane = _with_true_exposures(list(group))
        for shorter, longer in pairwise(plane):
            _check_same_picture(shorter, longer)
        _check_saturation(plane)
        checked += [frame for _, frame in plane]
    return tuple(checked)


def read_colour_frames(
    paths: Sequence[Path],
    settings: FrameSetSettings | None = None,
    *,
    lens: Lens | None = None,
    **changes: Any,
) -> tuple[Frame, ...]:
    """Read frames of several wavelengths, and check that those of the same wavelengths belong together.

    Parameters
    ----------
    paths, settings, lens, **changes
        See :func:`read_frames`. Lengths and exposures of frames are in the order of all paths.

    Returns
    -------
    tuple of Frame
        The frames of one wavelength after the other, or of those that were recorded at once; the frames of
        each are ordered as by :func:`read_frames`.

    Raises
    ------
    InputError
        See :func:`read_frames`.

    Examples
    --------
    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image, write_frame
    >>> from wavesim.sensor import read_colour_frames
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> light = {"wavelengths_um": (0.532, 0.635), "engine": "eikonal", "error": 0.1}
    >>> taken = image(lens, "star", patch_mm=0.03, planes_mm=(0.03,), **light)
    >>> write_frame(taken.frames[0], folder / "both.tif")  # any folder
    >>> read_colour_frames([folder / "both.tif"])[0].settings.wavelengths_um
    (0.532, 0.635)
    """
    settings = (settings or FrameSetSettings()).replaced(**changes)
    given = _given(len(paths), settings)
    defaults = _assumed(len(paths), lens)
    groups: dict[str, list[int]] = {}
    for index, (path, known, own) in enumerate(zip(paths, defaults, given, strict=True)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the frames are read again, and then warn
            frame = read_frame(path, known, **own)
        colours = frame.settings.colours
        light = f"{frame.settings.wavelength_um:.12g} {colours and colours.model_dump_json()}"
        groups.setdefault(light, []).append(index)
    frames = list[Frame]()
    for indices in groups.values():
        lists = {"plane_distance_mm": settings.plane_distance_mm, "exposure": settings.exposure}
        own_lists = {
            name: tuple(all_[n] for n in indices) for name, all_ in lists.items() if all_ is not None
        }
        frames += read_frames([paths[n] for n in indices], settings.replaced(**own_lists), lens=lens)
    return tuple(frames)


def _with_clipping(path: Path, frame: Frame) -> Frame:
    """Return a frame with the count at which the camera has clipped it."""
    clipped = clipping_counts(frame)
    if clipped is None:
        return frame
    count, top = int(np.count_nonzero(frame.counts == clipped)), frame.settings.top_counts
    warnings.warn(
        f"{path}: {count} pixels share the largest count, {clipped} of {top}, as if the camera clips there: "
        f"they count as saturated; state saturation_counts (--saturation-counts) {clipped}, or {top} if it "
        "does not clip",
        SaturationWarning,
        stacklevel=3,
    )
    return replace(frame, settings=frame.settings.replaced(saturation_counts=clipped))


def _check_black_level(paths: Sequence[Path], frames: Sequence[Frame]) -> None:
    """Raise InputError if the darkest pixels of a frame contradict the stated black level."""
    for path, frame in zip(paths, frames, strict=True):
        dark = dark_part(frame)
        if dark is None or not contradicts_black_level(frame, dark):
            continue
        own = frame.settings
        noise = math.sqrt(dark.variance) / own.gain_electrons_per_count
        relation = (
            "less than without light"
            if dark.electrons < 0.0
            else "more than without light, yet without the noise of light"
        )
        raise SettingError(
            f"{path}: {{offset_counts}} = {own.offset_counts:g}: the darkest tenth of the picture has a mean "
            f"of {dark.counts:.5g} counts (standard deviation of a pixel {noise:.2g}), {relation}; give the "
            f"black level, such as {{offset_counts}} {dark.counts:.4g}; if it is right, check "
            "{gain_electrons_per_count} and {read_noise_electrons}"
        )


def _with_maps(paths: Sequence[Path], frames: Sequence[Frame], settings: FrameSetSettings) -> list[Frame]:
    """Return the frames with the pixel maps that the settings name."""
    own = frames[0].settings
    maps = read_pixel_maps(
        frames[0].counts.shape,
        own.offset_counts,
        own.gain_electrons_per_count,
        flat=settings.flat,
        dark=settings.dark,
        bad=settings.bad_pixels,
        filters=None if own.colours is None else own.colours.letters_on_pixels(frames[0].counts.shape),
    )
    if maps is None:
        return list(frames)
    if maps.dark_electrons is not None:
        dark = own.offset_counts + float(maps.dark_electrons.mean()) / own.gain_electrons_per_count
        for path, frame in zip(paths, frames, strict=True):
            if dark > float(frame.counts.mean()):
                raise InputError(
                    f"{settings.dark}: mean of {dark:.4g} counts, more than the {frame.counts.mean():.4g} of "
                    f"{path}; must be a picture without light"
                )
    return [replace(frame, maps=maps) for frame in frames]


def _without_bad(frames: Sequence[Frame]) -> list[Frame]:
    """Return the frames with hot and dead pixels marked as bad."""
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
            "dead; they are ignored",
            BadPixelWarning,
            stacklevel=3,
        )
        maps = replace(maps, bad=found if maps.bad is None else found | maps.bad)
        result += [replace(frame, maps=maps) for frame in plane]
    return result


def _with_true_exposures(plane: Sequence[tuple[Path, Frame]]) -> list[tuple[Path, Frame]]:
    """Return frames of one plane with exposures corrected to their light, relative to the shortest."""
    result = [plane[0]]
    for path, frame in plane[1:]:
        factor, deviation = _exposure_ratio(result[-1][1], frame)
        error = abs(factor - 1.0)
        if max(SAME_EXPOSURE, SURE * deviation) < error <= LARGEST_EXPOSURE_ERROR:
            warnings.warn(
                f"{path}: is {100.0 * (factor - 1.0):+.2g} % brighter than its exposure states, relative to "
                f"{result[-1][0]}: the exposure is corrected",
                ExposureWarning,
                stacklevel=3,
            )
            settings = frame.settings.replaced(exposure=factor * frame.settings.exposure)
            frame = replace(frame, settings=settings)
        result.append((path, frame))
    return result


def _exposure_ratio(short: Frame, long: Frame) -> tuple[float, float]:
    """Return the light ratio of two frames over their stated exposure ratio, and its standard deviation."""
    ratio = long.settings.exposure / short.settings.exposure
    highest_counts = NOT_CLIPPED * (long.settings.clipped_counts - long.settings.offset_counts)
    most = highest_counts * long.settings.gain_electrons_per_count
    least = LEAST_VISIBLE * math.sqrt(fixed_variance(short) + 1.0)
    shorter = longer = scatter = 0.0
    every = 1 + short.counts.size // COMPARED
    for block in row_blocks(len(short.counts)):
        rows = slice(block.start, block.stop, every)
        long_electrons = electrons_of(long, rows)
        # The frame with less noise selects the pixels: a selection by the noisier one would bias the ratio.
        selected = known_in(short, rows) & known_in(long, rows)
        selected &= (long_electrons > least * ratio) & (long_electrons < most)
        short_electrons = electrons_of(short, rows)[selected]
        shorter += float(short_electrons.sum())
        longer += float(long_electrons[selected].sum()) / ratio
        scatter += float(
            np.sum(np.maximum(short_electrons, 0.0) * (1.0 + 1.0 / ratio) + fixed_variance(short))
        )
    return (longer / shorter, math.sqrt(scatter) / shorter) if shorter > 0.0 else (1.0, math.inf)


def _given(count: int, settings: FrameSetSettings) -> list[dict[str, Any]]:
    """Return, for each frame, the values that the settings state for it."""
    stated = settings.model_dump(exclude_none=True, exclude={"flat", "dark", "bad_pixels"})
    for name in ("plane_distance_mm", "exposure"):
        if name in stated and len(stated[name]) != count:
            values = ",".join(f"{value:g}" for value in stated[name])
            raise SettingError(f"{{{name}}} = {values!r}: must be {count} numbers, one for each frame")
    return [
        {name: value[frame] if isinstance(value, tuple) else value for name, value in stated.items()}
        for frame in range(count)
    ]


def _assumed(count: int, lens: Lens | None) -> list[dict[str, Any]]:
    """Return, for each frame, the values that the design supplies."""
    if lens is None:
        return [{}] * count
    values: dict[str, Any] = {"pixel_pitch_um": lens.sensor.pixel_pitch_um}
    if len(lens.wavelengths_um) == 1:
        values["wavelength_um"] = lens.wavelengths_um[0]
    planes = lens.sensor.plane_distances_mm
    if len(planes) != count:
        return [values] * count
    return [values | {"plane_distance_mm": distance} for distance in planes]


def _check_consistent(paths: Sequence[Path], frames: Sequence[Frame]) -> None:
    """Raise InputError for frames of different size, pitch or wavelength, and for frames without light."""
    first = frames[0]
    for path, frame in zip(paths, frames, strict=True):
        size, first_size = frame.counts.shape[::-1], first.counts.shape[::-1]
        if size != first_size:
            raise InputError(
                f"{path}: {size[0]} x {size[1]} pixels; {paths[0]} has {first_size[0]} x {first_size[1]}: "
                "frames that are used together must have the same size"
            )
        for name in ("pixel_pitch_um", "wavelength_um"):
            one, other = getattr(frame.settings, name), getattr(first.settings, name)
            if not math.isclose(one, other, rel_tol=1e-6):
                raise InputError(
                    f"{path}: {name} = {one:g}; that of {paths[0]} is {other:g}: must be the same"
                )
        if frame.settings.colours != first.settings.colours:
            raise InputError(
                f"{path}: wavelengths or colour filters differ from those of {paths[0]}: must be equal"
            )
        brightest, settings = int(frame.counts.max()), frame.settings
        dark = math.sqrt(fixed_variance(frame)) / settings.gain_electrons_per_count
        if brightest < settings.offset_counts + LEAST_SIGNAL * dark:
            raise InputError(
                f"{path}: contains no light: the brightest pixel has {brightest} counts, and offset_counts = "
                f"{settings.offset_counts:g}"
            )


def _check_same_picture(shorter: tuple[Path, Frame], longer: tuple[Path, Frame]) -> None:
    """Raise InputError if two frames that state one plane cannot be exposures of one intensity."""
    (path, short), (other, long) = shorter, longer
    difference = _difference(short, long)
    if not difference.is_sure:
        return
    orientation = _better_orientation(short, long, difference)
    if orientation or difference.excess > OTHER_PICTURE * difference.size:
        raise InputError(
            f"{path} and {other}: both state plane_distance_mm = {short.settings.plane_distance_mm:g}, but "
            "show different intensities: frames of one plane must be exposures of the same light, of which "
            f"each states its exposure{orientation or _dark_counts(short, long)}"
        )


class _Difference(NamedTuple):
    """Difference of two exposures of a plane.

    Attributes
    ----------
    excess : float
        Sum of squared differences, less that of the noise.
    deviation : float
        Standard deviation of the excess due to noise.
    size : float
        Sum of squares of the larger signal.
    """

    excess: float
    deviation: float
    size: float

    @property
    def is_sure(self) -> bool:
        """Whether noise cannot be the difference."""
        return self.excess > SURE * self.deviation


def _difference(short: Frame, long: Frame) -> _Difference:
    """Return the difference of two exposures of a plane.

    The comparison uses pixels that are not clipped in either, in electrons of the shorter exposure.
    """
    ratio = long.settings.exposure / short.settings.exposure
    excess = scatter = size = 0.0
    threshold = LEAST_SIGNAL * math.sqrt(fixed_variance(short))
    every = 1 + short.counts.size // COMPARED
    for block in row_blocks(len(short.counts)):
        rows = slice(block.start, block.stop, every)
        known = known_in(short, rows) & known_in(long, rows)
        one, two = electrons_of(short, rows), electrons_of(long, rows) / ratio
        # Dark signals differ between pixels and dominate a faint picture. The longer exposure selects the
        # pixels, because a selection by the shorter one would be biased by its noise.
        known &= (two > threshold) | (one > 5.0 * threshold)
        one, two = one[known], two[known]
        noise = np.maximum(two, 0.0) * (1.0 + 1.0 / ratio)
        noise += fixed_variance(short) + fixed_variance(long) / ratio**2
        excess += float(np.sum((one - two) ** 2 - noise))
        scatter += float(np.sum(2.0 * noise**2 + noise))
        size += float(np.sum(np.maximum(np.abs(one), np.abs(two)) ** 2))
    return _Difference(excess, math.sqrt(scatter), size)


def _better_orientation(short: Frame, long: Frame, stated: _Difference) -> str:
    """Return that the second picture agrees with the first one in another orientation; empty if not."""
    # Fraction of the stated orientation's difference, below which another one explains it.
    explained = 0.1
    for name, orientation in ORIENTATIONS.items():
        counts = np.ascontiguousarray(orientation(long.counts))
        if counts.shape != long.counts.shape:
            continue
        if _difference(short, replace(long, counts=counts)).excess < explained * stated.excess:
            return f"; the second picture agrees with the first one if it is {name}"
    return ""


def _dark_counts(short: Frame, long: Frame) -> str:
    """Return the counts of the darkest pixels of two pictures, to be added to a message."""
    darkest = [part.counts for part in (dark_part(short), dark_part(long)) if part is not None]
    if len(darkest) < 2:
        return ""
    return (
        f"; their darkest pixels have {darkest[0]:.4g} and {darkest[1]:.4g} counts, and offset_counts states "
        f"{short.settings.offset_counts:g}"
    )


def _check_saturation(plane: Sequence[tuple[Path, Frame]]) -> None:
    """Warn of pixels that are clipped in all frames of a plane; raise InputError if there are too many."""
    frames = [frame for _, frame in plane]
    fraction = float(np.mean(clipped_in_all(frames)))
    clipped = frames[0].settings.clipped_counts
    named = ", ".join(str(path) for path, _ in plane)
    frames_named = "" if len(plane) == 1 else " in each of these frames of one plane"
    message = f"{named}: {100.0 * fraction:.2g} % of the pixels are saturated{frames_named}"
    message += f", at {clipped} counts or more"
    if fraction > SATURATED_ERROR:
        raise InputError(f"{message}; at most {100.0 * SATURATED_ERROR:g} % may be: reduce the exposure")
    if fraction > SATURATED_WARNING:
        warnings.warn(f"{message}; they are ignored: reduce the exposure", SaturationWarning, stacklevel=3)


def validate_same_pitch(frames: Sequence[Frame], lens: Lens) -> None:
    """Check that the pixels of frames are those of the design's sensor.

    Raises
    ------
    InputError
        If the pitch differs, or a frame has more pixels than the sensor.
    """
    pitch, own = frames[0].settings.pixel_pitch_um, lens.sensor.pixel_pitch_um
    # Relative difference up to which two pixel pitches count as equal.
    same_pitch = 1e-3
    if not math.isclose(pitch, own, rel_tol=same_pitch):
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
    """Return the frames of each plane, ordered by plane distance."""

    def distance(frame: Frame) -> float:
        return frame.settings.plane_distance_mm

    return [tuple(group) for _, group in groupby(sorted(frames, key=distance), key=distance)]


def planes_of_frames(frames: Sequence[Frame]) -> tuple[PlaneFrames, ...]:
    """Return the recording conditions of each plane, ordered by plane distance."""
    return tuple(
        PlaneFrames(
            plane[0].settings.plane_distance_mm,
            tuple(sorted(frame.settings.exposure for frame in plane)),
            float(np.mean(clipped_in_all(plane))),
        )
        for plane in frames_by_plane(frames)
    )


def validate_one_wavelength(frames: Sequence[Frame]) -> None:
    """Check that no frame was recorded at several wavelengths at once, or behind colour filters.

    Raises
    ------
    InputError
        If a frame was; the message names its wavelengths.
    """
    for frame in frames:
        if frame.settings.colours is not None:
            several = ", ".join(f"{one:g}" for one in frame.settings.wavelengths_um)
            raise InputError(
                f"frames: {several} µm were recorded at once: must be one wavelength; use `wavesim colours`"
            )


def recorded_planes(
    frames: Sequence[Frame], *, with_fractions: bool = False, with_colours: bool = False
) -> list[Measurement]:
    """Return amplitude and standard deviation on each plane, in single precision, ordered by plane distance.

    Distances count from the nearest plane. :func:`wavesim.sensor.merged_exposures.merged_intensity` merges
    the frames of one plane.

    Parameters
    ----------
    frames
        Frames of one or more planes.
    with_fractions
        Whether the planes get their `fraction_per_intensity`.
    with_colours
        Whether frames may have several wavelengths, because the caller models all of them.

    Raises
    ------
    InputError
        If frames have several wavelengths without `with_colours`.
    """
    if not with_colours:
        validate_one_wavelength(frames)
    by_plane = frames_by_plane(frames)
    first = by_plane[0][0].settings.plane_distance_mm
    return [
        _recorded(plane, plane[0].settings.plane_distance_mm - first, with_fractions) for plane in by_plane
    ]


def _recorded(plane: Sequence[Frame], distance_mm: float, with_fractions: bool) -> Measurement:
    shape = plane[0].counts.shape
    amplitude, sigma = np.empty(shape, np.float32), np.empty(shape, np.float32)
    fractions = np.empty(shape, np.float32) if with_fractions else None

    def merge_rows(start: int, stop: int) -> None:
        rows = slice(start, stop)
        block = recorded_intensity(distance_mm, *merged_intensity(plane, rows))
        amplitude[rows], sigma[rows] = block.amplitude, block.sigma
        if fractions is not None:
            fractions[rows] = fraction_per_intensity(plane, rows)

    for_blocks(merge_rows, len(amplitude), 64)
    return Measurement(distance_mm, amplitude, sigma, fraction_per_intensity=fractions)
