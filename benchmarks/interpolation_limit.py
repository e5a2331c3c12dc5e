"""How far the loops that carry a whole field are from what this processor can do: its arithmetic, its memory.

A fine sample is a sum of taps over rows, for real and imaginary part, of samples that are sums of taps over
columns, one in `STEP` rows; its carrier is cubic in phase (float64) and edge, and takes two polynomials for
cosine and sine. A product with an addition counts as one, in float64 as two. Forward the plane is read and
written, back it is read. All in one thread, the plane larger than any cache.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np

from benchmarks.timing import Row, interleaved, print_table
from wavesim.fields.carrier_interpolation import CarrierInterpolation, interpolation_weights
from wavesim.fields.resampling import coarse_axis, kernel_for

SIDE, STEP, SMOOTH, ERROR = 6144, 4.0, 300, 1e-3
"""Samples of the plane; of it in a coarse one; of phase and edge; error of the interpolation."""

CARRIER, PRODUCT = 46, 4
"""Additions and products: phase 14, edge and rise 9, range 7, two sines 16; onto the plane."""

CELLS, REPEATS, ROUNDS, RUNS = 1024, 2000, 5, 2
CHAINS = 32
"""Products with additions for each number in the first cache."""

_jit = numba.njit(error_model="numpy", fastmath={"contract"})
_sum = numba.njit(error_model="numpy", fastmath=True)


@_jit
def products(a: Any, b: Any, repeats: int) -> None:
    """Products with additions of numbers in the first cache, in eight chains."""
    for _ in range(repeats):
        for i in range(len(a)):
            x = a[i]
            p, q, r, s = x, x + x, x * x, x - x * x
            t, u, v, w = p * q, p * r, q * r, p * s
            for _ in range(4):
                p, q, r, s = p * x + a[0], q * x + a[0], r * x + a[0], s * x + a[0]
                t, u, v, w = t * x + a[0], u * x + a[0], v * x + a[0], w * x + a[0]
            b[i] = ((p + q) + (r + s)) + ((t + u) + (v + w))


@_sum
def read(plane: Any) -> float:
    """The sum of a plane's numbers."""
    total = plane[0, 0] - plane[0, 0]
    for i in range(plane.shape[0]):
        for j in range(plane.shape[1]):
            total += plane[i, j]
    return float(total)


def main() -> None:
    """Measure and print."""
    rng = np.random.default_rng(0)
    interpolation, coarse = step(rng)
    plane = np.zeros((SIDE, SIDE), np.complex64)
    floats = plane.view(np.float32)
    a, b = rng.random(CELLS, np.float32), np.empty(CELLS, np.float32)
    work: dict[str, Callable[[], object]] = {
        "forward": partial(interpolation.add, coarse, plane),
        "adjoint": partial(interpolation.collect, plane),
        "read and written": partial(np.add, floats, np.float32(1.0), out=floats),
        "read": partial(read, floats),
        "products": partial(products, a, b, REPEATS),
    }
    times = interleaved(work, ROUNDS, RUNS)
    counts = {"products": CELLS * REPEATS * CHAINS}
    took = {name: 1e9 * min(t.cpu) / counts.get(name, SIDE**2) for name, t in times.items()}
    taps = interpolation.weights.field[0].weight.shape[1]
    print_table(f"{SIDE}^2 samples from {len(coarse)}^2, {taps} taps, one thread", rows(took, taps))


def step(rng: np.random.Generator) -> tuple[CarrierInterpolation, np.ndarray]:
    """From a coarse field to the plane, both full of light; a carrier of 300 turns and more."""
    fine, smooth = np.linspace(-1.0, 1.0, SIDE), np.linspace(-1.01, 1.01, SMOOTH)
    kernel = kernel_for(ERROR)
    coarse = coarse_axis(fine, STEP * float(fine[1] - fine[0]), kernel)
    weights = interpolation_weights((coarse, coarse), (smooth, smooth), (fine, fine), kernel)
    phase_waves = 300.0 * (smooth[:, None] ** 2 + smooth**2) + 40.0 * smooth[:, None] ** 3
    edge = np.ones(phase_waves.shape, np.float32)
    parts = rng.standard_normal((2, len(coarse), len(coarse)), np.float32)
    whole = slice(0, SIDE)
    return CarrierInterpolation(weights, phase_waves, edge, (whole, whole)), (
        parts[0] + 1j * parts[1]
    ).astype(np.complex64)


def rows(took: dict[str, float], taps: int) -> list[Row]:
    """What was measured, in nanoseconds of processor time for a sample, beside its bounds."""
    count = 2.0 * taps * (1.0 + 1.0 / STEP) + CARRIER + PRODUCT
    arithmetic = count * took["products"]
    found = [
        Row("product with addition", took["products"], "ns"),
        Row(f"{count:.0f} of them: least by arithmetic", arithmetic, "ns"),
    ]
    for way, memory in (("forward", "read and written"), ("adjoint", "read")):
        found += [
            Row(f"the plane {memory}: least by memory", took[memory], "ns"),
            Row(f"{way}", took[way], "ns"),
            Row(f"{way} / arithmetic", took[way] / arithmetic),
            Row(
                f"{way} / arithmetic and memory, one after the other", took[way] / (arithmetic + took[memory])
            ),
        ]
    return found


if __name__ == "__main__":
    main()
