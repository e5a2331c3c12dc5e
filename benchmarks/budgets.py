"""Budgets beside an independent search, and their yields in fresh trials.

The independent search minimizes the same cost by SciPy's COBYLA from several starts, without derivatives and
without smoothing: each candidate is scaled by the common factor that gives it the required yield, by lenses
of another seed.

With `--losses`, the studies are starting studies of `tolerancing start`, whose merits include a
reconstruction loss. They have 19 to 36 tolerances, and a trial takes 0.1 to 0.3 s, so that fewer trials are
used. COBYLA then minimizes the cost at a required yield of 2048 lenses, from the common factor, from a random
point, and from the budget's own tolerances, to see whether they can be improved. All ends are scaled to the
yield that 8192 lenses of another seed give the budget's tolerances.

    python -m benchmarks.budgets [--losses [LENS:GRADE:MOUNTING ...]] [--fresh 400]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from benchmarks.timing import Row, print_table
from lensdesign.common.arrays import Array
from tolerancing import load_study, start_study
from tolerancing.budgets.score_model import StudyScoreModel
from tolerancing.budgets.study_budget import SCALES, StudyBudget, budget_of_study, scaled_perturbations
from tolerancing.cost import cost_of, load_costs
from tolerancing.merits.base import all_passed
from tolerancing.statistics.scorer import ROWS_AT_ONCE
from tolerancing.statistics.yields import Yield, yield_of
from tolerancing.study.evaluate import context_of, score_trials
from tolerancing.study.files import LoadedStudy
from tolerancing.study.study import Study

LOSS_STUDIES = (
    "feasible_singlet:precision:nominal",
    "wide_field:precision:nominal",
    "paper_singlet:precision:nominal",
    "thinnest_singlet:precision:nominal",
)
LOSS_TRIALS, LOSS_VERIFY, LOSS_DRAWS, LOSS_EVALUATIONS = 140, 250, 2048, 600

ROOT = Path(__file__).parents[1]
REQUIRED, FRESH, STARTS, EVALUATIONS = 0.9, 4000, 2, 400

SPREAD = '\n[[merit]]\nkind = "largest_spread_deg"\nat_most = 7.75\n'
STUDIES = {
    "2 mm, NA 0.4, thinnest singlet": (ROOT / "tests" / "golden" / "designer_b" / "study.toml", SPREAD),
    "the paper's lens": (ROOT / "designs" / "as_built_tolerances.toml", ""),
}


def main() -> None:
    """Print a table for each study."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--losses", nargs="*", metavar="LENS:GRADE:MOUNTING")
    parser.add_argument("--fresh", type=int, default=400)
    given = parser.parse_args()
    if given.losses is not None:
        for name in given.losses or LOSS_STUDIES:
            print_table(name, _rows_of_losses(_started(name), given.fresh))
        return
    for name, (path, more) in STUDIES.items():
        with tempfile.TemporaryDirectory() as folder:
            print_table(name, _rows(_loaded(path, more, Path(folder))))


def _loaded(path: Path, more: str, folder: Path) -> LoadedStudy:
    for file in path.parent.glob("*.toml"):
        (folder / file.name).write_bytes(file.read_bytes())
    target = folder / path.name
    target.write_text(path.read_text(encoding="utf-8") + more, encoding="utf-8")
    return load_study(target)


def _started(name: str) -> LoadedStudy:
    lens, grade, mounting = name.split(":")
    with tempfile.TemporaryDirectory() as folder:
        design, study = Path(folder) / "lens.toml", Path(folder) / "study.toml"
        design.write_bytes((ROOT / "designs" / f"{lens}.toml").read_bytes())
        start_study(design, study, grade, mounting == "calibrated")
        return load_study(study)


