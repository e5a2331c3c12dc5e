"""Similarity of two pictures: PSNR and structural similarity, computed in blocks of rows.

References
----------
Z. Wang, A. C. Bovik, H. R. Sheikh and E. P. Simoncelli, "Image quality assessment: from error visibility to
structural similarity", IEEE Trans. Image Process. 13, 600 (2004).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive
from wavesim.runtime.threads import row_blocks

Picture = NDArray[Any]
Mask = NDArray[np.bool_]

LEAST_SAMPLES = 11
"""Least number of samples along each side of pictures whose structural similarity is defined."""


def psnr_db(found: Picture, truth: Picture, *, full_scale: float = 1.0, support: Mask | None = None) -> float:
    """Return the peak signal-to-noise ratio in dB: full scale over the root mean square difference.

    Parameters
    ----------
    found, truth
        Pictures of one quantity and scale; of complex values the modulus is used.
    full_scale
        Range of the quantity; 1 for a transmission.
    support
        Mask of the samples that count. Default: all samples.

    Returns
    -------
    float
        Ratio in dB; infinite if both pictures are equal.

    Raises
    ------
    InputError
        If shapes differ, values are not finite, or the support is empty.
    """
    a, b, inside = _pair(found, truth, full_scale, support)
    missed = 0.0
    for rows in row_blocks(len(a)):
        difference = np.subtract(b[rows][inside[rows]], a[rows][inside[rows]], dtype=float)
        missed += float(difference @ difference)
    square = missed / np.count_nonzero(inside)
    return 10.0 * math.log10(full_scale**2 / square) if square > 0.0 else math.inf


def ssim(found: Picture, truth: Picture, *, full_scale: float = 1.0, support: Mask | None = None) -> float:
    """Return the structural similarity (Wang et al. 2004), with Gaussian windows of 1.5 samples.

    Parameters
    ----------
    found, truth, full_scale
        As in :func:`psnr_db`; the pictures have at least 11 x 11 samples.
    support
        Mask of the samples whose windows count. Default: all samples.

    Returns
    -------
    float
        Similarity; 1 if both pictures are equal.

    Raises
    ------
    InputError
        If shapes differ or are too small, values are not finite, or the support is empty.
    """
    from skimage.metrics import structural_similarity

    a, b, inside = _pair(found, truth, full_scale, support)
    if a.ndim != 2 or min(a.shape) < LEAST_SAMPLES:
        raise InputError(
            f"ssim of pictures of shape {a.shape}: must be planes of at least {LEAST_SAMPLES} x "
            f"{LEAST_SAMPLES} samples"
        )
    total = 0.0
    # Samples that a window of the structural similarity reaches to either side.
    ssim_reach = 5
    for rows in row_blocks(len(a)):
        wider = slice(max(min(rows.start, len(a) - 11) - ssim_reach, 0), rows.stop + 11)
        _, similarity = structural_similarity(
            b[wider].astype(float),
            a[wider].astype(float),
            data_range=full_scale,
            gaussian_weights=True,
            use_sample_covariance=False,
            full=True,
        )
        own = slice(rows.start - wider.start, rows.stop - wider.start)
        total += float(np.sum(similarity[own][inside[rows]]))
    return total / np.count_nonzero(inside)


def _pair(
    found: Picture, truth: Picture, full_scale: float, support: Mask | None
) -> tuple[Array, Array, Mask]:
    if found.shape != truth.shape:
        raise InputError(f"pictures of shapes {found.shape} and {truth.shape}: must be the same")
    validate_positive("full_scale", full_scale)
    inside = np.ones(found.shape, bool) if support is None else np.asarray(support, bool)
    if inside.shape != found.shape or not inside.any():
        raise InputError("support: must be of the pictures' shape, and not empty")
    a, b = (np.abs(one) if np.iscomplexobj(one) else np.asarray(one) for one in (found, truth))
    a, b = (one if one.dtype in (np.float32, np.float64) else one.astype(float) for one in (a, b))
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
        raise InputError("pictures hold values that are not finite")
    return a, b, inside
