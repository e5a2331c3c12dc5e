"""Speed of the ray trace through all shapes of surfaces, beside Optiland on the same rays.

The lens is the paper's, with another shape of the back, or with even aspheres of some wavelengths on both
surfaces. All take the same rays in one run. A ray-surface is one ray taken to one surface: here two
refracting surfaces and the plane at the end, so three for each ray. Optiland has no biconic of this form: it
adds two conics.
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
TARGETS = {
    "conic": 6.5,
    "even asphere": 5.0,
    "two even aspheres": 5.0,
    "odd asphere": 4.0,
    "Qcon": 4.0,
    "Qbfs": 4.0,
    "toroid": 4.0,
}
"""Times as fast as Optiland, by the shape of the back."""


def main() -> None:
    """Measure and print."""
    paper = load_design(DESIGNS / "paper_singlet.toml")
    for name, lens in lenses(paper).items():
        compare(lens, name, TARGETS[name])


def lenses(lens: Lens) -> dict[str, Lens]:
    """The lens with other shapes of the back, and with two aspheres."""
    back = lens.surfaces[-1]
    q_terms = {"normalization_radius_mm": 10.0, "q_mm": (2e-3, -1e-3, 5e-4)}
    shapes = {
        "conic": back,
        "even asphere": back.replaced(asphere=ASPHERE),
        "odd asphere": back.replaced(shape="odd asphere", odd_asphere=(1e-6, 1e-6, 1e-8)),
        "Qcon": back.replaced(shape="Qcon", **q_terms),
        "Qbfs": back.replaced(shape="Qbfs", radius_mm=-13.5, conic=0.0, **q_terms),
        "toroid": back.replaced(shape="toroid", asphere=ASPHERE, radius_x_mm=-13.0),
    }
    found = {name: lens.replaced(surfaces=(*lens.surfaces[:-1], surface)) for name, surface in shapes.items()}
    return found | {"two even aspheres": with_aspheres(lens, 2)}


def with_aspheres(lens: Lens, count: int) -> Lens:
    """The lens with aspheric terms on its last surfaces."""
    plain = len(lens.surfaces) - count
    surfaces = tuple(
        surface.replaced(asphere=ASPHERE) if i >= plain else surface
        for i, surface in enumerate(lens.surfaces)
    )
    return lens.replaced(surfaces=surfaces)


def compare(lens: Lens, name: str, target: float) -> None:
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
    print_table(f"{RAYS} rays, {name}, {ROUNDS} turns of {RUNS} runs of each", rows)


if __name__ == "__main__":
    main()
