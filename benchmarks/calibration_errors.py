"""Stated standard deviations of calibrations against true errors, on benches as designed.

A normalized error is an error over its stated standard deviation. Errors of single parameters are strongly
correlated, and the prior draws them to the true values of a bench as designed, which are 0. Therefore they
are counted along the independent directions that the frames determine. Those of single parameters are printed
for comparison. With --seeds, several objects and noises are pooled. The object before and after shows what
calibrating costs where nothing is wrong.

Let the frames have the precision :math:`F`, and the prior the precision 1, in units of the prior's standard
deviations. The stated covariance is :math:`C = (F + 1)^{-1}`, and the estimate is :math:`m = C F d`, where
:math:`d` is the estimate from the frames alone. Where :math:`C` has the eigenvalue :math:`v`, the frames have
the precision :math:`(1 - v) / v`. So :math:`d = m / (1 - v)`, with the standard deviation
:math:`\\sqrt{v / (1 - v)}`. For a nominal true value the error :math:`m` has the variance :math:`v (1 - v)`,
and not :math:`v`: it is small by construction where the frames contain little information. The normalized
error of :math:`d` has variance 1 for every true value. Directions in which the frames are less precise than
the prior are excluded, because the division by :math:`1 - v` would magnify numerical errors.
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any, NamedTuple

import numpy as np

from benchmarks.timing import DESIGNS
from lensdesign import load_design, scaled
from lensdesign.common.arrays import Array
from wavesim import calibrate_frames, image, reconstruct_frames
from wavesim.scene.settings import Kind

ACCURATE_ERROR, ERROR = 0.03, 0.1
"""Errors of the engines of frames (small: not to count as errors of a bench) and of the search."""


class Case(NamedTuple):
    """A bench as designed: the twin's scale, the object, the planes and the exposures."""

    scale: int
    thing: str
    kind: Kind
    planes: int
    exposures: tuple[float, ...]
    patch_mm: float = 0.03
    pixels: int = 140
    seed: int = 0


CASES = (
    Case(48, "star", "amplitude", 2, (1.0,)),
    Case(48, "star", "amplitude", 2, (1.0, 30.0)),
    Case(48, "star", "amplitude", 3, (1.0, 30.0, 1000.0)),
    Case(48, "tissue", "complex", 2, (1.0, 30.0)),
    Case(48, "tissue", "complex", 4, (1.0, 30.0, 1000.0)),
    Case(48, "phase", "complex", 2, (1.0, 30.0)),
    Case(48, "phase", "complex", 4, (1.0,)),
    Case(32, "star", "amplitude", 2, (1.0, 30.0), 0.04, 200),
    Case(32, "tissue", "complex", 3, (1.0, 30.0), 0.04, 200),
    Case(24, "star", "amplitude", 2, (1.0, 30.0, 1000.0), 0.04, 240),
    Case(24, "phase", "complex", 2, (1.0, 30.0, 1000.0), 0.04, 240),
    Case(16, "star", "amplitude", 2, (1.0, 30.0), 0.04, 400),
)


def normalized_errors(
    estimates: Array, covariance: Array, prior_deviations: Array, true_values: Array | None = None
) -> Array:
    """Return the normalized errors of an estimate along the independent directions that the data determine.

    Parameters
    ----------
    estimates : ndarray, shape (n,)
        Most probable differences from nominal, given data and prior.
    covariance : ndarray, shape (n, n)
        Stated covariance of the estimates, with the prior included.
    prior_deviations : ndarray, shape (n,)
        Standard deviations of the prior, whose mean is 0.
    true_values : ndarray, shape (n,), optional
        True differences from nominal; default: 0.

    Returns
    -------
    ndarray
        One value for each direction, the best determined first. They are independent, with mean 0 and
        variance 1, where the covariance is right. With k of them the root mean square has a standard
        deviation of about 1 / sqrt(2 k).
    """
    true = np.zeros(len(estimates)) if true_values is None else true_values
    variances, directions = np.linalg.eigh(covariance / np.outer(prior_deviations, prior_deviations))
    # Posterior over prior variance, up to which the frames are more precise than the prior.
    largest_variance = 0.5
    determined = (variances > 0.0) & (variances <= largest_variance)
    variances, directions = variances[determined], directions[:, determined]
    by_data = directions.T @ (estimates / prior_deviations) / (1.0 - variances)
    errors = by_data - directions.T @ (true / prior_deviations)
    return np.asarray(errors / np.sqrt(variances / (1.0 - variances)), float)


def errors_of(case: Case) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Normalized errors of single parameters and along independent directions, and figures of the object."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 1 / case.scale)
    first, last = lens.sensor.plane_distances_mm[0], lens.sensor.plane_distances_mm[-1]
    distances_mm = tuple(np.linspace(first, last, case.planes).tolist())
    lens = lens.replaced(sensor=lens.sensor.replaced(plane_distances_mm=distances_mm))
    taken: dict[str, Any] = {"exposures": case.exposures, "pixels": case.pixels, "seed": case.seed}
    seen = image(lens, case.thing, patch_mm=case.patch_mm, engine="eikonal", error=ACCURATE_ERROR, **taken)
    given: dict[str, Any] = {"kind": case.kind, "patch_mm": case.patch_mm, "error": ERROR}
    found = calibrate_frames(lens, seen.frames, verdict="none", **given)
    assert found.deviations is not None
    assert found.covariance is not None
    assert found.typical is not None
    objects = [
        reconstruct_frames(
            lens, seen.frames, truth=seen.target.transmission, calibration=bench, verdict="none", **given
        )
        for bench in (None, found.state)
    ]
    figures_of_object = [f"{one.truth['object_correlation'] or 0.0:.4f}" for one in objects]
    figures_of_object.append(str(len(found.parameters) - len(found.nominal)))
    estimates, deviations = np.array(found.values), np.array(found.deviations)
    normalized = normalized_errors(estimates, found.covariance, np.array(found.typical))
    return estimates / deviations, normalized, figures_of_object


def main() -> None:
    """Print a line for each bench, or for those whose numbers are given."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration_errors", description=__doc__)
    parser.add_argument(
        "numbers", nargs="*", type=int, metavar="NUMBER", help="of a bench, from 0; default: all"
    )
    parser.add_argument("--seeds", type=int, default=1, help="number of objects and noises that are pooled")
    given = parser.parse_args()
    print(
        "| bench | directions | rms normalized error | of each seed | largest | single parameters "
        "| object, calibrated, needed parameters |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for number in given.numbers or range(len(CASES)):
        case = CASES[number]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = [errors_of(case._replace(seed=case.seed + seed)) for seed in range(given.seeds)]
        exposures = ",".join(f"{one:g}" for one in case.exposures)
        what = f"1/{case.scale}, {case.thing}, {case.kind}, {case.planes} planes, exposures {exposures}"
        normalized = np.concatenate([errors for _, errors, _ in found])
        of_parameters = np.concatenate([errors for errors, _, _ in found])
        cells = [
            what,
            str(len(normalized)),
            f"{_rms(normalized):.2f}",
            ", ".join(f"{_rms(errors):.2f}" for _, errors, _ in found),
            f"{np.abs(normalized).max():.2f}",
            f"{_rms(of_parameters):.2f}",
            "; ".join(", ".join(figures) for _, _, figures in found),
        ]
        print(f"| {' | '.join(cells)} |", flush=True)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    main()
