"""Speed of a ray Monte Carlo: the second surface decentered and tilted, beside Optiland and prysm.

A trial is one perturbed lens and 254 rays (127 from each of two field points) to a plane behind it. Ours
takes all trials in one call, in one thread; the others set the surface's frame and trace, trial by trial. The
same trials with even aspheres on one and both surfaces are compared with those of the conics.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.asphere_speed import lenses
from benchmarks.others import Tracer, largest_difference, other_tracers
from benchmarks.timing import DESIGNS, Row, interleaved, print_table
from lensdesign import Lens, RayTrace, SurfacePerturbation, load_design, trace
from lensdesign.raytrace.bundles import launch

Array = NDArray[np.float64]

TRIALS = 4000
TRIALS_OF_OTHERS = {"optiland": 40, "prysm": 80}
ROUNDS, RUNS = 7, 4
RAYS = 127
FIELDS_MM = ((0.0, 0.0), (0.0, 1.0))
PLANE_DISTANCE_MM = 3.0
SIGMA_DECENTER_MM = 0.01
SIGMA_TILT_DEG = 0.05
TARGET_RATIO = {"optiland": 100.0, "prysm": 30.0}


def main() -> None:
    """Measure and print."""
    lens = load_design(DESIGNS / "paper_singlet.toml")
    beside_others(lens)
    with_other_shapes(lens)


def trials_of(lens: Lens, origins: Array, directions: Array, deltas: Array) -> partial[RayTrace]:
    """All trials of a lens in one call, one thread."""
    dx, dy, tilt_x, tilt_y = deltas.T
    changes = SurfacePerturbation(decenter_x_mm=dx, decenter_y_mm=dy, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y)
    return partial(
        trace,
        lens,
        origins,
        directions,
        lens.wavelengths_um[0],
        plane_z_mm=lens.exit_vertex_z_mm + PLANE_DISTANCE_MM,
        surface_perturbations={len(lens.surfaces) - 1: changes},
        threads=1,
    )


def random_deltas() -> Array:
    """Decenters and tilts of all trials."""
    scale = [SIGMA_DECENTER_MM, SIGMA_DECENTER_MM, SIGMA_TILT_DEG, SIGMA_TILT_DEG]
    return np.random.default_rng(20240601).normal(size=(TRIALS, 4)) * scale


def with_other_shapes(lens: Lens) -> None:
    """Measure and print trials of lenses with aspheres, in turns with those of the conics."""
    deltas = random_deltas()
    origins, directions = launch(lens, FIELDS_MM, spiral(RAYS), lens.wavelengths_um[0])
    shapes = lenses(lens)
    work: dict[str, Callable[[], object]] = {}
    for name in ("conic", "even asphere", "two even aspheres", "Qbfs", "toroid"):
        ours = trials_of(shapes[name], origins, directions, deltas)
        work[name] = partial(ours, out=ours())
    times = interleaved(work, ROUNDS, RUNS)
    rows = [Row(f"{name}, best", TRIALS / times[name].best, "trials/s") for name in work]
    rows += [
        Row(f"{name} / conic, best", times["conic"].best / times[name].best, at_least=0.5)
        for name in work
        if name != "conic"
    ]
    print_table(f"Monte Carlo, {len(origins)} rays a trial, shape of the back", rows)


def beside_others(lens: Lens) -> None:
    """Measure and print, in turns with other tracers."""
    wavelength, plane_z = lens.wavelengths_um[0], lens.exit_vertex_z_mm + PLANE_DISTANCE_MM
    origins, directions = launch(lens, FIELDS_MM, spiral(RAYS), wavelength)
    deltas = random_deltas()
    ours = trials_of(lens, origins, directions, deltas)
    out = ours()
    if out.throughput < 1.0:
        raise SystemExit(f"void: only {out.throughput:.3%} of the rays get through")
    others = other_tracers(lens, origins, directions, wavelength, plane_z)
    work: dict[str, Callable[[], object]] = {"ours": partial(ours, out=out)}
    work |= {name: partial(run, tracer, deltas[: TRIALS_OF_OTHERS[name]]) for name, tracer in others.items()}
    times = interleaved(work, ROUNDS, RUNS)
    speed = TRIALS / times["ours"].best
    rows = [
        Row("lensdesign, one thread, best", speed, "trials/s", at_least=20_000.0),
        Row("lensdesign, one thread, median", TRIALS / times["ours"].median, "trials/s"),
    ]
    for package, tracer in others.items():
        count = TRIALS_OF_OTHERS[package]
        their_speed = count / times[package].best
        rows += [
            Row(f"{tracer.name}, best", their_speed, "trials/s"),
            Row(f"{tracer.name}, median", count / times[package].median, "trials/s"),
            Row(f"lensdesign / {tracer.name}, best", speed / their_speed, at_least=TARGET_RATIO[package]),
            agreement(tracer, deltas[:count], out),
        ]
    print_table(f"Monte Carlo, {len(origins)} rays a trial, {ROUNDS} turns of {RUNS} runs of each", rows)


def agreement(tracer: Tracer, deltas: Array, ours: RayTrace) -> Row:
    """Largest difference of another tracer's rays from ours over some trials."""
    worst = 0.0
    for i, delta in enumerate(deltas):
        run(tracer, delta[None])
        worst = max(worst, largest_difference(tracer, ours.position[i], ours.direction[i]))
    return Row(f"largest difference from {tracer.name}, {len(deltas)} trials", worst, "mm or cosine")


def run(tracer: Tracer, deltas: Array) -> None:
    """Trial by trial, as the other programs do it."""
    for delta in deltas:
        tracer.perturb(*delta)
        tracer.trace()


def spiral(count: int) -> Array:
    """Points spread evenly over the unit disc, none at its centre, where prysm has no normals."""
    i = np.arange(count) + 0.5
    radius, angle = np.sqrt(i / count), np.pi * (3.0 - np.sqrt(5.0)) * i
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


if __name__ == "__main__":
    main()