def _rows_of_losses(loaded: LoadedStudy, fresh: int) -> list[Row]:
    lens, study = loaded.lens, loaded.study
    clock = time.process_time()
    trials = score_trials(context_of(lens, study), study, range(LOSS_TRIALS))
    before = yield_of(all_passed(study.merits, trials.scores))
    found = budget_of_study(lens, study, trials.values, trials.scores, REQUIRED, fresh=LOSS_VERIFY)
    seconds = time.process_time() - clock
    print("scales:", " ".join(f"{scale:.4g}" for scale in found.budget.scales), flush=True)
    assert before is not None
    assert found.verified is not None
    assert found.estimated_yield is not None
    own = StudyScoreModel(lens, study.replaced(seed=321), trials.values, trials.scores)
    own.refine(found.budget.scales)
    target = _yield_by(own, found.budget.scales)
    other, cost = _constrained(own, found, target)
    tested = _tested(loaded, found.budget.scales, fresh)
    return [
        Row("tolerances", float(len(other))),
        Row(f"yield of the study in {LOSS_TRIALS} trials", 100.0 * before.fraction, "%"),
        Row("cost of the study's tolerances", found.cost_before),
        Row("cost of the best common scale", found.uniform_cost or float("nan")),
        Row("cost of the budget", found.cost),
        Row("cost found by an independent search", cost),
        Row("ratio of the two", found.cost / cost, at_most=1.05),
        Row("yield of both by the model, other seed", 100.0 * target, "%"),
        Row("agrees (1: yes)", float(found.agrees)),
        Row("estimated yield", 100.0 * found.estimated_yield, "%"),
        Row(
            f"yield in the {found.verified.total} trials of the last round",
            100.0 * found.verified.fraction,
            "%",
        ),
        Row(f"yield in {fresh} fresh trials", 100.0 * tested.fraction, "%"),
        Row("95 % interval, from", 100.0 * tested.low, "%"),
        Row("95 % interval, to", 100.0 * tested.high, "%"),
        Row("distance of the yield from the requirement", 100.0 * abs(tested.fraction - REQUIRED), "points"),
        Row("rounds of verification", float(found.seed - study.seed)),
        Row("processor time of trials and budget", seconds, "s"),
    ]


def _yield_by(model: StudyScoreModel, scales: Array) -> float:
    return float(np.mean(all_passed(model.study.merits, model.scores(scales))))


def _tested(loaded: LoadedStudy, scales: Array, fresh: int) -> Yield:
    study = _scaled(loaded.study, scales, seed=987)
    found = yield_of(score_trials(context_of(loaded.lens, study), study, range(fresh)).passed)
    assert found is not None
    return found


def _constrained(model: StudyScoreModel, found: StudyBudget, target: float) -> tuple[Array, float]:
    """Return the cheapest scales of a constrained search without derivatives, and their cost."""
    from scipy.special import ndtri

    few = model.with_draws(LOSS_DRAWS)

    def scales_at(logarithms: Array) -> Array:
        return np.exp(np.clip(logarithms, *np.log(SCALES)))

    def excess(logarithms: Array) -> float:
        at = np.clip(_yield_by(few, scales_at(logarithms)), 0.5 / LOSS_DRAWS, 1.0 - 0.5 / LOSS_DRAWS)
        return float(ndtri(at) - ndtri(target))

    def cost(logarithms: Array) -> float:
        return float(np.sum(1.0 / scales_at(logarithms)))

    def normalized(logarithms: Array) -> Array:
        low, high = -1.0, 1.0
        for _ in range(16):
            middle = 0.5 * (low + high)
            kept = _yield_by(model, scales_at(logarithms + middle)) >= target
            low, high = (middle, high) if kept else (low, middle)
        return scales_at(logarithms + low)

    common = np.full(len(found.budget.scales), np.log(found.budget.uniform_scale or 0.3))
    rng = np.random.default_rng(4)
    starts = (common, common + 0.3 * rng.standard_normal(len(common)), np.log(found.budget.scales))
    unit = cost(common)
    ends = [
        normalized(
            minimize(
                lambda x: cost(x) / unit,
                start,
                method="COBYLA",
                constraints={"type": "ineq", "fun": excess},
                options={"maxiter": LOSS_EVALUATIONS, "rhobeg": 0.3 if start is not starts[2] else 0.1},
            ).x
        )
        for start in starts
    ]
    costs = [float(np.sum(1.0 / end)) for end in ends]
    print("costs from the common factor, a random point, the budget:", *(f"{one:.4g}" for one in costs))
    best = int(np.argmin(costs))
    return ends[best], costs[best]


