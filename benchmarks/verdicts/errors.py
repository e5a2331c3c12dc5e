"""Errors of frames: what a lab can do to them after, or while, they are recorded."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks.verdicts.benches import BenchFrames
from wavesim.sensor.camera_noise import Electronics, expose
from wavesim.sensor.frames import Frame

Frames = Sequence[Frame]
Counts = NDArray[Any]

TURNS: dict[str, Callable[[Counts], Counts]] = {
    "as it is": lambda counts: counts,
    "shifted by 3 px": lambda counts: np.roll(counts, 3, axis=1),
    "shifted by 20 px": lambda counts: np.roll(counts, (20, -20), axis=(0, 1)),
    "mirrored": lambda counts: counts[:, ::-1],
    "rotated by 90°": lambda counts: np.rot90(counts),
    "rotated by 180°": lambda counts: counts[::-1, ::-1],
    "transposed": lambda counts: counts.T,
}
"""What a plane's picture is made into."""


def with_counts(frame: Frame, counts: Any) -> Frame:
    """Return a frame with other counts, rounded and within its bits."""
    whole = np.clip(np.rint(counts), 0, frame.settings.top_counts).astype(np.uint16)
    return replace(frame, counts=np.ascontiguousarray(whole))


def changed(frames: Frames, change: Callable[[Counts], Any], plane: int | None = None) -> list[Frame]:
    """Return frames whose counts are changed, of all planes or of one (its index)."""
    planes = plane_distances(frames)
    return [
        with_counts(frame, change(frame.counts))
        if plane is None or frame.settings.plane_distance_mm == planes[plane]
        else frame
        for frame in frames
    ]


def stating(frames: Frames, **settings: Any) -> list[Frame]:
    """Return frames that state other settings; a function is given what the frame states."""
    return [
        replace(
            frame,
            settings=frame.settings.replaced(
                **{
                    name: value(getattr(frame.settings, name)) if callable(value) else value
                    for name, value in settings.items()
                }
            ),
        )
        for frame in frames
    ]


def plane_distances(frames: Frames) -> list[float]:
    """Return the distances of the planes, increasing."""
    return sorted({frame.settings.plane_distance_mm for frame in frames})


def on_plane(frames: Frames, plane: int) -> list[Frame]:
    """Return the frames of a plane (its index)."""
    distance = plane_distances(frames)[plane]
    return [frame for frame in frames if frame.settings.plane_distance_mm == distance]


def at_planes(frames: Frames, *planes_mm: float) -> list[Frame]:
    """Return frames that state other distances of their planes, in the order of the planes."""
    stated = dict(zip(plane_distances(frames), planes_mm, strict=True))
    return stating(frames, plane_distance_mm=stated.__getitem__)


def smoothed(frames: Frames, sigma_px: float) -> list[Frame]:
    """Return frames that a Gaussian filter has smoothed."""
    return changed(frames, lambda counts: gaussian_filter(counts.astype(float), sigma_px))


def with_gamma(frames: Frames, gamma: float) -> list[Frame]:
    """Return frames whose counts were encoded for a screen."""
    top = frames[0].settings.top_counts
    return changed(frames, lambda counts: top * (counts / top) ** (1.0 / gamma))


def clipped(frames: Frames, share: float) -> list[Frame]:
    """Return frames that are clipped at a share of the top count, and do not say so."""
    return changed(frames, lambda counts: np.minimum(counts, share * frames[0].settings.top_counts))


def quantised(frames: Frames, bits: int) -> list[Frame]:
    """Return frames of which the lower bits are lost."""
    step = 2 ** (frames[0].settings.bits - bits)
    return changed(frames, lambda counts: counts // step * step)


def with_hot_pixels(frames: Frames, count: int, seed: int = 5) -> list[Frame]:
    """Return frames in which the same pixels are bright, each with its own count."""
    rng, shape = np.random.default_rng(seed), frames[0].counts.shape
    where = tuple(rng.integers(0, side, count) for side in shape)
    level = rng.uniform(0.1, 1.0, count) * frames[0].settings.top_counts

    def hot(counts: Counts) -> Counts:
        made = counts.astype(float)
        made[where] = np.maximum(made[where], level)
        return made

    return changed(frames, hot)


def with_cosmic_rays(frames: Frames, count: int, seed: int = 6) -> list[Frame]:
    """Return frames with short bright tracks in other places of each frame."""
    rng, (rows, columns) = np.random.default_rng(seed), frames[0].counts.shape

    def hit(counts: Counts) -> Counts:
        made = counts.astype(float)
        for _ in range(count):
            row, column, length = rng.integers(rows), rng.integers(columns), rng.integers(1, 4)
            made[row, column : column + length] += rng.uniform(300.0, 4000.0)
        return made

    return changed(frames, hit)


def exposed(
    frames: Frames, intensities: Sequence[NDArray[Any]], seed: int = 7, shares: Sequence[float] | None = None
) -> list[Frame]:
    """Return frames of given intensities on their planes, exposed as stated.

    With `shares`, the frames of each plane are exposed, and state that they are, by a share of the time.
    """
    made, planes = [], plane_distances(frames)
    for number, frame in enumerate(frames):
        plane = planes.index(frame.settings.plane_distance_mm)
        share = 1.0 if shares is None else shares[plane]
        own = frame.settings.replaced(exposure=share * frame.settings.exposure)
        electronics = Electronics(
            read_noise_electrons=own.read_noise_electrons,
            bits=own.bits,
            offset_counts=own.offset_counts,
            gain_electrons_per_count=own.gain_electrons_per_count,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            noise = np.random.SeedSequence((seed, number))
            made.append(Frame(expose(intensities[plane], own.exposure, electronics, noise), own))
    return made


def vibrating(bench: BenchFrames, sigma_um: float, **changes: Any) -> list[Frame]:
    """Return frames recorded while the sensor vibrates, by a normal law, about its place."""
    sigma_px = sigma_um / bench.lens.sensor.pixel_pitch_um
    blurred = [gaussian_filter(one, sigma_px) for one in bench.intensities(**changes)]
    return exposed(bench.frames(**changes), blurred)


def weak_second_plane(bench: BenchFrames, share: float) -> list[Frame]:
    """Return frames whose second plane has one exposure: a share of the shortest one of the first plane."""
    frames = bench.frames()
    first, second = on_plane(frames, 0), on_plane(frames, 1)
    short = exposed([*first, second[0]], bench.intensities(), shares=(1.0, share))
    return [*first, short[-1]]


def with_second_plane(frames: Frames, others: Frames) -> list[Frame]:
    """Return frames whose second plane is that of other frames."""
    return [*on_plane(frames, 0), *on_plane(others, 1)]


def first_plane_twice(frames: Frames, others: Frames) -> list[Frame]:
    """Return frames whose second plane holds the pictures that other frames have on their first one."""
    distance = plane_distances(frames)[1]
    return [*on_plane(frames, 0), *stating(on_plane(others, 0), plane_distance_mm=distance)]
