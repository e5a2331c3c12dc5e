"""Speed of the ray trace through even aspheres, beside Optiland on the same rays, and of Forbes aspheres.

The lens is the paper's, with departures of some wavelengths on one or both surfaces. A ray-surface is one ray
taken to one surface: here two refracting surfaces and the plane at the end, so three for each ray.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from benchmarks.others import largest_difference, other_tracers
from benchmarks.timing import DESIGNS, Row, interleaved, print_table
from benchmarks.trace_speed import PLANE_DISTANCE_MM, random_rays
from lensdesign import Lens, load_design, trace

RAYS, ROUNDS, RUNS = 300_000, 7, 4
ASPHERE = (1e-6, 1e-8)
"""Coefficients of r^4 and r^6 in mm^-3 and mm^-5."""
TARGETS = {0: 6.5, 1: 5.0, 2: 5.0}
"""Times as fast as Optiland, by the number of aspheres."""


def main() -> None:
    """Measure and print."""
    paper = load_design(DESIGNS / "paper_singlet.toml")
    for aspheres, target in TARGETS.items():
        compare(with_aspheres(paper, aspheres), aspheres, target)
    compare_shapes(paper)


def compare_shapes(lens: Lens) -> None:
    """Measure and print lenses with other shapes of the back, beside that with one even asphere."""
    back, wavelength = lens.surfaces[-1], lens.wavelengths_um[0]
    keys = {"normalization_radius_mm": 10.0, "q_mm": (2e-3, -1e-3, 5e-4)}
    backs = {
        "conic": back,
        "even asphere": back.replaced(asphere=ASPHERE),
        "Qcon": back.replaced(shape="Qcon", **keys),
        "Qbfs": back.replaced(shape="Qbfs", radius_mm=-13.5, conic=0.0, **keys),
    }
    origins, directions = random_rays(lens, wavelength, RAYS)
    work: dict[str, Callable[[], object]] = {}
    for name, surface in backs.items():
        changed = lens.replaced(surfaces=(*lens.surfaces[:-1], surface))
        plane_z = changed.exit_vertex_z_mm + PLANE_DISTANCE_MM
        ours = partial(trace, changed, origins, directions, wavelength, plane_z_mm=plane_z)
        work[name] = partial(ours, out=ours())
    times = interleaved(work, ROUNDS, RUNS)
    total = 1e-6 * RAYS * (len(lens.surfaces) + 1)
    rows = [Row(f"{name}, best", total / times[name].best, "million ray-surfaces/s") for name in work]
    rows += [
        Row(f"{name} / even asphere, best", times["even asphere"].best / times[name].best, at_least=0.8)
        for name in ("Qcon", "Qbfs")
    ]
    print_table(f"{RAYS} rays, shapes of the back, {ROUNDS} turns of {RUNS} runs of each", rows)


def with_aspheres(lens: Lens, count: int) -> Lens:
    """The lens with aspheric terms on its last surfaces."""
    plain = len(lens.surfaces) - count
    surfaces = tuple(
        surface.replaced(asphere=ASPHERE) if i >= plain else surface
        for i, surface in enumerate(lens.surfaces)
    )
    return lens.replaced(surfaces=surfaces)


def compare(lens: Lens, aspheres: int, target: float) -> None:
    """Measure and print one lens."""
    wavelength, plane_z = lens.wavelengths_um[0], lens.exit_vertex_z_mm + PLANE_DISTANCE_MM
    origins, directions = random_rays(lens, wavelength, RAYS)
    ours = partial(trace, lens, origins, directions, wavelength, plane_z_mm=plane_z)
    out = ours()
    others = other_tracers(lens, origins, directions, wavelength, plane_z)
    work: dict[str, Callable[[], object]] = {"all threads": partial(ours, out=out)}
    work |= {package: tracer.trace for package, tracer in others.items() if package == "optiland"}
    times = interleaved(work, ROUNDS, RUNS)
    unit = "million ray-surfaces/s"
    total = 1e-6 * RAYS * (len(lens.surfaces) + 1)
    rows = [Row("lensdesign, best", total / times["all threads"].best, unit)]
    if "optiland" in times:
        tracer = others["optiland"]
        rows.append(Row(f"{tracer.name}, best", total / times["optiland"].best, unit))
        ratio = times["optiland"].best / times["all threads"].best
        rows.append(Row(f"lensdesign / {tracer.name}, best", ratio, at_least=target))
        difference = largest_difference(tracer, out.position, out.direction)
        rows.append(Row(f"largest difference from {tracer.name}", difference, "mm or cosine"))
    print_table(f"{RAYS} rays, {aspheres} even aspheres, {ROUNDS} turns of {RUNS} runs of each", rows)


if __name__ == "__main__":
    main()
