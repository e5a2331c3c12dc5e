"""Compiled loops of a Fourier transform of sixteen rows or columns at once.

A sample consists of sixteen complex numbers, one of each row or column. A flat array holds their real parts,
then their imaginary parts. The transform of n samples needs one pass for each factor of n, and leaves the
samples in order (T. G. Stockham, AFIPS Conf. Proc. 28, 229, 1966; C. Van Loan, Computational Frameworks for
the Fast Fourier Transform, SIAM 1992, sec. 1.7). If n has a prime factor without a pass, the transform is a
convolution with a chirp (L. I. Bluestein, IEEE Trans. Audio Electroacoust. 18, 451, 1970). An inverse
transform is a forward transform with real and imaginary parts exchanged.
"""

# mypy: disable-error-code="misc, operator"

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numpy import empty
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit, drop_outdated
from wavesim.runtime.fourier import lanes
from wavesim.runtime.fourier.lanes import LANES, alike, fetch, load, store, transpose

_jit = cached_njit(nogil=True, fastmath={"contract"}, error_model="numpy")

SAMPLE = 2 * LANES
"""Number of real numbers in a sample."""

AHEAD = 4
"""Number of panels by which prefetches precede the use, since hardware prefetchers miss such short pieces."""


class Steps(NamedTuple):
    """Constants of a transform of n samples.

    Complex constants are stored as alternating real and imaginary parts, in the precision of the samples.

    Attributes
    ----------
    radices : ndarray of int
        Radix of each pass. Their product is n, or the number of samples of the convolution.
    firsts : ndarray of int
        Index of the first twiddle factor of each pass.
    twiddles : ndarray
        Twiddle factors of each pass: exp(-2 pi i p k / left) for p = 0 ... left / radix - 1 and
        k = 1 ... radix - 1. `left` is the number of samples, divided by the radices of all earlier passes.
    chirp : ndarray
        exp(-pi i j^2 / n) for each sample j; empty if no convolution is needed.
    response : ndarray
        Transfer function of the convolution, divided by its number of samples; empty if none is needed.
    """

    radices: NDArray
    firsts: NDArray
    twiddles: NDArray
    chirp: NDArray
    response: NDArray


@_jit
def _put(y: NDArray, at: int, real: Any, imaginary: Any, parts: tuple[int, int]) -> None:
    store(y, at * SAMPLE + parts[0], real)
    store(y, at * SAMPLE + parts[1], imaginary)


@_jit
def _times_twiddle(real: Any, imaginary: Any, twiddles: NDArray, k: int) -> tuple[Any, Any]:
    """Multiply a value by the twiddle factor with index k."""
    c, s = alike(twiddles[2 * k]), alike(twiddles[2 * k + 1])
    return real * c - imaginary * s, real * s + imaginary * c


@_jit
def _get(x: NDArray, at: int, parts: tuple[int, int]) -> tuple[Any, Any]:
    return load(x, at * SAMPLE + parts[0]), load(x, at * SAMPLE + parts[1])


@_jit
def _put_times_twiddle(
    y: NDArray, at: int, value: Any, twiddles: NDArray, k: int, parts: tuple[int, int]
) -> None:
    real, imaginary = _times_twiddle(value[0], value[1], twiddles, k)
    _put(y, at, real, imaginary, parts)


@_jit
def _two(a: Any, b: Any) -> Any:
    return (a[0] + b[0], a[1] + b[1]), (a[0] - b[0], a[1] - b[1])


@_jit
def _four(a: Any, b: Any, c: Any, d: Any) -> Any:
    e, f = _two(a, c)
    g, h = _two(b, d)
    first, third = _two(e, g)
    second, fourth = _two(f, (h[1], h[0]))
    return first, (second[0], fourth[1]), third, (fourth[0], second[1])


@_jit
def _pass_of_2(x: NDArray, y: NDArray, m: int, s: int, twiddles: NDArray, k: int, parts: Any) -> None:
    for p in range(m):
        for q in range(s):
            i, o, d = q + s * p, q + s * 2 * p, s * m
            one, other = _two(_get(x, i, parts), _get(x, i + d, parts))
            _put(y, o, one[0], one[1], parts)
            _put_times_twiddle(y, o + s, other, twiddles, k + p, parts)


