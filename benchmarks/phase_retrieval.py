"""Appendix A at the size of a sensor: seconds an iteration, two planes, by where the field is sought."""

from __future__ import annotations

import resource
import time

import numpy as np

from benchmarks.timing import Row, print_table
from wavesim import Grid, Measurement, retrieve
from wavesim.reconstruction import retrieval_bytes

SIDE, PITCH_MM, WAVELENGTH_UM = 6144, 3.2e-3, 0.532
ITERATIONS = 8
PLANES_MM = {"the first plane is the one sought": (0.0, 20.0), "neither plane is": (2.0, 22.0)}
SECONDS = {"the first plane is the one sought": 2.2, "neither plane is": 3.5}


def main() -> None:
    """Measure and print."""
    rows = []
    for name, distances_mm in PLANES_MM.items():
        wall, cpu = iteration_seconds(distances_mm)
        rows += [
            Row(f"{name}: an iteration, the best", min(wall), "s", at_most=SECONDS[name]),
            Row("  the median", float(np.median(wall)), "s"),
            Row("  processor time of all threads, the best", min(cpu), "s"),
            Row("  memory beside the arguments, predicted", told_gb(distances_mm), "GB"),
        ]
    largest = 1e-6 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rows.append(Row("most memory of the process, arguments and all", largest, "GB"))
    print_table(f"Appendix A, {SIDE} x {SIDE} pixels, complex64, two planes, {ITERATIONS} iterations", rows)


def iteration_seconds(distances_mm: tuple[float, ...]) -> tuple[list[float], list[float]]:
    """By the clock and of processor time, of every iteration but the first; noise on an even ground."""
    rng = np.random.default_rng(8)
    grid = Grid((SIDE, SIDE), PITCH_MM, 0.0)
    recorded = [
        Measurement(d, 64.0 + 8.0 * rng.standard_normal(grid.shape, dtype=np.float32).clip(-4.0))
        for d in distances_mm
    ]
    wall, cpu = [], []

    def on_progress(*_: object) -> None:
        wall.append(time.perf_counter())
        cpu.append(time.process_time())

    retrieve(grid, WAVELENGTH_UM, recorded, "uniform", iterations=ITERATIONS, progress=on_progress)
    return list(np.diff(wall)), list(np.diff(cpu))


def told_gb(distances_mm: tuple[float, ...]) -> float:
    """As :func:`wavesim.reconstruction.retrieval_bytes` tells it."""
    return 1e-9 * retrieval_bytes((SIDE, SIDE), len(distances_mm))


if __name__ == "__main__":
    main()
