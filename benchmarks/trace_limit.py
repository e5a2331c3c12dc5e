"""How far the ray trace is from what this processor can do: its divider, its other arithmetic, its memory.

A conic takes two square roots, two quotients and 54 additions and products. An even asphere takes the
intersection with a conic, three steps of Newton's method with two coefficients, and a refraction. What bounds
a ray's arithmetic is the longer of the divider's time and that of all else, each measured here on numbers in
the first cache. A ray brings 48 bytes and leaves 59: bounded by a copy of as many bytes. All in one thread.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np

from benchmarks.timing import DESIGNS, Row, interleaved, print_table
from benchmarks.trace_speed import PLANE_DISTANCE_MM, random_rays
from lensdesign import load_design, trace
from lensdesign.lens.shapes.even_asphere import EvenAsphere
from lensdesign.lens.shapes.registry import FormulaLengths, formula_classes, needed_formulas, padded_count
from lensdesign.raytrace.conic_kernel import BLOCK, through_conic
from lensdesign.raytrace.shape_kernel import through_shape

RAYS, REPEATS, ROUNDS, RUNS = 1_000_000, 4000, 7, 3
CONIC = {"roots": 2, "quotients": 2, "others": 54}
EVEN_ASPHERE = {"roots": 1 + 3 + 1, "quotients": 1 + 3 + 1, "others": 25 + 3 * 45 + 40}
PLANE = {"roots": 0, "quotients": 1, "others": 9}
"""Operations at each."""
OTHERS = 39
"""Additions and products for each number in `others`."""

_jit = numba.njit(error_model="numpy")


@_jit
def roots(a: Any, b: Any, repeats: int) -> None:
    """Square roots of numbers in the first cache."""
    for _ in range(repeats):
        for i in range(len(a)):
            b[i] = math.sqrt(a[i])


@_jit
def quotients(a: Any, b: Any, repeats: int) -> None:
    """Quotients of numbers in the first cache."""
    for _ in range(repeats):
        for i in range(len(a)):
            b[i] = 1.5 / a[i]


@_jit
def others(a: Any, b: Any, repeats: int) -> None:
    """Sixteen products and as many additions for each number in the first cache, in four chains."""
    for _ in range(repeats):
        for i in range(len(a)):
            x = a[i]
            p, q, r, s = x + 0.1, x + 0.2, x + 0.3, x + 0.4
            for _ in range(4):
                p, q, r, s = p * x + 0.5, q * x + 0.6, r * x + 0.7, s * x + 0.8
            b[i] = (p + q) + (r + s)


@_jit
def conics(ray: Any, after: Any, work: Any, repeats: int) -> None:
    """The kernel's own step on one block in the first cache."""
    for _ in range(repeats):
        through_conic(ray, after, work, 0.1, 0.05, -0.5, 1.0, 1.0 / 1.5, 64.0, BLOCK)


@_jit
def aspheres(
    ray: Any, after: Any, work: Any, terms: Any, formulas: FormulaLengths, code: int, repeats: int
) -> None:
    """The kernel's own steps through an even asphere on one block in the first cache."""
    for _ in range(repeats):
        through_shape(formulas, code, ray, after, work, 0.1, 0.05, -0.5, terms, 1.0, 1.0 / 1.5, 64.0, BLOCK)


def main() -> None:
    """Measure and print."""
    lens = load_design(DESIGNS / "paper_singlet.toml")
    wavelength, plane_z = lens.wavelengths_um[0], lens.exit_vertex_z_mm + PLANE_DISTANCE_MM
    origins, directions = random_rays(lens, wavelength, RAYS)
    ours = partial(trace, lens, origins, directions, wavelength, plane_z_mm=plane_z, threads=1)
    out = ours()
    arrays = [out.position, out.direction, out.opl, out.status, out.failed_surface]
    copies = [np.empty_like(a) for a in (origins, directions)]
    spare = [np.empty_like(a) for a in arrays[2:]]
    a, b = 0.5 + np.random.default_rng(0).random(BLOCK), np.empty(BLOCK)
    ray = np.zeros(7 * BLOCK)
    ray[: 2 * BLOCK] = np.concatenate([a, a]) - 1.0
    ray[2 * BLOCK : 3 * BLOCK], ray[5 * BLOCK : 6 * BLOCK] = -1.0, 1.0

    terms = np.zeros(padded_count(4))
    terms[:4] = 0.05, -0.5, 1e-5, 1e-7
    code = formula_classes().index(EvenAsphere)
    formulas = needed_formulas(bytes([code]), len(terms))

    def copy() -> None:
        for target, source in zip(copies, (origins, directions), strict=True):
            np.copyto(target, source)
        for array in spare:
            array.fill(0)

    work: dict[str, Callable[[], object]] = {
        "trace": partial(ours, out=out),
        "copy": copy,
        "conic": partial(conics, ray, np.empty(7 * BLOCK), np.empty(3 * BLOCK), REPEATS),
        "asphere": partial(
            aspheres, ray, np.empty(7 * BLOCK), np.empty(3 * BLOCK), terms, formulas, code, REPEATS // 4
        ),
        "roots": partial(roots, a, b, REPEATS),
        "quotients": partial(quotients, a, b, REPEATS),
        "others": partial(others, a, b, REPEATS),
    }
    times = interleaved(work, ROUNDS, RUNS)
    counts = {
        "trace": RAYS,
        "copy": RAYS,
        "others": BLOCK * REPEATS * OTHERS,
        "asphere": BLOCK * (REPEATS // 4),
    }
    took = {name: 1e9 * min(t.cpu) / counts.get(name, BLOCK * REPEATS) for name, t in times.items()}
    print_table(f"{RAYS} rays through {len(lens.surfaces)} conics to a plane, one thread", rows(took))


def rows(took: dict[str, float]) -> list[Row]:
    """What was measured, in nanoseconds of processor time, beside its bounds."""
    conic, plane = bound(took, CONIC), bound(took, PLANE)
    least = 2.0 * conic + plane
    asphere = bound(took, EVEN_ASPHERE)
    return [
        Row("square root", took["roots"], "ns"),
        Row("quotient", took["quotients"], "ns"),
        Row("addition or product", took["others"], "ns"),
        Row("a conic, least by arithmetic", conic, "ns/ray"),
        Row("a conic, the kernel's step in the first cache", took["conic"], "ns/ray"),
        Row("the kernel's step / least", took["conic"] / conic, at_most=2.0),
        Row("an even asphere, least by arithmetic", asphere, "ns/ray"),
        Row("an even asphere, the kernel's steps in the first cache", took["asphere"], "ns/ray"),
        Row("the kernel's steps / least", took["asphere"] / asphere),
        Row("two conics and a plane, least by arithmetic", least, "ns/ray"),
        Row("as many bytes, copied", took["copy"], "ns/ray"),
        Row("arithmetic and bytes, one after the other", least + took["copy"], "ns/ray"),
        Row("the whole trace", took["trace"], "ns/ray"),
        Row("the whole trace / arithmetic and bytes", took["trace"] / (least + took["copy"]), at_most=2.0),
    ]


def bound(took: dict[str, float], count: dict[str, int]) -> float:
    """The longer of the divider's time, which roots and quotients share, and that of all else."""
    divider = count["roots"] * took["roots"] + count["quotients"] * took["quotients"]
    return max(divider, count["others"] * took["others"])


if __name__ == "__main__":
    main()