@_jit
def _pass_of_3(x: NDArray, y: NDArray, m: int, s: int, twiddles: NDArray, k: int, parts: Any) -> None:
    half, root = alike(x.dtype.type(0.5)), alike(x.dtype.type(math.sqrt(0.75)))
    for p in range(m):
        for q in range(s):
            i, o, d = q + s * p, q + s * 3 * p, s * m
            a = _get(x, i, parts)
            both, apart = _two(_get(x, i + d, parts), _get(x, i + 2 * d, parts))
            middle = a[0] - half * both[0], a[1] - half * both[1]
            turn = root * apart[1], root * apart[0]
            _put(y, o, a[0] + both[0], a[1] + both[1], parts)
            _put_times_twiddle(
                y, o + s, (middle[0] + turn[0], middle[1] - turn[1]), twiddles, k + 2 * p, parts
            )
            _put_times_twiddle(
                y, o + 2 * s, (middle[0] - turn[0], middle[1] + turn[1]), twiddles, k + 2 * p + 1, parts
            )


@_jit
def _pass_of_4(x: NDArray, y: NDArray, m: int, s: int, twiddles: NDArray, k: int, parts: Any) -> None:
    for p in range(m):
        for q in range(s):
            i, o, d, t = q + s * p, q + s * 4 * p, s * m, k + 3 * p
            first, second, third, fourth = _four(
                _get(x, i, parts), _get(x, i + d, parts), _get(x, i + 2 * d, parts), _get(x, i + 3 * d, parts)
            )
            _put(y, o, first[0], first[1], parts)
            _put_times_twiddle(y, o + s, second, twiddles, t, parts)
            _put_times_twiddle(y, o + 2 * s, third, twiddles, t + 1, parts)
            _put_times_twiddle(y, o + 3 * s, fourth, twiddles, t + 2, parts)


@_jit
def _pass_of_5(x: NDArray, y: NDArray, m: int, s: int, twiddles: NDArray, k: int, parts: Any) -> None:
    kind, angle = x.dtype.type, 0.4 * math.pi
    c, e = alike(kind(math.cos(angle))), alike(kind(math.cos(2.0 * angle)))
    f, g = alike(kind(math.sin(angle))), alike(kind(math.sin(2.0 * angle)))
    for p in range(m):
        for q in range(s):
            i, o, d, t = q + s * p, q + s * 5 * p, s * m, k + 4 * p
            a = _get(x, i, parts)
            outer, outer_apart = _two(_get(x, i + d, parts), _get(x, i + 4 * d, parts))
            inner, inner_apart = _two(_get(x, i + 2 * d, parts), _get(x, i + 3 * d, parts))
            _put(y, o, a[0] + outer[0] + inner[0], a[1] + outer[1] + inner[1], parts)
            near = a[0] + c * outer[0] + e * inner[0], a[1] + c * outer[1] + e * inner[1]
            far = a[0] + e * outer[0] + c * inner[0], a[1] + e * outer[1] + c * inner[1]
            by_near = f * outer_apart[0] + g * inner_apart[0], f * outer_apart[1] + g * inner_apart[1]
            by_far = g * outer_apart[0] - f * inner_apart[0], g * outer_apart[1] - f * inner_apart[1]
            _put_times_twiddle(y, o + s, (near[0] + by_near[1], near[1] - by_near[0]), twiddles, t, parts)
            _put_times_twiddle(y, o + 2 * s, (far[0] + by_far[1], far[1] - by_far[0]), twiddles, t + 1, parts)
            _put_times_twiddle(y, o + 3 * s, (far[0] - by_far[1], far[1] + by_far[0]), twiddles, t + 2, parts)
            _put_times_twiddle(
                y, o + 4 * s, (near[0] - by_near[1], near[1] + by_near[0]), twiddles, t + 3, parts
            )


