"""Sections 3 and 4 of a report: what scatters, and what each perturbation does by itself."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from tolerancing.perturbations.draws import replicates
from tolerancing.perturbations.parameters import Perturbation
from tolerancing.report.blocks import (
    Block,
    Cell,
    FigureBlock,
    Heading,
    Paragraph,
    Table,
    Warning,
    number_text,
    percent_text,
    signed_text,
    span_text,
    table,
)
from tolerancing.report.data import ReportData
from tolerancing.report.figures.trials import bars_panel
from tolerancing.statistics.quadratic_response import Sensitivity, compare_with_trials, root_sum_square
from tolerancing.statistics.summary import mean_and_deviation

MOST_BARS = 20
"""Perturbations in a figure of bars; the table has them all."""

NEGLIGIBLE = 1e-6
"""Share of a merit's largest change below which a change is rounding, or nothing to speak of."""

AT_LIMIT = 1.0 - 1e-6
"""Share of its limit from which a compensator counts as being there."""


def tolerance_section(data: ReportData) -> list[Block]:
    """What scatters and how, what was drawn, what depends on what, what is compensated."""
    caption = (
        "Deviations from nominal. T is the tolerance, the largest deviation that counts as allowed; drawn: "
        "over the trials of this store."
    )
    headings = [
        "<Perturbation", "<Target", "<Quantity", "<Distribution", "T", "Std.", "<Group", "Drawn mean",
        "Drawn std.", "Drawn extreme",
    ]  # fmt: skip
    rows = [_perturbation(data, k) for k in range(len(data.study.perturbations))]
    return [
        Heading("Tolerances"),
        table(headings, rows, caption),
        *_correlations(data),
        *_compensators(data),
    ]


def _perturbation(data: ReportData, k: int) -> list[str]:
    p, drawn = data.study.perturbations[k], data.results.values[:, k]
    extreme = float(drawn[np.argmax(np.abs(drawn))]) if len(drawn) else None
    return [
        p.column,
        p.target,
        f"{p.quantity} ({p.unit})" if p.unit else p.quantity,
        distribution_text(p),
        number_text(p.distribution.largest),
        number_text(p.distribution.standard_deviation),
        p.group or "–",
        *map(number_text, mean_and_deviation(drawn)),
        number_text(extreme),
    ]


def distribution_text(perturbation: Perturbation) -> str:
    """`normal, sigma 0.01 mm` and the like."""
    distribution = perturbation.distribution
    parts = [distribution.kind.replace("_", " ")]
    for name in type(distribution).model_fields:
        value = getattr(distribution, name)
        if name == "mean" and not value:
            continue
        words = name.replace("_", " ")
        if isinstance(value, float):
            parts.append(f"{words} {value:g} {perturbation.unit}".strip())
        elif isinstance(value, tuple):
            listed = ", ".join(f"{one:g}" for one in value)
            parts.append(f"{words} {listed} {perturbation.unit}".strip())
        else:
            parts.append(f"{words} {value}")
    return ", ".join(parts)


def _correlations(data: ReportData) -> list[Block]:
    rows = [
        [f"{a} and {b}", f"{correlation.full_matrix()[i, j]:+.2f}".replace("-", "−")]
        for correlation in data.study.correlations
        for (i, a), (j, b) in combinations(enumerate(correlation.names), 2)
    ]
    if not rows:
        return []
    return [Heading("Correlations", 3), table(["<Perturbations", "Coefficient"], rows)]


def _compensators(data: ReportData) -> list[Block]:
    compensators = data.study.compensators
    if not compensators:
        return []
    names = list(data.study.extra_columns)
    rows: list[list[Cell | str]] = []
    for c in compensators:
        taken = data.results.extras[:, names.index(f"compensator_{c.column}")]
        known = taken[np.isfinite(taken)]
        edge = float(np.mean(np.abs(known) >= AT_LIMIT * c.limit)) if len(known) else None
        rows.append(
            [
                c.column,
                c.target,
                f"±{c.limit:g} {c.unit}".strip(),
                *map(number_text, mean_and_deviation(known)),
                Cell(percent_text(edge), failed=bool(edge)),
            ]
        )
    caption = "What the reconstruction's model took over, trial by trial, so as to fit the lens as it is."
    headings = ["<Compensator", "<Target", "Limit", "Mean taken", "Std. taken", "Trials at the limit"]
    return [Heading("Compensators", 3), table(headings, rows, caption)]


