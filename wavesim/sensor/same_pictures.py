"""Pictures of different planes that are the same: a plane was recorded or copied twice.

Light that travels from one plane to another changes its picture by far more than noise, where the distance is
long enough for the planes to determine a phase. Two pictures that differ by noise alone belong to one plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from lensdesign.errors import InputError
from wavesim.runtime.threads import row_blocks
from wavesim.sensor.exposures import merged_intensity
from wavesim.sensor.frames import Frame

ROWS = 1000
"""Rows of a frame that are compared, at most."""

NOISE, RELATIVE = 1.15, 0.01
"""Mean square difference of two pictures over that of their noise, up to which they are the same; and
relative difference of their intensities beyond the noise, which drift of light brings."""

STRUCTURE = 3.0
"""Mean square intensity about the mean, over that of the noise, from which on a picture is not noise."""


def validate_distinct_pictures(by_plane: Sequence[Sequence[Frame]], *, diverse: bool) -> None:
    """Refuse frames of different planes that hold one picture.

    Parameters
    ----------
    by_plane
        Frames of each plane.
    diverse
        Whether the planes are so far from each other that propagation changes pictures by more than noise.
        Where they are not, only bit-identical pictures are refused.

    Raises
    ------
    InputError
        Naming the planes.
    """
    for one, other in combinations(by_plane, 2):
        planes = " and ".join(f"{frames[0].settings.plane_distance_mm:g} mm" for frames in (one, other))
        if any(_identical(a, b) for a in one for b in other):
            raise InputError(
                f"planes at {planes}: frames of both hold the same picture, bit by bit: each plane must have "
                "been recorded by itself"
            )
        if diverse and one[0].counts.shape == other[0].counts.shape and _alike(one, other):
            raise InputError(
                f"planes at {planes}: their pictures are the same within the noise, which light that travels "
                "so far cannot be: one of them was recorded or copied twice, or the sensor was not moved"
            )


def _identical(one: Frame, other: Frame) -> bool:
    return bool(np.ptp(one.counts)) and np.array_equal(one.counts, other.counts)


def _alike(one: Sequence[Frame], other: Sequence[Frame]) -> bool:
    """Whether two pictures differ by a factor and noise alone, and show more than noise."""
    rows = len(one[0].counts)
    every = 1 + rows // ROWS
    pairs = []
    for block in row_blocks(rows):
        part = slice(block.start, block.stop, every)
        (a, a_variance), (b, b_variance) = merged_intensity(one, part), merged_intensity(other, part)
        known = np.isfinite(a_variance) & np.isfinite(b_variance)
        pairs.append(np.stack([values[known] for values in (a, a_variance, b, b_variance)]))
    a, a_variance, b, b_variance = np.concatenate(pairs, axis=1)
    if a.size == 0 or not b.sum() > 0.0:
        return False
    factor = a.sum() / b.sum()
    variance = a_variance + factor**2 * b_variance
    difference = (a - factor * b) ** 2
    structure = float(np.mean((a - a.mean()) ** 2 / variance))
    excess = max(float(np.sum(difference - variance)), 0.0) / float(np.sum(a**2))
    return structure > STRUCTURE and (float(np.mean(difference / variance)) < NOISE or excess < RELATIVE**2)