def _rows(loaded: LoadedStudy) -> list[Row]:
    lens, study = loaded.lens, loaded.study
    priced = cost_of(study, lens, load_costs())
    weights, elements = {line.perturbation: line.cost for line in priced.lines}, float(priced.elements)
    trials = score_trials(context_of(lens, study), study, range(400))
    found = budget_of_study(lens, study, trials.values, trials.scores, REQUIRED, weights, base_cost=elements)
    other = _independent(loaded, np.array(list(weights.values())), elements)
    cost = elements + float(np.sum(np.array(list(weights.values())) / other))
    budget_yield, other_yield = (
        100.0 * float(np.mean(_passed(loaded, scales))) for scales in (found.budget.scales, other)
    )
    assert found.uniform_cost is not None  # all tolerances may be scaled
    return [
        Row("cost of the study's tolerances", found.cost_before),
        Row("cost of the best common scale", found.uniform_cost),
        Row("cost of the budget", found.cost),
        Row("cost found by an independent search", cost),
        Row("ratio of the two", found.cost / cost, at_most=1.02),
        Row(f"yield of the budget in {FRESH} fresh trials", budget_yield, "%"),
        Row("its distance from the requirement", abs(budget_yield - 100.0 * REQUIRED), "points", at_most=1.0),
        Row("yield of the independent search's tolerances", other_yield, "%"),
    ]


def _passed(loaded: LoadedStudy, scales: Array) -> Array:
    study = _scaled(loaded.study, scales, seed=987, draws="random")
    context = context_of(loaded.lens, study)
    parts = [range(start, start + ROWS_AT_ONCE) for start in range(0, FRESH, ROWS_AT_ONCE)]
    return np.concatenate([score_trials(context, study, part).passed for part in parts])[:FRESH]


def _scaled(study: Study, scales: Array, **changes: object) -> Study:
    return study.model_copy(update={"perturbations": scaled_perturbations(study, scales), **changes})


def _independent(loaded: LoadedStudy, weights: Array, elements: float) -> Array:
    """Scales of least cost by a search of another kind, on lenses of another seed."""

    study = loaded.study.model_copy(update={"seed": 321})
    model = StudyScoreModel(loaded.lens, study, np.zeros((0, len(weights))), np.zeros((0, len(study.merits))))

    def good(scales: Array) -> float:
        return float(np.mean(all_passed(study.merits, model.scores(scales))))

    def normalized(logarithms: Array, halvings: int = 11) -> Array:
        low, high = -1.5, 1.5
        for _ in range(halvings):
            middle = 0.5 * (low + high)
            kept = good(np.clip(np.exp(logarithms + middle), *SCALES)) >= REQUIRED
            low, high = (middle, high) if kept else (low, middle)
        return np.clip(np.exp(logarithms + low), *SCALES)

    def cost(logarithms: Array) -> float:
        return elements + float(np.sum(weights / normalized(logarithms)))

    rng = np.random.default_rng(4)
    ends = []
    for start in [np.zeros(len(weights)), *(0.3 * rng.standard_normal((STARTS - 1, len(weights))))]:
        found = minimize(cost, start, method="COBYLA", options={"maxiter": EVALUATIONS, "rhobeg": 0.4})
        ends.append((found.fun, found.x))
    return normalized(min(ends, key=lambda end: end[0])[1], 16)


if __name__ == "__main__":
    main()
