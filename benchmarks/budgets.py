"""Budgets beside an independent search, and their yields in 4,000 fresh trials.

The independent search minimizes the same cost by SciPy's COBYLA from several starts, without derivatives and
without smoothing: each candidate is scaled by the common factor that gives it the required yield, by lenses
of another seed.

    python -m benchmarks.budgets
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from benchmarks.timing import Row, print_table
from lensdesign.common.arrays import Array
from tolerancing import load_study
from tolerancing.budgets.score_model import StudyScoreModel
from tolerancing.budgets.study_budget import SCALES, budget_of_study, scaled_perturbations
from tolerancing.cost import cost_of, load_costs
from tolerancing.merits.base import all_passed
from tolerancing.statistics.scorer import ROWS_AT_ONCE
from tolerancing.study.evaluate import context_of, score_trials
from tolerancing.study.files import LoadedStudy
from tolerancing.study.study import Study

ROOT = Path(__file__).parents[1]
REQUIRED, FRESH, STARTS, EVALUATIONS = 0.9, 4000, 2, 400

SPREAD = '\n[[merit]]\nkind = "largest_spread_deg"\nat_most = 7.75\n'
STUDIES = {
    "2 mm, NA 0.4, thinnest singlet": (ROOT / "tests" / "golden" / "designer_b" / "study.toml", SPREAD),
    "the paper's lens": (ROOT / "designs" / "as_built_tolerances.toml", ""),
}


def main() -> None:
    """Print a row for each study."""
    for name, (path, more) in STUDIES.items():
        with tempfile.TemporaryDirectory() as folder:
            print_table(name, _rows(_loaded(path, more, Path(folder))))


def _loaded(path: Path, more: str, folder: Path) -> LoadedStudy:
    for file in path.parent.glob("*.toml"):
        (folder / file.name).write_bytes(file.read_bytes())
    target = folder / path.name
    target.write_text(path.read_text(encoding="utf-8") + more, encoding="utf-8")
    return load_study(target)


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
