"""Detection of planes with the same picture: one plane was recorded or copied twice.

If two planes are far enough apart to determine a phase, propagation changes the picture by far more than the
noise. Two pictures that differ only by noise therefore belong to the same plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from lensdesign.errors import InputError
from wavesim.runtime.threads import row_blocks
from wavesim.sensor.frames import Frame
from wavesim.sensor.merged_exposures import merged_intensity

NOISE, RELATIVE = 1.15, 0.01
"""Two pictures are the same up to this mean square difference over that of their noise, or up to this
relative difference beyond the noise, which a drift of the light causes."""


def validate_distinct_frames(by_plane: Sequence[Sequence[Frame]], *, diverse: bool) -> None:
    """Check that frames of different planes do not show the same picture.

    Parameters
    ----------
    by_plane
        Frames of each plane, one sequence per plane.
    diverse
        Whether propagation between the planes changes the picture by more than the noise. If not, only
        bit-identical pictures are an error.

    Raises
    ------
    InputError
        If two planes show the same picture; the message names them.
    """
    for one, other in combinations(by_plane, 2):
        planes = " and ".join(f"{frames[0].settings.plane_distance_mm:g} mm" for frames in (one, other))
        if any(_identical(a, b) for a in one for b in other):
            raise InputError(
                f"planes at {planes}: frames of both contain the same picture, bit by bit: each plane must "
                "be recorded separately"
            )
        if diverse and one[0].counts.shape == other[0].counts.shape and _alike(one, other):
            raise InputError(
                f"planes at {planes}: their pictures are the same within the noise, although propagation "
                "over this distance changes a picture: one of them was recorded or copied twice, or the "
                "sensor was not moved"
            )


def _identical(one: Frame, other: Frame) -> bool:
    return bool(np.ptp(one.counts)) and np.array_equal(one.counts, other.counts)


def _alike(one: Sequence[Frame], other: Sequence[Frame]) -> bool:
    """Return True if two pictures differ only by a factor and noise, and show more than noise."""
    rows = len(one[0].counts)
    # Largest number of rows of a frame that are compared.
    most_rows = 1000
    every = 1 + rows // most_rows
    pairs = []
    for block in row_blocks(rows):
        sampled = slice(block.start, block.stop, every)
        (a, a_variance), (b, b_variance) = merged_intensity(one, sampled), merged_intensity(other, sampled)
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
    # Variance of the intensity over that of the noise, above which a picture shows more than noise.
    least_structure = 3.0
    return structure > least_structure and (
        float(np.mean(difference / variance)) < NOISE or excess < RELATIVE**2
    )
