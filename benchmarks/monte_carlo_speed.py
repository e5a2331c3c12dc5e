"""Speed of a ray Monte Carlo: the second surface decentered and tilted, beside Optiland and prysm.

A trial is one perturbed lens and 254 rays (127 from each of two field points) to a plane behind it. Ours
takes all trials in one call, in one thread; the others set the surface's frame and trace, trial by trial.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.others import Tracer, largest_difference, other_tracers
from benchmarks.timing import DESIGNS, Row, interleaved, print_table
from lensdesign import RayTrace, SurfacePerturbation, load_design, trace
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
    wavelength, plane_z = lens.wavelengths_um[0], lens.exit_vertex_z_mm + PLANE_DISTANCE_MM
    origins, directions = launch(lens, FIELDS_MM, spiral(RAYS), wavelength)
    rng = np.random.default_rng(20240601)
    scale = [SIGMA_DECENTER_MM, SIGMA_DECENTER_MM, SIGMA_TILT_DEG, SIGMA_TILT_DEG]
    deltas = rng.normal(size=(TRIALS, 4)) * scale
    dx, dy, tilt_x, tilt_y = deltas.T
    changes = SurfacePerturbation(decenter_x_mm=dx, decenter_y_mm=dy, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y)
    ours = partial(
        trace,
        lens,
        origins,
        directions,
        wavelength,
        plane_z_mm=plane_z,
        surface_perturbations={len(lens.surfaces) - 1: changes},
        threads=1,
    )
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
