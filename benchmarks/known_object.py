"""Mounting found with a known object against the true one, for small and large errors.

Errors of decenter and tilt, and with `all` those of the distances, are random multiples of their expected
deviations, with a root mean square that the table states. So is the error of what is found.
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import Any, NamedTuple

import numpy as np

from benchmarks.timing import DESIGNS
from lensdesign import Pose, load_design, scaled
from wavesim import SystemState, calibrate_frames, image

TYPICAL = {
    "decenter_x_mm": 5e-3,
    "decenter_y_mm": 5e-3,
    "tilt_x_deg": 0.3,
    "tilt_y_deg": 0.3,
    "working_distance_mm": 0.01,
    "plane_distance_1_mm": 0.01,
    "plane_distance_2_mm": 0.01,
}
"""Expected deviations of a twin's mounting."""


class Case(NamedTuple):
    """An object behind a twin of the paper's lens, and the size of the mounting's errors."""

    thing: str
    scale: int
    patch_mm: float
    parameters: str
    factor: float


CASES = tuple(
    Case(thing, scale, patch_mm, parameters, factor)
    for thing, scale, patch_mm in (("star", 48, 0.03), ("usaf", 32, 0.06), ("tissue", 48, 0.03))
    for parameters, factors in (("rigid", (1.0, 2.0, 4.0)), ("all", (1.0, 2.0)))
    for factor in factors
)


def found_with(case: Case, seed: int) -> tuple[float, float, float]:
    """Return the error of what is found over its expected deviation, the misfit over noise, and seconds."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 1 / case.scale)
    names = list(TYPICAL)[: 4 if case.parameters == "rigid" else None]
    multiples = np.random.default_rng([seed, 7]).standard_normal(len(names))
    multiples *= case.factor / np.sqrt(np.mean(multiples**2))
    true = {name: TYPICAL[name] * float(one) for name, one in zip(names, multiples, strict=True)}
    distance_mm, *planes_mm = [true.get(name, 0.0) for name in list(TYPICAL)[4:]]
    state = SystemState(
        Pose(**{name: true[name] for name in names[:4]}),
        object_shift_mm=(0.0, 0.0, -distance_mm),
        plane_distance_errors_mm=tuple(planes_mm),
    )
    patch: dict[str, Any] = {"patch_mm": case.patch_mm, "engine": "eikonal"}
    made = image(lens, case.thing, state=state, exposures=(1.0, 30.0), error=0.03, seed=seed, **patch)
    begun = time.process_time()
    known = made.target.transmission
    patch |= {"parameters": case.parameters, "error": 0.1, "verdict": "none"}
    found = calibrate_frames(lens, made.frames, known=known, **patch)
    values = dict(zip(found.parameters, found.values, strict=True))
    errors = [(values[name] - true[name]) / TYPICAL[name] for name in names]
    assert found.misfit_of_noise is not None
    over_noise = found.misfit / found.misfit_of_noise
    return float(np.sqrt(np.mean(np.square(errors)))), over_noise, time.process_time() - begun


def main() -> None:
    """Print a line for each bench."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.known_object", description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="number of errors and noises of each bench")
    parser.add_argument("--objects", nargs="*", default=["star", "usaf", "tissue"], help="objects")
    given = parser.parse_args()
    print("| object | parameters | errors | seed | error found | misfit over noise | s |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for case in CASES:
        for seed in range(given.seeds if case.thing in given.objects else 0):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                error, over_noise, seconds = found_with(case, seed)
            row = f"| {case.thing} | {case.parameters} | {case.factor:g} | {seed} "
            print(f"{row}| {error:.3f} | {over_noise:.2f} | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    main()