def sensitivity_section(data: ReportData) -> list[Block]:
    """What each perturbation does by itself, and what follows for all of them together."""
    blocks: list[Block] = [Heading("Sensitivities")]
    found = data.sensitivity
    if found is None:
        why = (
            "asks for none"
            if not data.study.sensitivity
            else "has not finished them, or lacks a nominal score"
        )
        return [*blocks, Paragraph(f"Left out: the study {why}.")]
    blocks.append(
        Paragraph(
            "Each perturbation by itself, all else nominal, at ±T/2 and ±T (T: its tolerance). A parabola "
            "fitted to these and the nominal lens gives what it adds to a merit's mean and variance. "
            "Perturbations stand in order of their harm within T.",
            soft=True,
        )
    )
    blocks += [Warning(one.sentence) for one in data.approximations]
    ranking = found.ranking(data.study.merits)
    blocks.append(FigureBlock(tuple(_bars(data, found, ranking, m) for m in range(len(ranking))), columns=2))
    blocks += [_sensitivities(data, found, ranking, m) for m in range(len(ranking))]
    return [*blocks, *_root_sum_square(data, found)]


def _bars(data: ReportData, found: Sensitivity, ranking: np.ndarray, m: int):  # type: ignore[no-untyped-def]
    order = ranking[m][:MOST_BARS]
    shown = [data.study.perturbations[k] for k in order]
    return bars_panel(shown, found.change[order][:, [0, -1], m], data.study.merits[m])


def _sensitivities(data: ReportData, found: Sensitivity, ranking: np.ndarray, m: int) -> Table:
    variance = np.nan_to_num(found.standard_deviation[:, m]) ** 2
    total = float(variance.sum())
    rows = []
    for k in ranking[m]:
        largest = data.study.perturbations[k].distribution.largest
        least = NEGLIGIBLE * np.nanmax(np.abs(found.change[:, :, m]), initial=0.0)
        powers = [least, least / largest, least / largest**2]
        parabola = [_clean(c, p) for c, p in zip(found.coefficients[k, :, m], powers, strict=True)]
        share = float(variance[k]) / total if total > 0.0 else float("nan")
        rows.append(
            [
                data.study.perturbations[k].column,
                _clean(found.derivative[k, m], powers[1]),
                *(_clean(v, least) for v in found.change[k, [0, -1], m]),
                *parabola,
                number_text(found.residual[k, m], 2),
                _clean(found.mean_shift[k, m], least),
                number_text(found.standard_deviation[k, m]),
                percent_text(share),
            ]
        )
    merit = data.study.merits[m]
    unit = f" ({merit.unit})" if merit.unit else ""
    headings = [
        f"<{merit.column}", "Derivative", "at −T", "at +T", "Fit: 1", "x", "x²", "Residual", "Mean shift",
        "Std.", "Of variance",
    ]  # fmt: skip
    caption = (
        f"Changes of {merit.column}{unit}. Derivative and fit: per unit x of the perturbation. Residual: rms "
        "of what the parabola leaves over; where that is not small against them, what follows is rough."
    )
    return table(headings, rows, caption)


def _clean(value: float, least: float) -> str:
    """A signed number, 0 below the least that counts."""
    return "0" if abs(value) < least else signed_text(value)


def _root_sum_square(data: ReportData, found: Sensitivity) -> list[Block]:
    predicted = root_sum_square(found, data.study.merits)
    own = replicates(data.study.draws, data.results.trials)
    compared = compare_with_trials(predicted, data.results.scores, own)
    rows = []
    for c in compared:
        good = c.good
        rows.append(
            [
                c.merit.column,
                number_text(c.predicted_mean),
                f"{number_text(c.mean)} ± {number_text(c.standard_error, 2)}",
                number_text(c.predicted_standard_deviation),
                number_text(c.standard_deviation),
                percent_text(c.predicted_share),
                f"{percent_text(good.share)} ({span_text(good.low, good.high)})" if good else "–",
            ]
        )
    headings = [
        "<Merit", "Mean: predicted", "trials", "Std.: predicted", "trials", "Yield: predicted", "trials"
    ]  # fmt: skip
    caption = (
        "Root sum square: mean shifts add, standard deviations add in squares, scores count as normally "
        "distributed; of a root mean square it is the squares that add. Products of perturbations are left "
        "out. ± is the standard error of the mean."
    )
    if data.study.correlations or any(p.group for p in data.study.perturbations):
        caption += " Perturbations count as independent, though some of this study are not."
    return [Heading("Root sum square beside Monte Carlo", 3), table(headings, rows, caption)]
