"""Yield by contrast under two rules of focus: where the phase is flattest, and where contrast is best.

Three lenses, tolerances of the grade `precision`, trials scored at three object points: share of trials whose
0.775 um lines keep a contrast of 0.7 along both axes. Prints one row for each lens and point, and last how
much longer a trial takes with the second rule, in processor time.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np

from tolerancing import load_study, start_study
from tolerancing.merits.line_pairs import line_pairs_in_focus
from tolerancing.study.evaluate import context_of, sample_perturbations
from wavesim import line_pair_contrast, strehl

DESIGNS = Path(__file__).parents[1] / "designs"
LENSES = ("paper_singlet", "feasible_singlet", "thinnest_singlet")
POINTS = ((0.0, 0.0), (0.0, 1.0), (0.0, 1.4))
TRIALS, WIDTH_UM, LEAST = 120, 0.775, 0.7


def rows(name: str) -> Iterator[tuple[float, float, float, float, float]]:
    """For each object point: yields by flattest phase and best contrast, gain, Strehl ratio, time ratio."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        start_study(DESIGNS / f"{name}.toml", path, "precision")
        loaded = load_study(path)
    context, batch = context_of(loaded.lens, loaded.study), sample_perturbations(loaded.study, range(TRIALS))
    for point in POINTS:
        begun = process_time()
        pupils = context.pupils(batch, point, None, True)
        traced = process_time()
        flat = np.array([min(line_pair_contrast(p, WIDTH_UM, axis) for axis in ("x", "y")) for p in pupils])
        scored = process_time()
        best = np.array(
            [min(line_pairs_in_focus(p, WIDTH_UM, axis)[0] for axis in ("x", "y")) for p in pupils]
        )
        sought, took = process_time() - scored, traced - begun
        ratios = [strehl(p) for p in pupils]
        yield (
            float(np.mean(flat >= LEAST)),
            float(np.mean(best >= LEAST)),
            float(np.median(best - flat)),
            float(np.median(ratios)),
            (took + sought) / (scored - begun),
        )


def main() -> None:
    """Print the table."""
    print(
        "lens, object point (mm): yield by flattest phase, by best contrast; median gain; median Strehl ratio"
    )
    longer = []
    for name in LENSES:
        for (_, y), found in zip(POINTS, rows(name), strict=True):
            print(f"{name:18} {y:3.1f}: {found[0]:.3f} {found[1]:.3f} {found[2]:.3f} {found[3]:.3f}")
            longer.append(found[4])
    print(f"processor time of a trial: {np.median(longer):.2f} times")


if __name__ == "__main__":
    main()
