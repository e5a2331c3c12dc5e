"""Sections about trials: distributions, yield against tolerance scale, scatter plots and worst trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from tolerancing.merits.base import Merit, all_passed
from tolerancing.perturbations.draws import replicates
from tolerancing.report.blocks import (
    Block,
    Cell,
    FigureBlock,
    Heading,
    Paragraph,
    cut,
    joined,
    number_text,
    percent_text,
    table,
    yield_text,
)
from tolerancing.report.data import ReportData
from tolerancing.report.figures.style import merit_label
from tolerancing.report.figures.trials import (
    ALL_LIMITS,
    ScaleCurve,
    distribution_panel,
    scale_panel,
    scatter_panels,
)
from tolerancing.statistics.correlation import MOST_TRIALS
from tolerancing.statistics.response import Response, fit_response
from tolerancing.statistics.summary import PERCENTILES, MeritSummary, merit_summary
from tolerancing.statistics.yields import Yield, yield_of
from tolerancing.study.results import StepResults
from tolerancing.study.scaled_trials import SCALED_TRIALS

WORST_TRIALS = 12
"""Number of worst trials in a table."""

SCALES = np.linspace(0.25, 2.0, 36)
"""Common factors of all tolerances."""


def distribution_section(data: ReportData) -> list[Block]:
    """Return histograms of the merits with their limits, and their statistics."""
    blocks: list[Block] = [Heading("Distributions")]
    if not len(data.results):
        return [*blocks, Paragraph("Left out: the store holds no trials.")]
    pairs, singles = [], []
    for k, row in enumerate(data.summary.merits):
        panel, without = distribution_panel(data, row, k), _uncompensated(data, row.merit.column)
        if without is None:
            singles.append(panel)
        else:
            pairs += [panel, distribution_panel(data, row, k, without)]
    note = (
        "Bars: trials; orange: cumulative distribution; points at the foot: single trials. The bad side of "
        f"the limit is shaded. {data.drawn_text}"
    )
    rows, replicate_of = [], replicates(data.study.draws, data.results.trials)
    for row in data.summary.merits:
        rows.append(_statistics(row.merit.column, row))
        without = _uncompensated(data, row.merit.column)
        if without is not None:
            own = merit_summary(row.merit, None, without, replicate_of)
            rows.append(_statistics(f"{row.merit.column}, not compensated", own))
    headings = ["<Merit", "Scored", "Mean", "Std.", *(f"{p} %" for p in PERCENTILES), "Yield"]
    return [
        *blocks,
        Paragraph(note, soft=True),
        *(FigureBlock(tuple(panels), columns=2) for panels in (pairs, singles) if panels),
        table(headings, rows, "Percentiles over the trials with a score; the yield counts all trials."),
    ]


def _statistics(name: str, row: MeritSummary) -> list[str]:
    return [
        name,
        f"{row.scored:,}",
        number_text(row.mean),
        number_text(row.standard_deviation),
        *(number_text(row.percentiles.get(p)) for p in PERCENTILES),
        percent_text(row.good.fraction if row.good else None),
    ]


def _uncompensated(data: ReportData, column: str) -> Array | None:
    """Return the scores without refocusing and compensators; None if the study has none."""
    names = list(data.study.extra_columns)
    name = f"{column}_uncompensated"
    return data.results.extras[:, names.index(name)] if name in names else None


def scale_section(data: ReportData) -> list[Block]:
    """Return the yield over a common factor of all tolerances: trials at some factors, and models of them."""
    blocks: list[Block] = [Heading("Yield against tolerance scale")]
    if not len(data.results):
        return [*blocks, Paragraph("Left out: the store holds no trials.")]
    points = _yields_by_factor(data)
    models, unmodelled = _models(data)
    lines = _modelled(data, models)
    names = {m.label: merit_label(m) for m in data.study.merits}
    curves = [ScaleCurve(names[label], points[label], lines.get(label)) for label in names]
    curves.append(ScaleCurve(ALL_LIMITS, points[ALL_LIMITS], lines.get(ALL_LIMITS)))
    shown = [curve for curve in curves if curve.fractions is not None or len(curve.points) > 1]
    text = []
    if models:
        qualities = [
            f"{names[label]} {model.cross_validated_r_squared[0]:.2f}" for label, model in models.items()
        ]
        text.append(
            "Full lines: a second-order model of the trials predicts the scores of the same lenses with all "
            "deviations multiplied by the factor. What it leaves of a trial's score is multiplied by the "
            "third power of the factor, the first that the model omits, so that the yield at 1 is that of "
            "the trials. For factors above 1 the model is extrapolated. Trials without a score are not in "
            f"the model, and miss their limits. Cross-validated R²: {joined(qualities)}."
        )
    if unmodelled:
        text.append(f"Merits without a line of a model: {'; '.join(unmodelled)}.")
    if len(points[ALL_LIMITS]) == 1:
        text.append(
            "The store holds no trials at other factors; a table [scaled_trials] of the study adds them."
        )
    if not shown:
        return [*blocks, Paragraph(" ".join(text), soft=True)]
    text.append("Points: yields of trials, with their 95 % intervals.")
    factors = [factor for factor, _ in points[ALL_LIMITS]]
    rows = [
        [curve.name, *(yield_text(dict(curve.points).get(factor)) for factor in factors)] for curve in curves
    ]
    headings = ["<Limit", *(f"{factor:g} × tolerances" for factor in factors)]
    return [
        *blocks,
        Paragraph(" ".join(text), soft=True),
        FigureBlock((scale_panel(SCALES, shown),)),
        table(headings, rows, "Yields of trials with all tolerances multiplied."),
    ]


def _yields_by_factor(data: ReportData) -> dict[str, tuple[tuple[float, Yield], ...]]:
    """Return the yields of trials at each factor, by the merit's label, and those of all limits."""
    merits, steps = data.study.merits, data.steps_of(SCALED_TRIALS)
    by_factor: dict[float, list[StepResults]] = {}
    for step in steps:
        by_factor.setdefault(float(step.coordinates["tolerance_factor"]), []).append(step)
    found: dict[str, list[tuple[float, Yield]]] = {
        name: [] for name in (*(m.label for m in merits), ALL_LIMITS)
    }
    for factor, own in by_factor.items():
        scores = np.array([[step.scores.get(m.label, np.nan) for m in merits] for step in own])
        trials = [int(step.coordinates["trial"]) for step in own]
        passed = {m.label: m.passed(scores[:, k]) for k, m in enumerate(merits)}
        passed[ALL_LIMITS] = all_passed(merits, scores)
        for name, good in passed.items():
            value = yield_of(good, replicates(data.study.draws, trials))
            assert value is not None  # there are trials
            found[name].append((factor, value))
    for row in data.summary.merits:
        if row.good is not None:
            found[row.merit.label].append((1.0, row.good))
    if data.summary.good is not None:
        found[ALL_LIMITS].append((1.0, data.summary.good))
    return {name: tuple(sorted(own, key=lambda pair: pair[0])) for name, own in found.items()}