@_jit
def _pass_of_8(x: NDArray, y: NDArray, m: int, s: int, twiddles: NDArray, k: int, parts: Any) -> None:
    root = alike(x.dtype.type(math.sqrt(0.5)))
    for p in range(m):
        for q in range(s):
            i, o, d, t = q + s * p, q + s * 8 * p, s * m, k + 7 * p
            even = _four(
                _get(x, i, parts),
                _get(x, i + 2 * d, parts),
                _get(x, i + 4 * d, parts),
                _get(x, i + 6 * d, parts),
            )
            odd = _four(
                _get(x, i + d, parts),
                _get(x, i + 3 * d, parts),
                _get(x, i + 5 * d, parts),
                _get(x, i + 7 * d, parts),
            )
            second = root * (odd[1][0] + odd[1][1]), root * (odd[1][1] - odd[1][0])
            fourth = root * (odd[3][1] - odd[3][0]), root * (odd[3][0] + odd[3][1])
            one, five = _two(even[0], odd[0])
            two, six = _two(even[1], second)
            _put(y, o, one[0], one[1], parts)
            _put_times_twiddle(y, o + s, two, twiddles, t, parts)
            across = odd[2][1], odd[2][0]
            three, seven = _two(even[2], across)
            _put_times_twiddle(y, o + 2 * s, (three[0], seven[1]), twiddles, t + 1, parts)
            four, eight = _two(even[3], fourth)
            _put_times_twiddle(y, o + 3 * s, (four[0], eight[1]), twiddles, t + 2, parts)
            _put_times_twiddle(y, o + 4 * s, five, twiddles, t + 3, parts)
            _put_times_twiddle(y, o + 5 * s, six, twiddles, t + 4, parts)
            _put_times_twiddle(y, o + 6 * s, (seven[0], three[1]), twiddles, t + 5, parts)
            _put_times_twiddle(y, o + 7 * s, (eight[0], four[1]), twiddles, t + 6, parts)


