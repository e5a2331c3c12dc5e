"""Sections about the tolerances of a study, and about the effect of each perturbation alone."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from lensdesign.common.text import name_with_unit, number_with_unit
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
    table,
    yield_text,
)
from tolerancing.report.data import ReportData
from tolerancing.report.figures.trials import bars_panel
from tolerancing.statistics.sensitivities import Sensitivity, compare_with_trials, root_sum_square
from tolerancing.statistics.summary import mean_and_deviation


def tolerance_section(data: ReportData) -> list[Block]:
    """Return the perturbations with their distributions and draws, the correlations and the compensators."""
    caption = (
        "Deviations from nominal. T is the tolerance, the largest deviation that counts as allowed. Drawn: "
        "statistics over the trials of this store."
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
        name_with_unit(p.quantity, p.unit),
        distribution_text(p),
        number_text(p.distribution.largest),
        number_text(p.distribution.standard_deviation),
        p.group or "–",
        *map(number_text, mean_and_deviation(drawn)),
        number_text(extreme),
    ]


def distribution_text(perturbation: Perturbation) -> str:
    """Describe a distribution, as in `normal, sigma 0.01 mm`."""
    distribution = perturbation.distribution
    terms = [distribution.kind.replace("_", " ")]
    for name in type(distribution).model_fields:
        value = getattr(distribution, name)
        if name == "mean" and not value:
            continue
        label = name.replace("_", " ")
        if isinstance(value, float):
            terms.append(number_with_unit(f"{label} {value:g}", perturbation.unit))
        elif isinstance(value, tuple):
            listed = ", ".join(f"{one:g}" for one in value)
            terms.append(number_with_unit(f"{label} {listed}", perturbation.unit))
        else:
            terms.append(f"{label} {value}")
    return ", ".join(terms)


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
        values = data.results.extras[:, names.index(f"compensator_{c.column}")]
        known = values[np.isfinite(values)]
        at_limit = float(np.mean(np.abs(known) >= (1.0 - 1e-6) * c.limit)) if len(known) else None
        rows.append(
            [
                c.column,
                c.target,
                number_with_unit(f"±{c.limit:g}", c.unit),
                *map(number_text, mean_and_deviation(known)),
                Cell(percent_text(at_limit), failed=bool(at_limit)),
            ]
        )
    caption = "Values of the compensators, fitted in each trial so that the model matches the perturbed lens."
    headings = ["<Compensator", "<Target", "Limit", "Mean", "Std.", "Trials at the limit"]
    return [Heading("Compensators", 3), table(headings, rows, caption)]


def sensitivity_section(data: ReportData) -> list[Block]:
    """Return the effect of each perturbation alone, and the prediction for all of them together."""
    blocks: list[Block] = [Heading("Sensitivities")]
    found = data.sensitivity
    if found is None:
        reason = (
            "has sensitivity = false"
            if not data.study.sensitivity
            else "has not finished them, or lacks a nominal score"
        )
        return [*blocks, Paragraph(f"Left out: the study {reason}.")]
    blocks.append(
        Paragraph(
            "Each perturbation is varied alone, at ±T/2 and ±T (T: its tolerance), while everything else is "
            "nominal. A parabola through these scores and the nominal score gives the contribution to a "
            "merit's mean and variance. Perturbations are listed by their harm within T.",
            soft=True,
        )
    )
    blocks += [Warning(one.sentence) for one in data.approximations]
    ranking = found.ranking(data.study.merits)
    blocks.append(FigureBlock(tuple(_bars(data, found, ranking, m) for m in range(len(ranking))), columns=2))
    blocks.append(Paragraph("The appendix has the changes, derivatives and fits of all perturbations."))
    return [*blocks, *_root_sum_square(data, found)]


def coefficient_appendix(data: ReportData) -> list[Block]:
    """Return the coefficients of all sensitivities, one table for each merit."""
    found = data.sensitivity
    if found is None:
        return []
    ranking = found.ranking(data.study.merits)
    tables = [_sensitivities(data, found, ranking, m) for m in range(len(ranking))]
    return [Heading("Appendix: coefficients of the sensitivities"), *tables]


def _bars(data: ReportData, found: Sensitivity, ranking: np.ndarray, m: int):  # type: ignore[no-untyped-def]
    order = ranking[m][:20]  # The table has all perturbations.
    shown = [data.study.perturbations[k] for k in order]
    return bars_panel(shown, found.change[order][:, [0, -1], m], data.study.merits[m])


def _sensitivities(data: ReportData, found: Sensitivity, ranking: np.ndarray, m: int) -> Table:
    variance = np.nan_to_num(found.standard_deviation[:, m]) ** 2
    total = float(variance.sum())
    rows = []
    for k in ranking[m]:
        largest = data.study.perturbations[k].distribution.largest
        # Smaller changes are rounding errors, or have no effect.
        least = 1e-6 * np.nanmax(np.abs(found.change[:, :, m]), initial=0.0)
        powers = [least, least / largest, least / largest**2]
        parabola = [_clean(c, p) for c, p in zip(found.coefficients[k, :, m], powers, strict=True)]
        fraction = float(variance[k]) / total if total > 0.0 else float("nan")
        rows.append(
            [
                data.study.perturbations[k].column,
                _clean(found.derivative[k, m], powers[1]),
                *(_clean(v, least) for v in found.change[k, [0, -1], m]),
                *parabola,
                number_text(found.residual[k, m], 2),
                _clean(found.mean_shift[k, m], least),
                number_text(found.standard_deviation[k, m]),
                percent_text(fraction),
            ]
        )
    merit = data.study.merits[m]
    headings = [
        f"<{merit.column}", "Derivative", "at −T", "at +T", "Fit: 1", "x", "x²", "Residual", "Mean shift",
        "Std.", "Of variance",
    ]  # fmt: skip
    caption = (
        f"Changes of {name_with_unit(merit.column, merit.unit)}. Derivative and fit are per unit x of the "
        "perturbation. Residual: rms deviation from the parabola. Where it is not small compared with the "
        "changes, mean shift and standard deviation are rough."
    )
    return table(headings, rows, caption)


def _clean(value: float, least: float) -> str:
    """Format a signed number; 0 if its magnitude is below `least`."""
    return "0" if abs(value) < least else signed_text(value)


def _root_sum_square(data: ReportData, found: Sensitivity) -> list[Block]:
    predicted = root_sum_square(found, data.study.merits)
    own = replicates(data.study.draws, data.results.trials)
    compared = compare_with_trials(predicted, data.results.scores, own)
    rows = [
        [
            c.merit.column,
            number_text(c.predicted_mean),
            f"{number_text(c.mean)} ± {number_text(c.standard_error, 2)}",
            number_text(c.predicted_standard_deviation),
            number_text(c.standard_deviation),
            percent_text(c.predicted_yield),
            yield_text(c.good),
        ]
        for c in compared
    ]
    headings = [
        "<Merit", "Mean: predicted", "trials", "Std.: predicted", "trials", "Yield: predicted", "trials"
    ]  # fmt: skip
    caption = (
        "Root sum square: mean shifts add, standard deviations add in squares, and scores are taken as "
        "normally distributed. For a root mean square, the squares add. Products of perturbations are "
        "neglected. ± is the standard error of the mean."
    )
    if data.study.correlations or any(p.group for p in data.study.perturbations):
        caption += " Perturbations are taken as independent, although some of this study are not."
    return [Heading("Root sum square and Monte Carlo", 3), table(headings, rows, caption)]
