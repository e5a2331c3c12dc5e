"""Wavefront differentials: how fast, and how near to traced trials.

`python -m benchmarks.wavefronts [TRIALS]`; 10,000 trials of two lenses take some minutes.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from benchmarks.others import OptilandTracer, missing_packages, prysm_tangents
from benchmarks.timing import DESIGNS
from lensdesign import Lens, load_design
from lensdesign.optimization.as_built import read_as_built
from lensdesign.optimization.search import optimize
from lensdesign.optimization.specification.sections import Tolerances
from lensdesign.optimization.specification.specification import load_specification
from lensdesign.raytrace.bundles import pupil_rings
from tolerancing import load_study
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.rays import FootprintRadius, LargestSpread
from tolerancing.merits.sensor_rays import arriving_rays
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction import arrival_differentials, differentials, predict, predict_rays
from tolerancing.prediction.derivatives import ARMS, RINGS, FieldDifferentials, nominal_paths
from tolerancing.prediction.paths import Paths
from tolerancing.prediction.system import amounts_of
from tolerancing.statistics.yields import yield_of
from tolerancing.study.evaluate import context_of, sample_perturbations

ROUNDS = 9
OPTILAND_TRIALS = 20
RAY_TRIALS = 10_000
COMPENSATED_TRIALS = 1_000
SPREAD_TRIALS = 1_000
STUDY = DESIGNS / "as_built_tolerances.toml"

EVERY = {
    "lens": ("decenter_x_mm", "decenter_y_mm", "despace_mm", "tilt_x_deg", "tilt_y_deg"),
    "surface 1": (
        "decenter_x_mm",
        "decenter_y_mm",
        "tilt_x_deg",
        "tilt_y_deg",
        "radius_mm",
        "conic",
        "index",
    ),
    "surface 2": ("decenter_x_mm", "decenter_y_mm", "tilt_x_deg", "tilt_y_deg", "radius_mm", "conic"),
    "element 1": ("tilt_x_deg", "roll_y_deg"),
    "object": ("decenter_x_mm", "working_distance_mm"),
    "sensor": ("tilt_x_deg", "distance_mm"),
    "light": ("wavelength_um",),
}


def main() -> None:
    """Measure and print."""
    lens, kinds = load_design(DESIGNS / "paper_singlet.toml"), list(_parameters())
    hundred = (kinds * (100 // len(kinds) + 1))[:100]
    sizes = np.full(100, 1e-3)
    points = [(0.0, 0.0)]
    points += [(r * np.cos(a), r * np.sin(a)) for r in (0.75, 1.4) for a in 0.5 * np.pi * np.arange(4)]
    for second in (False, True):
        seconds = []
        for _ in range(ROUNDS):
            began = time.perf_counter()
            differentials(lens, hundred, sizes, points, second=second)
            seconds.append(time.perf_counter() - began)
        orders = "first and second" if second else "first"
        print(f"100 tolerances, 9 object points, {orders} order: {1e3 * min(seconds):.0f} ms")
    if "optiland" not in missing_packages():
        beside_optiland(lens)
        spreads_beside_others(lens)
    began = time.perf_counter()
    loaded = load_study(STUDY)
    predict(loaded.lens, loaded.study)
    print(f"predict, 12 tolerances, 3 object points, 8192 draws: {time.perf_counter() - began:.2f} s")
    rays_beside_trials()
    compensators_beside_trials()
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    found = optimize(load_specification(DESIGNS / "as_built_spec.toml"))
    report = read_as_built(Tolerances(study=str(STUDY))).trials(
        [("paper's lens", lens), ("as_built_spec.toml", found.lens)], trials, seed=11
    )
    for row in report.rows:
        waves = zip(row.predicted_rms_waves, row.rms_waves, row.rms_errors_waves, strict=True)
        words = "; ".join(f"{stated:.4f}, {rms:.4f} +- {2 * error:.4f}" for stated, rms, error in waves)
        print(f"{row.name}: rms predicted, by {trials} trials: {words}")
        stated = predict(lens if row is report.rows[0] else found.lens, loaded.study).good
        good = f"{row.good:.4f} ({row.low:.4f} to {row.high:.4f})"
        print(f"{row.name}: good predicted {stated:.4f}, by trials {good}")


def spreads_beside_others(lens: Lens) -> None:
    """Largest spread by Optiland's Monte Carlo, its rays' derivatives by prysm, and both by ours."""
    deviations = {
        "decenter_x_mm": 0.02,
        "decenter_y_mm": 0.02,
        "tilt_x_rad": 1e-3,
        "tilt_y_rad": 1e-3,
        "radius_mm": 0.01,
        "conic": 1e-3,
        "index": 2e-4,
    }
    moved = [
        PerturbedParameter(target=f"surface {1 + (name != 'index')}", parameter=name.replace("_rad", "_deg"))
        for name in deviations
    ]
    units = np.array([180.0 / np.pi if name.endswith("_rad") else 1.0 for name in deviations])
    sizes = units * np.array(list(deviations.values()))
    wavelength, plane_z = lens.wavelengths_um[0], float(lens.sensor_z_mm[0])
    points, stop = ((0.0, 0.0), (0.0, 1.5), (1.5, 0.0)), pupil_rings(6, 24, edge=True)
    arrival_differentials(lens, moved, sizes, points, stop)  # kernels are compiled by now
    began = time.perf_counter()
    known = arrival_differentials(lens, moved, sizes, points, stop)
    seconds = {"derivatives": time.perf_counter() - began}
    paths = nominal_paths(lens, points, stop, wavelength, lens.sensor.plane_distances_mm[0])
    bundle = paths.objects_mm, paths.cosines, wavelength, plane_z
    prysm_tangents(lens, *bundle)
    began = time.perf_counter()
    theirs = prysm_tangents(lens, *bundle)
    if theirs is not None:
        off = np.abs(theirs[:, :2] / units - known.direction_by) / np.max(
            np.abs(known.direction_by), axis=(0, 1)
        )
        print(f"directions of {len(bundle[0])} rays by 7 perturbations, prysm: {np.max(off):.1e} off")
        print(f"seconds: {time.perf_counter() - began:.4f} and {seconds['derivatives']:.4f}")
    tracer = OptilandTracer(lens, *bundle)
    began = time.perf_counter()
    values, sines = tracer.monte_carlo(deviations, float(lens.indices(wavelength)[1]), SPREAD_TRIALS)
    seconds["Optiland"] = time.perf_counter() - began
    batch = PerturbationBatch(tuple(moved), values * units, 0.0)
    began = time.perf_counter()
    rays = known.arrival(amounts_of(batch))
    predicted = np.max(np.hypot(rays.direction[..., 0], rays.direction[..., 1]), axis=1)
    seconds["derivatives"] += time.perf_counter() - began
    began = time.perf_counter()
    rays = arriving_rays(lens, batch, points, stop.points, wavelength)
    traced = np.max(np.hypot(rays.direction[..., 0], rays.direction[..., 1]), axis=1)
    seconds["trials"] = time.perf_counter() - began
    for name, own in (("Optiland", sines), ("trials", traced), ("derivatives", predicted)):
        angles = np.rad2deg(np.arcsin(own))
        off = np.max(np.abs(angles - np.rad2deg(np.arcsin(sines))))
        print(
            f"largest spread of {SPREAD_TRIALS} trials, {name}: mean {np.mean(angles):.5f}, deviation "
            f"{np.std(angles):.5f}°; at most {off:.1e}° from Optiland's; {seconds[name]:.3f} s"
        )


def rays_beside_trials() -> None:
    """Largest spread and footprint, each ray to first order, beside traced trials of the same tolerances."""
    loaded = load_study(DESIGNS / "paper_tolerances.toml")
    lens, study = loaded.lens, loaded.study
    merits = (
        LargestSpread(kind="largest_spread_deg", at_most=4.84),
        FootprintRadius(kind="footprint_radius_mm", at_most=11.19),
    )
    for factor in (1.0, 5.0, 15.0, 40.0):
        wide = tuple(p.scaled(factor) for p in study.perturbations)
        own = study.model_copy(update={"all_merits": merits, "perturbations": wide, "trials": RAY_TRIALS})
        began = time.process_time()
        predicted = predict_rays(lens, own)
        seconds = time.process_time() - began
        context, scores = context_of(lens, own), []
        for start in range(0, RAY_TRIALS, 500):
            batch = sample_perturbations(own, range(start, start + 500))
            scores.append(np.stack([merit.scores(context, batch) for merit in merits], axis=1))
        for stated, traced in zip(predicted, np.concatenate(scores).T, strict=True):
            good = np.mean(stated.merit.passed(traced))
            print(
                f"tolerances x {factor:g}, {stated.merit.label}: mean, deviation, good predicted "
                f"{stated.mean:.4f}, {stated.deviation:.4f}, {100 * stated.good:.1f} %; "
                f"by {RAY_TRIALS} trials "
                f"{np.mean(traced):.4f}, {np.std(traced):.4f}, {100 * good:.1f} %; "
                f"predicted to deviate by {100 * stated.relative_error:.1f} % of the deviation; "
                f"{seconds:.1f} s"
            )


def compensators_beside_trials() -> None:
    """A model that adapts its lens's decenter: share of good lenses predicted, and by trials."""
    loaded = load_study(STUDY)
    adapted = tuple(
        Compensator(target="lens", parameter=name, limit=0.05) for name in ("decenter_x_mm", "decenter_y_mm")
    )
    update = {"compensators": adapted, "trials": COMPENSATED_TRIALS}
    study = loaded.study.model_copy(update=update)
    stated, context, scores = predict(loaded.lens, study), context_of(loaded.lens, study), []
    for start in range(0, COMPENSATED_TRIALS, 20):
        batch = sample_perturbations(study, range(start, start + 20))
        scores.append(study.merits[0].scores(context, batch))
    found = yield_of(study.merits[0].passed(np.concatenate(scores)))
    assert found is not None  # there are trials
    print(
        f"decenter adapted: good predicted {stated.good:.4f}, by {COMPENSATED_TRIALS} trials "
        f"{found.fraction:.4f} ({found.low:.4f} to {found.high:.4f})"
    )


