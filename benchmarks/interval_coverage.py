"""Whether 95 % intervals of yields hold the truth in 95 % of studies, by the way in which trials are drawn.

Yields of two kinds: closed forms, of a weighted sum of twelve normal deviates; and the share of the paper's
tolerance study within a wavefront error, on the axis and off it. For the latter a second-order model of the
squared wavefront errors stands in for the lens, which repeats thousands of studies in a minute; the lens
itself repeats some.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from benchmarks.timing import DESIGNS
from tolerancing import load_study
from tolerancing.perturbations import DRAWS, probabilities, replicates
from tolerancing.statistics import fit_response, yield_of
from tolerancing.statistics.rare_failures import (
    draw_trials,
    failure_probabilities,
    modelled_trials,
    weighted_failures,
)
from tolerancing.statistics.yields import wilson
from tolerancing.study.evaluate import context_of, sample_perturbations, score_trials
from tolerancing.study.files import LoadedStudy
from tolerancing.study.study import Study

Array = NDArray[np.float64]
Passed = Callable[[str, int], NDArray[np.bool_]]
"""Which trials of a study are good, by the way of drawing and the seed."""

TRIALS, REPEATS = 500, 400
SLOPES = np.linspace(0.3, 1.5, 12)
SHARES = (0.5, 0.8, 0.95, 0.99)

FITTED, TRUTH = 1500, 400_000
HEIGHTS_MM = (0.0, 1.0, 1.4)
LIMITS_WAVES = (0.12, 0.24)
LENS_REPEATS, LENS_TRIALS, LENS_TRUTH = 60, 160, 6000

RARE_LIMITS_WAVES = (0.24, 0.3)
RARE_FITTED, RARE_MODELLED, RARE_REPEATS, RARE_TRUTH = 500, 100_000, 400, 2_000_000

MERIT = """
[[merit]]
name = "rms_{number}"
kind = "rms_waves"
field_mm = [{height}, 0.0]
at_most = {limit}
"""


def main() -> None:
    """Measure and print."""
    print(f"95 % intervals that hold the truth, of {REPEATS} studies of {TRIALS} trials, in %;")
    print("in brackets those of Wilson for as many independent trials; mean width")
    print(f"{'':<44} yield   " + "   ".join(f"{method:<20}" for method in DRAWS))
    for share in SHARES:
        limit = float(ndtri(share)) * float(np.linalg.norm(SLOPES))
        coverage("sum of twelve normal deviates", summed(limit), share, REPEATS)
    with tempfile.TemporaryDirectory() as folder:
        loaded = study(Path(folder))
    model = model_of(loaded)
    for k, height in enumerate(HEIGHTS_MM):
        for limit in LIMITS_WAVES:
            modelled = modelled_study(loaded.study, model, k, limit)
            truth = float(np.mean(modelled("random", 1)[:TRUTH]))
            name = f"{limit:g} waves at {height:g} mm, model of the lens"
            coverage(name, first(modelled, TRIALS), truth, REPEATS)
    of_the_lens(loaded)
    rare(loaded, model)


def coverage(name: str, passed: Passed, truth: float, repeats: int) -> None:
    """One line: by way of drawing, how often intervals hold a yield, how often Wilson's would, mean width."""
    cells = []
    for method in DRAWS:
        found, naive = [], 0
        for seed in range(1000, 1000 + repeats):
            good = passed(method, seed)
            found.append(yield_of(good, replicates(method, range(len(good)))))
            low, high = wilson(float(good.mean()), len(good))
            naive += low <= truth <= high
        held = np.mean([one.low <= truth <= one.high for one in found if one])
        width = np.mean([one.high - one.low for one in found if one])
        cells.append(f"{100 * held:5.1f} ({100 * naive / repeats:5.1f})  {width:.3f}")
    line = f"{name:<44} {truth:.3f}   " + "   ".join(cells)
    print(line, flush=True)


def summed(limit: float) -> Passed:
    """Trials whose weighted sum of normal deviates keeps a limit."""

    def passed(method: str, seed: int) -> NDArray[np.bool_]:
        drawn = probabilities(method, seed, range(TRIALS), len(SLOPES), TRIALS)
        return np.asarray(ndtri(drawn) @ SLOPES <= limit)

    return passed


