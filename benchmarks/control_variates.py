"""Two levels of one merit: what a control variate gains, and whether its 95 % interval holds what it says.

All trials of the paper's tolerance study are scored by the reconstruction pupil and by waves. Their means
over all are the truth; many samples of trials, a few of them scored by waves, are estimated from and held
against it. A control variate gains for the mean; a yield is pass or fail, which so few trials tell less well.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import DESIGNS, Row, print_table
from tolerancing import load_study, open_store, run_study
from tolerancing.statistics.control_variates import (
    ControlVariateEstimate,
    Seconds,
    choose_trials,
    combined_mean,
    combined_yield,
)
from tolerancing.study.evaluate import context_of, score_trials
from tolerancing.study.files import LoadedStudy

Array = NDArray[np.float64]

TRIALS = 3000
REPEATS = 200
CHEAP_TRIALS, WORST, RANDOM = 2000, 10, 25
LIMIT = 0.8
TIMED = 64
PUPIL_SAMPLES = 64

MERITS = f"""
[[merit]]
name = "cheap"
kind = "line_pair_contrast"
level = "pupil"
line_width_um = 0.775
orientation = "y"
at_least = {LIMIT}

[[merit]]
name = "dear"
kind = "line_pair_contrast"
level = "wave"
line_width_um = 0.775
orientation = "y"
at_least = {LIMIT}
"""


def best_narrowing(correlation: float, cost_ratio: float) -> float:
    """Return the largest gain in interval width of a mean for the same computing time.

    Let rho be the correlation of the two merits, and r the cost ratio of a high- to a low-fidelity trial. The
    product of variance and time is smallest for N / n = rho sqrt(r / (1 - rho^2)). The interval is then
    narrower than that of plain high-fidelity trials by the factor 1 / (sqrt(1 - rho^2) + rho / sqrt(r))
    (Cochran section 12.3; Peherstorfer, Willcox and Gunzburger 2016). Below 1, plain trials are better. A
    factor of three needs rho = 0.994 at r = 20, 0.972 at r = 100, and 0.943 at any cost ratio. One third of
    the variance needs rho = 0.930 at r = 20.
    """
    rho = abs(correlation)
    return 1.0 / (math.sqrt(1.0 - rho * rho) + rho / math.sqrt(cost_ratio))


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        loaded = study(Path(folder))
        run_study(loaded, Path(folder) / "a.db", trials=TRIALS)
        with open_store(Path(folder) / "a.db") as store:
            cheap, dear = store.trials().scores.T
        seconds = Seconds(*(seconds_of(loaded, name) for name in ("cheap", "dear")))
    means, yields = repeated(cheap, dear, seconds)
    correlation, ratio = float(np.corrcoef(cheap, dear)[0, 1]), seconds.high_fidelity / seconds.low_fidelity
    rows = [
        Row("one trial by the pupil", 1e3 * seconds.low_fidelity, "ms"),
        Row("one trial by waves", 1e3 * seconds.high_fidelity, "ms"),
        Row("correlation of both", correlation),
        Row("narrowing at best for these", best_narrowing(correlation, ratio)),
        *rows_of("mean", means, float(dear.mean()), target=3.0),
        *rows_of("yield", yields, float(np.mean(dear >= LIMIT))),
    ]
    title = f"{REPEATS} estimates from {CHEAP_TRIALS} trials by the pupil, {WORST + RANDOM} by waves"
    print_table(title, rows)


def rows_of(
    what: str, found: list[ControlVariateEstimate], truth: float, target: float | None = None
) -> list[Row]:
    """How often the interval holds the truth, and how much narrower it is."""
    held = float(np.mean([one.low <= truth <= one.high for one in found]))
    dear = float(np.median([one.narrower_than_high_fidelity for one in found]))
    same = float(np.median([one.narrower_than_same_time for one in found]))
    return [
        Row(f"{what}, truth", truth),
        Row(f"{what}, mean of estimates", float(np.mean([one.estimate for one in found]))),
        Row(f"{what}, 95 % intervals that hold it", held, at_least=0.92),
        Row(f"{what}, narrower than as many by waves alone", dear),
        Row(f"{what}, narrower than by waves alone for the same time", same, at_least=target),
    ]


def study(folder: Path) -> LoadedStudy:
    """The paper's perturbations with a cheap and a dear merit."""
    text = (DESIGNS / "paper_tolerances.toml").read_text(encoding="utf-8")
    text = text.partition("# What a good system does")[0].replace("trials = 500", f"trials = {TRIALS}")
    text = text.replace("pupil_samples = 128", f"pupil_samples = {PUPIL_SAMPLES}")
    path = folder / "study.toml"
    path.write_text("sensitivity = false\n" + text + MERITS, encoding="utf-8")
    (folder / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    return load_study(path)


def seconds_of(loaded: LoadedStudy, name: str) -> float:
    """Processor time of one trial by one merit alone."""
    merits = tuple(m for m in loaded.study.all_merits if m.label == name)
    alone = loaded.study.model_copy(update={"all_merits": merits})
    context = context_of(loaded.lens, alone)
    score_trials(context, alone, range(2))
    start = time.process_time()
    score_trials(context, alone, range(TIMED))
    return (time.process_time() - start) / TIMED


def repeated(
    cheap: Array, dear: Array, seconds: Seconds
) -> tuple[list[ControlVariateEstimate], list[ControlVariateEstimate]]:
    """Estimates of mean and yield from samples of the trials."""
    rng = np.random.default_rng(20240601)
    means, yields = [], []
    for repeat in range(REPEATS):
        # With replacement, so that all trials stand for a population of any size.
        sample = rng.integers(len(cheap), size=CHEAP_TRIALS)
        margin = cheap[sample] - LIMIT
        chosen = choose_trials(margin, repeat, WORST, RANDOM)
        scores = dear[sample][chosen.all]
        means.append(combined_mean(cheap[sample], chosen, scores, seconds))
        yields.append(combined_yield(margin, chosen, scores >= LIMIT, seconds))
    return means, yields


if __name__ == "__main__":
    main()