def beside_optiland(lens: Lens) -> None:
    """Wavefronts of a back surface that is decentered and tilted, as Optiland traces them, trial by trial."""
    point, wavelength, plane_mm = (0.4, 1.1), lens.wavelengths_um[0], 3.0
    names = ("decenter_x_mm", "decenter_y_mm", "tilt_x_deg", "tilt_y_deg")
    moved = [PerturbedParameter(target="surface 2", parameter=name) for name in names]
    sizes = np.array([0.02, 0.02, 0.05, 0.05])
    differentials(lens, moved, sizes, [point], plane_distance_mm=plane_mm)  # kernels are compiled by now
    began = time.perf_counter()
    known = differentials(lens, moved, sizes, [point], plane_distance_mm=plane_mm)
    field = known.fields[0]
    values = np.random.default_rng(0).normal(size=(OPTILAND_TRIALS, 4)) * sizes
    predicted = np.sqrt(field.waves(values) ** 2 @ field.weights)
    ours = time.perf_counter() - began
    paths = nominal_paths(lens, [point], pupil_rings(RINGS, ARMS), wavelength, plane_mm)
    began = time.perf_counter()
    found = np.array([_by_optiland(lens, paths, field, one) for one in values])
    theirs = time.perf_counter() - began
    rms = [float(np.sqrt(np.mean(own**2))) for own in (found, predicted)]
    print(f"surface 2 decentered and tilted: rms {rms[0]:.4f} waves by Optiland, {rms[1]:.4f} by derivatives")
    print(f"largest difference of {OPTILAND_TRIALS} trials: {np.max(np.abs(found - predicted)):.1e} waves")
    print(f"seconds: {theirs:.1f} and {ours:.3f}")


