"""Compiled loops over pixels: intensity from several exposures, contradicting frames, hot and dead pixels."""

# mypy: disable-error-code="misc"

from __future__ import annotations

from numpy import empty, inf, sqrt, zeros
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit

_jit = cached_njit(nogil=True, error_model="numpy")


@_jit
def merged(
    electrons: NDArray,
    known: NDArray,
    relative_exposures: NDArray,
    fixed: NDArray,
    intensity: NDArray,
    variance: NDArray,
) -> None:
    """Fill `intensity` with means weighted by inverse variances, or the first frame's value if unknown."""
    frames, height, width = electrons.shape
    for i in range(height):
        for j in range(width):
            electrons_sum = exposure_sum = 0.0
            for k in range(frames):
                if known[k, i, j]:
                    electrons_sum += electrons[k, i, j]
                    exposure_sum += relative_exposures[k, i, j]
            if exposure_sum == 0.0:
                intensity[i, j], variance[i, j] = electrons[0, i, j] / relative_exposures[0, i, j], inf
                continue
            level = max(electrons_sum, 0.0) / exposure_sum
            weight_sum = mean = 0.0
            for k in range(frames):
                if known[k, i, j]:
                    exposure = relative_exposures[k, i, j]
                    weight = exposure / (level * exposure + fixed[k])
                    weight_sum += weight * exposure
                    mean += weight * electrons[k, i, j]
            mean /= weight_sum
            level, inverse_variance = max(mean, 0.0), 0.0
            for k in range(frames):
                if known[k, i, j]:
                    exposure = relative_exposures[k, i, j]
                    inverse_variance += exposure * exposure / (level * exposure + fixed[k])
            intensity[i, j], variance[i, j] = mean, 1.0 / inverse_variance


@_jit
def contradicting(
    electrons: NDArray, known: NDArray, relative_exposures: NDArray, fixed: NDArray, far: float, unlike: float
) -> NDArray:
    """Return the mask of pixels whose intensities in two consecutive frames differ too much."""
    frames, height, width = electrons.shape
    found = zeros((height, width), dtype="?")
    for k in range(frames - 1):
        for i in range(height):
            for j in range(width):
                if not (known[k, i, j] and known[k + 1, i, j]):
                    continue
                own, other = relative_exposures[k, i, j], relative_exposures[k + 1, i, j]
                one, two = electrons[k, i, j], electrons[k + 1, i, j]
                noise = (max(one, 0.0) + fixed[k]) / (own * own)
                noise += (max(two, 0.0) + fixed[k + 1]) / (other * other)
                one, two = one / own, two / other
                level = unlike * max(abs(one), abs(two))
                found[i, j] |= abs(one - two) > far * sqrt(noise) + level
    return found


@_jit
def outlying_pixels(
    intensity: NDArray,
    variance: NDArray,
    times: float,
    far: float,
    dead: float,
    dead_noise: float,
    lit: float,
) -> NDArray:
    """Return masks (3, ny, nx): far above all eight neighbours, lit, and dark among lit neighbours."""
    height, width = intensity.shape
    found = empty((3, height, width), dtype="?")
    for i in range(height):
        for j in range(width):
            low, high = inf, -inf
            # Values are repeated beyond the border: a pixel on the border is its own neighbour.
            for row in range(i - 1, i + 2):
                for column in range(j - 1, j + 2):
                    if row == i and column == j:
                        continue
                    value = intensity[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]
                    low, high = min(low, value), max(high, value)
            own, deviation = intensity[i, j], sqrt(variance[i, j])
            found[0, i, j] = own > times * max(high, 0.0) and own > far * deviation
            found[1, i, j] = own > far * deviation
            found[2, i, j] = own < dead * low + dead_noise * deviation and low > lit * deviation
    return found
