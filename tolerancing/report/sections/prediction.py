"""Section about predictions from the nominal lens: yield, wavefronts, and tolerances that may be loosened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lensdesign.common.input_files import TABLE_BYTES, check_input
from lensdesign.common.tables import read_number, read_table
from lensdesign.common.text import quantity_label
from lensdesign.errors import InputError
from lensdesign.plots.style import BLUE, GREY, RED, styled_figure
from tolerancing.report.blocks import (
    Block,
    FigureBlock,
    Heading,
    Panel,
    Paragraph,
    Warning,
    number_text,
    percent_text,
    table,
    yield_text,
)
from tolerancing.report.data import ReportData
from tolerancing.report.figures.style import chart_style
from tolerancing.statistics.summary import Summary

if TYPE_CHECKING:
    from tolerancing.prediction.study_prediction import StudyPrediction
    from tolerancing.prediction.wavefront_prediction import WavefrontPrediction


@dataclass(frozen=True)
class Front:
    """Lenses of an exploration by `lensdesign explore`.

    Attributes
    ----------
    columns : (str, str)
        Names of the two objectives, with units.
    lenses : tuple of (float, float, bool)
        Values of the objectives, and whether the lens is on the front.
    """

    columns: tuple[str, str]
    lenses: tuple[tuple[float, float, bool], ...]


def read_front(path: Path) -> Front:
    """Read the front from the output folder of an exploration, or from its file ``front.csv``.

    Raises
    ------
    InputError
        If the file does not exist, or is no front that `lensdesign explore` wrote.
    """
    file = path / "front.csv" if path.is_dir() else path
    try:
        check_input(file, TABLE_BYTES)
        read = read_table(file)
        first, last = _objectives(read.names)
        columns = (read.column(name) for name in (first, last, "on_front"))
        lenses = tuple(
            (read_number(x[0], x[1], first), read_number(y[0], y[1], last), on_front[0] == "1")
            for x, y, on_front in zip(*columns, strict=True)
        )
    except InputError as error:
        raise InputError(f"{file}: is no front written by lensdesign explore: {error}") from None
    return Front((first, last), lenses)


def _objectives(names: Sequence[str]) -> tuple[str, str]:
    """Return the names of the first and the last objective among the columns of a front."""
    own = [name for name in names if name not in ("design", "glasses", "on_front")]
    if not own:
        raise InputError("it has no column with an objective")
    return own[0], own[-1]


def prediction_section(
    data: ReportData, original: Summary | None = None, front: Front | None = None
) -> list[Block]:
    """Compare predictions with trials, and show which tolerances may be loosened.

    The section is empty if nothing of the study can be predicted and there is no other lens to compare.

    Parameters
    ----------
    data
        Data of the report.
    original
        Summary of the store of another lens, such as the start of the optimization.
    front
        Lenses of an exploration.
    """
    found = _prediction(data)
    blocks = [*_comparison(data, original), *_predicted(data, found), *_on_front(data, front, found)]
    return [Heading("Predicted from the design"), *blocks] if blocks else []


def _comparison(data: ReportData, original: Summary | None) -> list[Block]:
    if original is None:
        return []
    others = {m.merit.label: m for m in original.merits}
    rows = []
    for own in data.summary.merits:
        other = others.get(own.merit.label)
        if other is None:
            continue
        rows.append(
            [
                own.merit.label,
                number_text(other.nominal),
                number_text(other.mean),
                percent_text(other.good.fraction if other.good else None),
                number_text(own.nominal),
                number_text(own.mean),
                percent_text(own.good.fraction if own.good else None),
            ]
        )
    title = original.study.title or original.study.design
    headings = ["<Merit", "Start", "Start, mean", "Start, good", "This", "This, mean", "This, good"]
    return [table(headings, rows, f"This lens compared with the start: {title}.")]


def _prediction(data: ReportData) -> StudyPrediction | None:
    """Return the prediction for the lens; None if nothing of the study can be predicted."""
    from tolerancing.prediction.study_prediction import predict_study

    try:
        return predict_study(data.lens, data.study)
    except InputError:
        return None


def _predicted(data: ReportData, found: StudyPrediction | None) -> list[Block]:
    if found is None:
        return []
    blocks = [*_predicted_yield(data, found), *_loosened(data, found)]
    if found.wavefronts is not None:
        blocks += _predicted_wavefronts(found.wavefronts)
    if found.wavefronts is not None and not found.wavefronts.second_order_suffices:
        error = percent_text(found.wavefronts.relative_error)
        blocks.append(Warning(f"These tolerances are too large: predicted wavefronts differ by {error}."))
    if not all(ray.first_order_suffices for ray in found.rays):
        error = percent_text(max(ray.relative_error for ray in found.rays))
        text = f"predicted rays differ from traced ones by {error} of their deviation."
        blocks.append(Warning(f"These tolerances are too large: {text}"))
    return blocks


def _predicted_yield(data: ReportData, found: StudyPrediction) -> list[Block]:
    """Compare the predicted joint yield, and the yield of each limit, with those of the trials."""
    good = {row.merit.label: row.good for row in data.summary.merits}
    predicted = {one.merit.label: percent_text(one.yield_fraction) for one in found.limits}
    rows = [
        [
            merit.label,
            merit.limit_text,
            merit.location,
            predicted.get(merit.label, "not predicted"),
            yield_text(good[merit.label]),
        ]
        for merit in data.study.merits
    ]
    joint = found.joint
    together = "not predicted" if joint is None else yield_text(joint)
    rows.append(["all limits", "", "", together, yield_text(data.summary.good)])
    if joint is None:
        text = f"The yield is not predicted without trials: {found.reason}."
    else:
        text = (
            f"Predicted from the rays of the nominal lens, without trials: {percent_text(joint.fraction)} of "
            f"lenses keep all limits at once ({joint.draws:,} drawn lenses)."
        )
    headings = ["<Merit", "<Limit", "<Field points", "Predicted", "Trials"]
    caption = "Yield of each limit, and of all limits at once, with 95 % intervals."
    return [Paragraph(text), table(headings, rows, caption)]


def _loosened(data: ReportData, found: StudyPrediction) -> list[Block]:
    """Return the yield with each tolerance halved and doubled, the most effective first.

    The first-order model of the table knows limits on wavefronts and rays only.
    """
    from tolerancing.budgets.loosening import loosen_each
    from tolerancing.prediction.study_prediction import is_scored_at_once

    if found.joint is None or not all(is_scored_at_once(merit) for merit in data.study.merits):
        return []
    loosened = sorted(loosen_each(data.lens, data.study), key=lambda one: one.doubled - one.halved)
    rows = [[one.perturbation, percent_text(one.halved), percent_text(one.doubled)] for one in loosened]
    caption = (
        f"The predicted yield of {percent_text(found.joint.fraction)} with each tolerance halved or doubled, "
        "all others unchanged. A tolerance may be loosened if the yield changes little when it is doubled."
    )
    return [table(["<Perturbation", "Yield, if halved", "Yield, if doubled"], rows, caption)]


def _predicted_wavefronts(found: WavefrontPrediction) -> list[Block]:
    points = [
        [
            "({:g}, {:g})".format(*p.judged.field_mm),
            number_text(p.rms_waves),
            number_text(p.judged.limit_waves),
            percent_text(p.good),
        ]
        for p in found.points
    ]
    worst = max(found.points, key=lambda p: p.rms_waves / p.judged.limit_waves)
    order = np.argsort(-worst.shares)
    drivers = [[found.perturbations[k], percent_text(float(worst.shares[k]))] for k in order]
    return [
        table(
            ["<Object point (mm)", "Rms (waves)", "Limit (waves)", "Good"],
            points,
            "Rms of the wavefront over pupil and lenses without shift and focus, and its limit. "
            "A limit on the Strehl ratio S is converted to a root mean square by S = exp(−(2π rms)²).",
        ),
        table(
            ["<Perturbation", "Fraction of rms squared"],
            drivers,
            "Contribution of each perturbation to the mean square of the wavefront at the worst object "
            "point.",
        ),
    ]


def _on_front(data: ReportData, front: Front | None, found: StudyPrediction | None) -> list[Block]:
    if front is None:
        return []
    own = {"thickness_mm": data.lens.exit_vertex_z_mm}
    if found is not None and found.wavefronts is not None:
        own["as_built_rms_waves"] = max(p.rms_waves for p in found.wavefronts.points)
    with chart_style():
        figure = styled_figure(4.7, 3.0)
        axis = figure.subplots()
        for on_front, color, label in ((False, GREY, "behind the front"), (True, BLUE, "front")):
            points = np.array([(x, y) for x, y, on in front.lenses if on == on_front]).reshape(-1, 2)
            axis.plot(*points.T, "o", color=color, ms=4.0, label=label if len(points) else None)
        x, y = (own.get(column) for column in front.columns)
        if x is not None and y is not None:
            axis.plot(x, y, "*", color=RED, ms=12.0, label="this lens")
        axis.set_xlabel(quantity_label(front.columns[0]))
        axis.set_ylabel(quantity_label(front.columns[1]))
        axis.legend(fontsize=8)
    text = "Pareto front of lenses of the same specification, and this lens."
    return [FigureBlock((Panel(figure, text),), caption=text)]
