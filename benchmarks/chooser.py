"""How well engines predict error and time: over a hundred scenes, against the wave propagation method."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from itertools import product

import numpy as np

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from wavesim.engines.choosing import Prediction, choose, engine_for, predictions
from wavesim.evaluation.comparison import lens_case
from wavesim.evaluation.failures import stopped_down
from wavesim.fields.field import relative_error
from wavesim.fields.guards import SamplingWarning
from wavesim.oracles.registry import OracleCase

SCALES, APERTURES, FIELD_SHARES = (1 / 8, 1 / 16), (0.2, 0.35, 0.5), (0.0, 0.5, 0.9)
PATCHES_MM, PLANES_MM = (0.01, 0.03, 0.06), (2.0, 22.0)
ERRORS = (0.2, 0.1, 0.03)
"""Allowed in turn, one for each scene."""


@dataclass(frozen=True)
class Tried:
    """A prediction, and what came of it."""

    prediction: Prediction
    chosen: bool
    relative_error: float
    seconds: float
    total_seconds: float

    @property
    def error_ratio(self) -> float:
        """Predicted over measured."""
        return self.prediction.relative_error / self.relative_error

    @property
    def seconds_ratio(self) -> float:
        """Predicted over measured, of set-up and two runs."""
        return self.prediction.total_seconds(2) / self.total_seconds


def main() -> None:
    """Measure and print."""
    warnings.simplefilter("ignore", SamplingWarning)
    paper = load_design(DESIGNS / "paper_singlet.toml")
    tried: list[Tried] = []
    kept = []
    for number, (scale, aperture, share, patch, plane) in enumerate(
        product(SCALES, APERTURES, FIELD_SHARES, PATCHES_MM, PLANES_MM)
    ):
        lens = stopped_down(scaled(paper, scale), aperture)
        case = lens_case(lens, patch, share * lens.half_field_mm, plane_distance_mm=scale * plane)
        allowed = ERRORS[number % len(ERRORS)]
        of_scene = try_all(case, allowed)
        tried += of_scene
        kept += [t.relative_error <= allowed for t in of_scene if t.chosen]
    rows = [Row("scenes", len(kept)), Row("of them, error allowed kept by the engine chosen", np.mean(kept))]
    rows += summary("chosen engines", [t for t in tried if t.chosen and t.prediction.engine != "wpm"])
    for name in ("eikonal", "slices", "thin-lens"):
        rows += summary(name, [t for t in tried if t.prediction.engine == name])
    of_time = [t.seconds_ratio for t in tried]
    rows.append(Row("all engines: seconds within a factor 3", within(of_time, 3.0), at_least=0.9))
    print_table("Predicted and measured, of all engines over all scenes", rows)


def try_all(case: OracleCase, allowed: float) -> list[Tried]:
    """Run all that was weighed for a scene, and say what was chosen."""
    chosen = choose(case.scene, allowed).chosen
    found = []
    for prediction in predictions(case.scene, allowed):
        if prediction.refused or not np.isfinite(prediction.relative_error):
            continue
        started = time.perf_counter()
        engine = engine_for(case.scene, prediction.engine, **prediction.settings)
        values = engine.forward(case.object_field).values
        once = time.perf_counter() - started
        runs = []
        for _ in range(3):
            started = time.perf_counter()
            engine.forward(case.object_field)
            runs.append(time.perf_counter() - started)
        error = relative_error(values, case.exact.values)
        same = (prediction.engine, prediction.settings) == (chosen.engine, chosen.settings)
        found.append(Tried(prediction, same, error, min(runs), once + min(runs)))
    return found


def within(ratios: list[float], factor: float) -> float:
    """Share of ratios no farther from 1 than a factor."""
    return float(np.mean([1.0 / factor <= ratio <= factor for ratio in ratios]))


def summary(name: str, tried: list[Tried]) -> list[Row]:
    """Shares of predictions of some kind that hold."""
    ratios = [t.error_ratio for t in tried]
    return [
        Row(f"{name}: number", len(tried)),
        Row(
            f"{name}: predicted error is an upper bound",
            float(np.mean(np.array(ratios) >= 1.0)),
            at_least=0.95,
        ),
        Row(f"{name}: predicted error within a factor 5", within(ratios, 5.0), at_least=0.8),
        Row(f"{name}: predicted over measured error, 1 in 20 below", float(np.quantile(ratios, 0.05))),
        Row(f"{name}: predicted over measured error, median", float(np.median(ratios))),
        Row(f"{name}: predicted over measured error, 1 in 5 above", float(np.quantile(ratios, 0.8))),
        Row(
            f"{name}: seconds within a factor 3", within([t.seconds_ratio for t in tried], 3.0), at_least=0.9
        ),
    ]


if __name__ == "__main__":
    main()