def _by_optiland(lens: Lens, paths: Paths, field: FieldDifferentials, values: np.ndarray) -> float:
    """Refocused root mean square of a trial, rays aimed at the nominal sensor points by Newton's method."""
    wavelength, plane_z = lens.wavelengths_um[0], float(paths.sensors_mm[0, 2])
    cosines, targets = paths.cosines[:, :2].copy(), paths.sensors_mm[:, :2]

    def traced(at: np.ndarray, moved: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        axial = np.sqrt(1.0 - np.sum(at**2, axis=1))
        tracer = OptilandTracer(lens, paths.objects_mm, np.column_stack([at, axial]), wavelength, plane_z)
        if moved:
            tracer.perturb(*values)
            tracer.trace()
        position, direction = tracer.result()
        return position[:, :2], direction[:, :2], np.asarray(tracer.rays.opd)

    middle = traced(cosines, moved=False)[2]
    for _ in range(4):
        here, _, _ = traced(cosines)
        slopes = np.stack([(traced(cosines + 1e-6 * axis)[0] - here) / 1e-6 for axis in np.eye(2)], axis=2)
        cosines += np.linalg.solve(slopes, (targets - here)[..., None])[..., 0]
    here, direction, path = traced(cosines)
    path = path + np.sum(direction * (targets - here), axis=1)
    waves = field.without_focus(1e3 / wavelength * (path - middle))
    return float(np.sqrt(field.weights @ waves**2))


def _parameters() -> list[PerturbedParameter]:
    return [
        PerturbedParameter(target=target, parameter=name) for target, names in EVERY.items() for name in names
    ]


if __name__ == "__main__":
    main()