def _modelled(data: ReportData, models: dict[str, Response]) -> dict[str, Array]:
    """Return the yield by the models at each of `SCALES`, by label, and of all limits if all have one."""
    sampled = _sample(len(data.results))
    values, scores = data.results.values[sampled], data.results.scores[sampled]
    centre = np.array([p.distribution.centre for p in data.study.perturbations])
    merits = {m.label: m for m in data.study.merits}
    own_scores = dict(zip(merits, scores.T, strict=True))
    unexplained = {label: own_scores[label] - m.predict(values)[:, 0] for label, m in models.items()}
    passed_by_scale: dict[str, list[NDArray[np.bool_]]] = {label: [] for label in models}
    for scale in SCALES:
        scaled = centre + scale * (values - centre)
        for label, model in models.items():
            predicted = model.predict(scaled)[:, 0] + scale**3 * unexplained[label]
            passed_by_scale[label].append(merits[label].passed(predicted))
    found = {label: np.mean(passed, axis=1) for label, passed in passed_by_scale.items()}
    if len(models) == len(merits):
        found[ALL_LIMITS] = np.mean(np.all(list(passed_by_scale.values()), axis=0), axis=1)
    return found


def _sample(count: int) -> slice:
    """Select at most 5000 evenly spaced trials for the model."""
    return slice(None, None, max(1, -(-count // 5000)))


def _models(data: ReportData) -> tuple[dict[str, Response], list[str]]:
    """Return the models by merit, and the reasons why other merits have none."""
    models: dict[str, Response] = {}
    too_few, too_little = list[str](), list[str]()
    # What a model leaves grows with a power of the factor that is not known, so it must be small.
    smallest_r_squared = 0.95
    chosen = _sample(len(data.results))
    for k, merit in enumerate(data.study.merits):
        try:
            model = fit_response(data.results.values[chosen], data.results.scores[chosen, k : k + 1])
        except InputError:
            too_few.append(merit.column)
            continue
        quality = float(model.cross_validated_r_squared[0])
        if quality >= smallest_r_squared:
            models[merit.label] = model
        else:
            too_little.append(f"{merit.column} (R² {quality:.2f})")
    reasons = {"too few scores for a model": too_few, "a model explains too little": too_little}
    return models, [f"{joined(labels)} ({reason})" for reason, labels in reasons.items() if labels]


def scatter_section(data: ReportData) -> list[Block]:
    """Return scatter plots of each merit against the perturbations with the strongest correlation."""
    blocks: list[Block] = [Heading("Merits against perturbations")]
    if not len(data.results):
        return [*blocks, Paragraph("Left out: the store holds no trials.")]
    count = min(8, len(data.study.perturbations))
    note = (
        f"For each merit, the {count} perturbations with the strongest correlation, the strongest first. Red "
        "points miss the limit (red line). ρ is Spearman's rank correlation with the deviation, and with its "
        "magnitude, which shows perturbations that harm in both directions. "
        f"{_ranked_text(len(data.results))}{data.drawn_text}"
    )
    blocks.append(Paragraph(note.strip(), soft=True))
    for k, merit in enumerate(data.study.merits):
        blocks.append(Heading(merit.column, 3))
        blocks.append(FigureBlock(tuple(scatter_panels(data, k, count)), columns=4))
    return blocks


def _ranked_text(count: int) -> str:
    if count <= MOST_TRIALS:
        return ""
    return f"Ranks: of at most {MOST_TRIALS:,} trials, evenly spaced among all. "


def worst_section(data: ReportData, pictures: Callable[[ReportData, list[int]], list[Block]]) -> list[Block]:
    """Return the worst trials, with pictures of line pairs.

    Parameters
    ----------
    data
        Data of the report.
    pictures
        Function that returns pictures of trials, given by their row indices.
    """
    blocks: list[Block] = [Heading("Worst trials")]
    if not len(data.results):
        return [*blocks, Paragraph("Left out: the store holds no trials.")]
    rows: list[list[Cell | str]] = []
    for row in data.by_badness[:WORST_TRIALS].tolist():
        scores = data.results.scores[row]
        causes, message = data.causes(row), data.results.messages[row]
        rows.append(
            [
                str(data.trial_numbers[row]),
                *(
                    Cell(score_text(m, v), failed=not bool(m.passed(v)))
                    for m, v in zip(data.study.merits, scores, strict=True)
                ),
                Cell(cut(f"{causes}. Not scored: {message}"), failed=True) if message else causes,
            ]
        )
    caption = (
        "Trials farthest on the bad side of any limit, in standard deviations of that merit. Trials that "
        "could not be scored come first. Deviations are in standard deviations σ of their distribution."
    )
    headings = ["<Trial", *(m.column for m in data.study.merits), "<Largest deviations"]
    blocks += [table(headings, rows, caption), *_failures(data), *pictures(data, pictured_trials(data))]
    return blocks


def score_text(merit: Merit, score: float) -> str:
    """Format a score with enough digits to show on which side of the limit it is."""
    for digits in (4, 6, 9, 17):  # 17 digits distinguish all numbers.
        if bool(merit.passed(float(f"{score:.{digits}g}"))) == bool(merit.passed(score)):
            break
    return number_text(score, digits)


def pictured_trials(data: ReportData) -> list[int]:
    """Return the row indices of the three worst trials that have scores, and of the median one."""
    scored = [i for i in data.by_badness.tolist() if np.isfinite(data.badness[i])]
    chosen = scored[:3]
    if len(scored) > 3:
        chosen.append(scored[len(scored) // 2])
    return chosen


def _failures(data: ReportData) -> list[Block]:
    counts = Counter(message for message in data.results.messages if message)
    if not counts:
        return []
    rows = [[message, f"{count:,}"] for message, count in counts.most_common(WORST_TRIALS)]
    return [Heading("Why trials could not be scored", 3), table(["<Message", "Trials"], rows)]
