"""Wavefront differentials: how fast, and how near to traced trials.

`python -m benchmarks.wavefronts [TRIALS]`; 10,000 trials of two lenses take some minutes.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from benchmarks.timing import DESIGNS
from lensdesign import load_design
from lensdesign.optimization.as_built import read_as_built
from lensdesign.optimization.asked.sections import Tolerances
from lensdesign.optimization.asked.specification import load_specification
from lensdesign.optimization.search import optimize
from tolerancing import load_study
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.wavefronts import differentials, predict

ROUNDS = 9
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
    began = time.perf_counter()
    loaded = load_study(STUDY)
    predict(loaded.lens, loaded.study)
    print(f"predict, 12 tolerances, 3 object points, 8192 draws: {time.perf_counter() - began:.2f} s")
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    found = optimize(load_specification(DESIGNS / "as_built_spec.toml"))
    report = read_as_built(Tolerances(study=str(STUDY))).trials(
        [("paper's lens", lens), ("as_built_spec.toml", found.lens)], trials, seed=11
    )
    for row in report.rows:
        waves = zip(row.predicted_rms_waves, row.rms_waves, row.rms_errors_waves, strict=True)
        words = "; ".join(f"{told:.4f}, {rms:.4f} +- {2 * error:.4f}" for told, rms, error in waves)
        print(f"{row.name}: rms predicted, by {trials} trials: {words}")
        told = predict(lens if row is report.rows[0] else found.lens, loaded.study).good
        good = f"{row.good:.4f} ({row.low:.4f} to {row.high:.4f})"
        print(f"{row.name}: good predicted {told:.4f}, by trials {good}")


def _parameters() -> list[PerturbedParameter]:
    return [
        PerturbedParameter(target=target, parameter=name) for target, names in EVERY.items() for name in names
    ]


if __name__ == "__main__":
    main()
