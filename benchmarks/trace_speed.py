"""Speed of the ray trace: a million rays through the paper's lens, beside Optiland and prysm.

A ray-surface is one ray taken to one surface: here two refracting surfaces and the plane at the end, so
three for each ray, in every tracer.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.others import largest_difference, other_tracers
from benchmarks.timing import DESIGNS, Row, Timing, interleaved, print_table
from lensdesign import Lens, load_design, trace
from lensdesign.raytrace.bundles import launch_pairs
from lensdesign.raytrace.compiled import compile_system

Array = NDArray[np.float64]

RAYS = 1_000_000
ROUNDS, RUNS = 7, 4
PLANE_DISTANCE_MM = 3.0
TARGETS = {"one thread": 6.0, "all threads": 12.0}
"""Times as fast as Optiland."""


def main() -> None:
    """Measure and print."""
    lens = load_design(DESIGNS / "paper_singlet.toml")
    wavelength, plane_z = lens.wavelengths_um[0], lens.exit_vertex_z_mm + PLANE_DISTANCE_MM
    origins, directions = random_rays(lens, wavelength, RAYS)
    ours = partial(trace, lens, origins, directions, wavelength, plane_z_mm=plane_z)
    out = ours()
    if out.throughput < 1.0:
        raise SystemExit(f"void: only {out.throughput:.3%} of the rays get through")
    others = other_tracers(lens, origins, directions, wavelength, plane_z)
    work: dict[str, Callable[[], object]] = {
        "one thread": partial(ours, threads=1, out=out),
        "all threads": partial(ours, out=out),
    }
    work |= {package: tracer.trace for package, tracer in others.items()}
    times = interleaved(work, ROUNDS, RUNS)
    surfaces = len(lens.surfaces) + 1
    rows = speeds("lensdesign, one thread", times["one thread"], surfaces)
    rows += speeds("lensdesign, all threads", times["all threads"], surfaces, at_least=100.0)
    for package, tracer in others.items():
        difference = largest_difference(tracer, out.position, out.direction)
        rows += speeds(tracer.name, times[package], surfaces)
        for threads, target in TARGETS.items():
            ratio = times[package].best / times[threads].best
            at_least = target if package == "optiland" else None
            rows.append(Row(f"lensdesign, {threads} / {tracer.name}, best", ratio, at_least=at_least))
        rows.append(Row(f"largest difference from {tracer.name}", difference, "mm or cosine"))
    print_table(f"{RAYS} rays, {surfaces} ray-surfaces each, {ROUNDS} turns of {RUNS} runs of each", rows)


def random_rays(lens: Lens, wavelength_um: float, count: int) -> tuple[Array, Array]:
    """Rays from random points of the field of view through random points of the stop."""
    rng = np.random.default_rng(20240601)
    fields = lens.half_field_mm * disc(rng, count)
    return launch_pairs(
        compile_system(lens, wavelength_um),
        fields,
        disc(rng, count),
        lens.object_z_mm,
        lens.stop_index,
        lens.stop_semi_diameter_mm,
    )


def disc(rng: np.random.Generator, count: int) -> Array:
    """Points spread evenly over the unit disc."""
    radius, angle = np.sqrt(rng.random(count)), 2.0 * np.pi * rng.random(count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def speeds(name: str, timing: Timing, surfaces: int, at_least: float | None = None) -> list[Row]:
    """Rows of the best and the median speed."""
    work = 1e-6 * RAYS * surfaces
    unit = "million ray-surfaces/s"
    return [
        Row(f"{name}, best", work / timing.best, unit, at_least=at_least),
        Row(f"{name}, median", work / timing.median, unit),
    ]


if __name__ == "__main__":
    main()
