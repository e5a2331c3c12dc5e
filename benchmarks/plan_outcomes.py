"""Predictions of `plan_frames` compared with what frames then give.

For each case one plan is predicted, frames of that plan are made by `image` with another seed, and the object
is reconstructed by `reconstruct_frames` with its defaults. The objects are not those with which plans are
tried. A case holds where the outcome lies in the predicted range, or within `ALLOWED` of it.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from math import nan
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from benchmarks.timing import DESIGNS
from lensdesign import load_design, scaled
from wavesim.calibration.planning import Plan, plan_frames
from wavesim.reconstruction.found_object import FoundObject
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.settings import Kind
from wavesim.sensor.imaging import image

ALLOWED = 0.005
"""Correlation by which an outcome may miss the predicted range."""

SEED = 11


class Case(NamedTuple):
    """A twin of the paper's lens, an object on it, and a plan."""

    twin: int
    patch_mm: float
    thing: str
    kind: Kind
    planes: int
    exposures: tuple[float, ...]


ONE, TWO, THREE = (1.0,), (1.0, 30.0), (1.0, 30.0, 1000.0)

CASES = (
    Case(48, 0.03, "star", "amplitude", 2, ONE),
    Case(48, 0.03, "star", "amplitude", 2, TWO),
    Case(48, 0.03, "phase", "complex", 2, ONE),
    Case(48, 0.03, "phase", "complex", 2, TWO),
    Case(48, 0.03, "tissue", "complex", 2, TWO),
    Case(48, 0.03, "tissue", "complex", 4, THREE),
    Case(32, 0.06, "usaf", "amplitude", 2, TWO),
    Case(32, 0.06, "phase", "complex", 2, ONE),
    Case(32, 0.06, "phase", "complex", 3, TWO),
    Case(32, 0.06, "phase", "complex", 4, THREE),
    Case(32, 0.06, "tissue", "complex", 2, TWO),
    Case(20, 0.12, "usaf", "amplitude", 2, TWO),
    Case(20, 0.12, "star", "amplitude", 3, THREE),
    Case(20, 0.12, "phase", "complex", 2, TWO),
    Case(20, 0.12, "phase", "complex", 3, THREE),
    Case(20, 0.12, "tissue", "complex", 2, TWO),
    Case(20, 0.12, "tissue", "complex", 3, THREE),
)


class Outcome(NamedTuple):
    """What was predicted for a case, and what came of it."""

    plan: Plan
    found: FoundObject

    @property
    def correlation(self) -> float:
        """Correlation with the true object."""
        return self.found.truth["object_correlation"] or nan

    @property
    def difference(self) -> float:
        """Outcome less the nearest end of the predicted range; 0 within it."""
        nearest = min(max(self.correlation, self.plan.correlation), self.plan.highest_correlation)
        return self.correlation - nearest


def outcome(case: Case, **settings: Any) -> Outcome:
    """Predict and try a case.

    Parameters
    ----------
    case
        Which one.
    **settings
        Of the prediction, in place of its defaults.
    """
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 1.0 / case.twin)
    near, far = lens.sensor.plane_distances_mm
    planes = tuple(float(z) for z in np.linspace(near, far, case.planes))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plans = plan_frames(
            lens,
            patch_mm=case.patch_mm,
            kind=case.kind,
            most_planes=case.planes,
            exposures=case.exposures,
            **settings,
        )
        (plan,) = (p for p in plans.plans if p.planes_mm == planes and p.exposures == case.exposures)
        taken = image(
            lens, case.thing, patch_mm=case.patch_mm, planes_mm=planes, exposures=case.exposures, seed=SEED
        )
        found = reconstruct_frames(
            lens, taken.frames, kind=case.kind, patch_mm=case.patch_mm, truth=taken.target.transmission
        )
    return Outcome(plan, found)


def main(cases: Sequence[Case] = CASES) -> None:
    """Print the table, and how many outcomes lie in the predicted range."""
    print("| twin | object | planes | exposures | predicted | outcome | difference | over noise | seconds |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    held = 0
    worst = 0.0
    for case in cases:
        begun = perf_counter()
        made = outcome(case)
        took = perf_counter() - begun
        held += abs(made.difference) <= ALLOWED
        worst = min(worst, made.difference)
        exposures = ", ".join(f"{one:g}" for one in case.exposures)
        print(
            f"| 1/{case.twin} | {case.thing}, {case.kind} | {case.planes} | {exposures} "
            f"| {made.plan.correlation:.4f} to {made.plan.highest_correlation:.4f} | {made.correlation:.4f} "
            f"| {made.difference:+.4f} | {made.found.verdict.over_noise:.2f} | {took:.0f} |",
            flush=True,
        )
    print(f"within {ALLOWED:g} of the predicted range: {held} of {len(cases)}")
    print(f"largest promise that was not kept: {-worst:.4f}")


if __name__ == "__main__":
    main()