@_jit
def _pass_of_odd(
    x: NDArray, y: NDArray, r: int, m: int, s: int, twiddles: NDArray, k: int, parts: Any
) -> None:
    """Apply a pass of any odd radix, with sums and differences of pairs of samples."""
    roots = empty(2 * r, x.dtype)
    for j in range(r):
        roots[2 * j] = math.cos(2.0 * math.pi * j / r)
        roots[2 * j + 1] = math.sin(2.0 * math.pi * j / r)
    pairs = empty(r * SAMPLE, x.dtype)
    for p in range(m):
        for q in range(s):
            i, o, d, t = q + s * p, q + s * r * p, s * m, k + (r - 1) * p
            a = total = _get(x, i, parts)
            for n in range(1, r // 2 + 1):
                both, apart = _two(_get(x, i + n * d, parts), _get(x, i + (r - n) * d, parts))
                _put(pairs, 2 * n - 1, both[0], both[1], (0, LANES))
                _put(pairs, 2 * n, apart[0], apart[1], (0, LANES))
                total = total[0] + both[0], total[1] + both[1]
            _put(y, o, total[0], total[1], parts)
            for j in range(1, r // 2 + 1):
                near, by = a, (alike(x.dtype.type(0.0)), alike(x.dtype.type(0.0)))
                for n in range(1, r // 2 + 1):
                    index = 2 * (j * n % r)
                    c, e = alike(roots[index]), alike(roots[index + 1])
                    both, apart = _get(pairs, 2 * n - 1, (0, LANES)), _get(pairs, 2 * n, (0, LANES))
                    near = near[0] + c * both[0], near[1] + c * both[1]
                    by = by[0] + e * apart[0], by[1] + e * apart[1]
                _put_times_twiddle(
                    y, o + j * s, (near[0] + by[1], near[1] - by[0]), twiddles, t + j - 1, parts
                )
                other = near[0] - by[1], near[1] + by[0]
                _put_times_twiddle(y, o + (r - j) * s, other, twiddles, t + r - j - 1, parts)


@_jit
def _all_passes(
    source: NDArray, target: NDArray, buffers: NDArray, count: int, steps: Steps, parts: tuple[int, int]
) -> None:
    """Apply all passes to `count` samples, the product of the radices; source and target may be the same."""
    left, s, x = count, 1, source
    for number in range(len(steps.radices)):
        r, k = steps.radices[number], steps.firsts[number]
        last = number == len(steps.radices) - 1 and number > 0
        y = target if last else buffers[number % 2]
        m = left // r
        if r == 8:
            _pass_of_8(x, y, m, s, steps.twiddles, k, parts)
        elif r == 4:
            _pass_of_4(x, y, m, s, steps.twiddles, k, parts)
        elif r == 2:
            _pass_of_2(x, y, m, s, steps.twiddles, k, parts)
        elif r == 3:
            _pass_of_3(x, y, m, s, steps.twiddles, k, parts)
        elif r == 5:
            _pass_of_5(x, y, m, s, steps.twiddles, k, parts)
        else:
            _pass_of_odd(x, y, r, m, s, steps.twiddles, k, parts)
        left, s, x = m, s * r, y
    if len(steps.radices) < 2:
        target[: count * SAMPLE] = x[: count * SAMPLE]


@_jit
def transform(
    source: NDArray, target: NDArray, count: int, steps: Steps, inverse: bool, buffers: NDArray
) -> None:
    """Transform samples. Neither direction is divided by the number of samples.

    Parameters
    ----------
    source, target
        Flat arrays, which may be the same.
    count
        Number of samples.
    steps
        Constants of a transform of this number of samples.
    inverse
        True for the inverse transform (positive sign of the exponents).
    buffers
        Two rows with space for all samples each; three, with space for those of the convolution, if one is
        needed.
    """
    parts = (LANES, 0) if inverse else (0, LANES)
    if len(steps.chirp) == 0:
        _all_passes(source, target, buffers, count, steps, parts)
        return
    wide = len(steps.response) // 2
    padded = buffers[2]
    for j in range(count):
        value = _get(source, j, parts)
        real, imaginary = _times_twiddle(value[0], value[1], steps.chirp, j)
        _put(padded, j, real, imaginary, parts)
    padded[count * SAMPLE : wide * SAMPLE] = 0.0
    _all_passes(padded, padded, buffers, wide, steps, parts)
    for j in range(wide):
        value = _get(padded, j, parts)
        real, imaginary = _times_twiddle(value[0], value[1], steps.response, j)
        _put(padded, j, real, imaginary, parts)
    _all_passes(padded, padded, buffers, wide, steps, (parts[1], parts[0]))
    for j in range(count):
        value = _get(padded, j, parts)
        real, imaginary = _times_twiddle(value[0], value[1], steps.chirp, j)
        _put(target, j, real, imaginary, parts)


@_jit
def rows_to_samples(rows: NDArray, samples: NDArray) -> None:
    """Copy up to sixteen rows of complex values, given as real views, to samples.

    With fewer rows, the remaining numbers of each sample are unchanged.
    """
    count, width = rows.shape
    flat = rows.reshape(-1)
    whole = width - width % LANES if count == LANES else 0
    for j in range(0, whole, LANES):
        transpose(flat, j, width, samples, j * LANES, LANES)
    for j in range(whole, width):
        for i in range(count):
            samples[j * LANES + i] = rows[i, j]


@_jit
def samples_to_rows(samples: NDArray, rows: NDArray) -> None:
    """Copy samples to rows: the inverse of :func:`rows_to_samples`."""
    count, width = rows.shape
    flat = rows.reshape(-1)
    whole = width - width % LANES if count == LANES else 0
    for j in range(0, whole, LANES):
        transpose(samples, j * LANES, LANES, flat, j, width)
    for j in range(whole, width):
        for i in range(count):
            rows[i, j] = samples[j * LANES + i]


@_jit
def samples_to_panels(samples: NDArray, count: int, panels: NDArray, first: int) -> None:
    """Copy samples of up to sixteen rows to panels. Values behind the last column are copied as they are.

    Parameters
    ----------
    samples
        Flat array with samples for all columns of the panels.
    count
        Number of rows, at most sixteen.
    panels
        Array of shape (panels, rows x numbers of a sample).
    first
        Index of the first row in the panels.
    """
    flat, apart = panels.reshape(-1), panels.shape[1]
    for number in range(panels.shape[0]):
        panel, at = panels[number], number * LANES * SAMPLE
        for k in range(0, count * SAMPLE, LANES):
            fetch(flat, (number + AHEAD) * apart + first * SAMPLE + k)
        for part in (0, LANES):
            if count == LANES:
                transpose(samples, at + part, SAMPLE, panel, first * SAMPLE + part, SAMPLE)
                continue
            for j in range(LANES):
                for i in range(count):
                    panel[(first + i) * SAMPLE + part + j] = samples[at + j * SAMPLE + part + i]


@_jit
def panels_to_samples(panels: NDArray, first: int, count: int, samples: NDArray) -> None:
    """Copy panels to samples: the inverse of :func:`samples_to_panels`."""
    flat, apart = panels.reshape(-1), panels.shape[1]
    for number in range(panels.shape[0]):
        panel, at = panels[number], number * LANES * SAMPLE
        for k in range(0, count * SAMPLE, LANES):
            fetch(flat, (number + AHEAD) * apart + first * SAMPLE + k)
        for part in (0, LANES):
            if count == LANES:
                transpose(panel, first * SAMPLE + part, SAMPLE, samples, at + part, SAMPLE)
                continue
            for j in range(LANES):
                for i in range(count):
                    samples[at + j * SAMPLE + part + i] = panel[(first + i) * SAMPLE + part + j]


drop_outdated(transform, {__name__, lanes.__name__})