def study(folder: Path) -> LoadedStudy:
    """The paper's perturbations, scored by wavefront errors."""
    text = (DESIGNS / "paper_tolerances.toml").read_text(encoding="utf-8")
    text = text.partition("# What a good system does")[0].replace("pupil_samples = 128", "pupil_samples = 32")
    text = "sensitivity = false\n" + text
    for number, height in enumerate(HEIGHTS_MM):
        text += MERIT.format(number=number, height=height, limit=LIMITS_WAVES[0])
    (folder / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return load_study(folder / "study.toml")


def model_of(loaded: LoadedStudy) -> Callable[[Array], Array]:
    """Squared wavefront errors as second-order polynomials of the deltas, shape (n, heights)."""
    trials = score_trials(context_of(loaded.lens, loaded.study), loaded.study, range(FITTED))
    response = fit_response(trials.values, trials.scores**2)
    r_squared = ", ".join(f"{value:.4f}" for value in response.cross_validated_r_squared)
    print(f"model of the squared wavefront errors from {FITTED} trials: R^2 of trials left out {r_squared}")
    return response.predict


def modelled_study(study: Study, model: Callable[[Array], Array], k: int, limit: float) -> Passed:
    """Trials whose modelled wavefront error at one height keeps a limit; many where drawn at random."""

    def passed(method: str, seed: int) -> NDArray[np.bool_]:
        count = TRUTH if (method, seed) == ("random", 1) else TRIALS
        own = study.model_copy(update={"draws": method, "seed": seed, "trials": count})
        return np.asarray(model(sample_perturbations(own, range(count)).values)[:, k] <= limit**2)

    return passed


def first(passed: Passed, count: int) -> Passed:
    """The first trials alone."""
    return lambda method, seed: passed(method, seed)[:count]


def of_the_lens(loaded: LoadedStudy) -> None:
    """The same of the lens itself: fewer studies, all heights and ways of drawing scored together."""
    context, limit = context_of(loaded.lens, loaded.study), LIMITS_WAVES[0]

    def scored(method: str, seed: int, count: int) -> Array:
        own = loaded.study.model_copy(update={"draws": method, "seed": seed, "trials": count})
        return score_trials(context, own, range(count)).scores

    truth = np.mean(scored("random", 7, LENS_TRUTH) <= limit, axis=0)
    kept = {(m, s): scored(m, s, LENS_TRIALS) for m in DRAWS for s in range(1000, 1000 + LENS_REPEATS)}
    print(f"the lens itself, {LENS_REPEATS} studies of {LENS_TRIALS} trials:")
    for k, height in enumerate(HEIGHTS_MM):

        def passed(method: str, seed: int, k: int = k) -> NDArray[np.bool_]:
            return np.asarray(kept[method, seed][:, k] <= limit)

        coverage(f"{limit:g} waves at {height:g} mm", passed, float(truth[k]), LENS_REPEATS)


def rare(loaded: LoadedStudy, model: Callable[[Array], Array]) -> None:
    """Yields from chosen trials, where a model of few trials and of another kind says which may fail."""
    study = loaded.study
    values = sample_perturbations(study.model_copy(update={"seed": 11}), range(RARE_FITTED)).values
    scores = np.sqrt(np.maximum(model(values)[:, :1], 0.0))
    fitted = fit_response(values, scores)
    for limit in RARE_LIMITS_WAVES:
        merit = study.merits[0].model_copy(update={"at_most": limit})
        judged = study.model_copy(update={"all_merits": (merit,)})
        found, plain = [], []
        for seed in range(RARE_REPEATS):
            rng = np.random.default_rng(seed)
            drawn = modelled_trials(study, RARE_MODELLED, rng)
            chances = failure_probabilities(judged, fitted, values, scores, drawn)
            chosen, weights = draw_trials(chances, TRIALS, rng)
            failed = model(drawn[chosen])[:, 0] > limit**2
            share, _, trials = weighted_failures(failed, weights, RARE_MODELLED)
            found.append((1.0 - share, *wilson(1.0 - share, trials)))
            plain.append(trials)
        many = modelled_trials(study, RARE_TRUTH, np.random.default_rng(1))
        truth = float(np.mean(model(many)[:, 0] <= limit**2))
        held = np.mean([low <= truth <= high for _, low, high in found])
        print(
            f"{limit:g} waves on the axis, yield {truth:.5f}: {RARE_REPEATS} estimates of {TRIALS} chosen, "
            f"mean {np.mean([one[0] for one in found]):.5f}, held {100 * held:.1f} %, as sure as "
            f"{np.median(plain):.0f} plain trials"
        )


if __name__ == "__main__":
    main()
