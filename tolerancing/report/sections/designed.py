"""What a lens is designed for: its wavefront as predicted, what drives the yield, what may be loosened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.input_files import TABLE_BYTES, check_input
from lensdesign.common.tables import read_number, read_table
from lensdesign.errors import InputError
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
)
from tolerancing.report.data import ReportData
from tolerancing.report.figures.style import BLUE, GREY, RED, styled, styled_figure
from tolerancing.statistics.summary import Summary

if TYPE_CHECKING:
    from tolerancing.prediction.study_prediction import StudyPrediction
    from tolerancing.prediction.wavefront_prediction import WavefrontPrediction


@dataclass(frozen=True)
class Front:
    """Lenses of an exploration, as `lensdesign explore` writes them.

    Attributes
    ----------
    columns : (str, str)
        Objectives, with units.
    lenses : tuple of (float, float, bool)
        Values, and whether the lens stands on the front.
    """

    columns: tuple[str, str]
    lenses: tuple[tuple[float, float, bool], ...]


def read_front(path: Path) -> Front:
    """Read the front of an exploration's folder.

    Raises
    ------
    InputError
        If there is none.
    """
    file = path / "front.csv" if path.is_dir() else path
    try:
        check_input(file, TABLE_BYTES)
        read = read_table(file)
        first, last = _objectives(read.names)
        columns = (read.column(name) for name in (first, last, "on_front"))
        lenses = tuple(
            (read_number(x[0], x[1], first), read_number(y[0], y[1], last), shown[0] == "1")
            for x, y, shown in zip(*columns, strict=True)
        )
    except InputError as error:
        raise InputError(f"{file}: is no front that lensdesign explore wrote: {error}") from None
    return Front((first, last), lenses)


def _objectives(names: Sequence[str]) -> tuple[str, str]:
    """The first and the last objective among the columns of a front."""
    own = [name for name in names if name not in ("design", "glasses", "on_front")]
    if not own:
        raise InputError("no column of an objective")
    return own[0], own[-1]


def designed_section(
    data: ReportData, before: Summary | None = None, front: Front | None = None
) -> list[Block]:
    """What was predicted beside what trials found, and where to spend or save.

    Empty where nothing of the study can be predicted and nothing stands beside it.

    Parameters
    ----------
    data
        The report's.
    before
        Of another lens's store, the start of the search, say.
    front
        Lenses of an exploration.
    """
    found = _prediction(data)
    blocks = [*_beside(data, before), *_predicted(data, found), *_on_front(data, front, found)]
    return [Heading("Predicted from the design"), *blocks] if blocks else []


def _beside(data: ReportData, before: Summary | None) -> list[Block]:
    if before is None:
        return []
    others = {m.merit.label: m for m in before.merits}
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
                percent_text(other.good.share if other.good else None),
                number_text(own.nominal),
                number_text(own.mean),
                percent_text(own.good.share if own.good else None),
            ]
        )
    title = before.study.title or before.study.design
    headings = ["<Merit", "Start", "Start, mean", "Start, good", "This", "This, mean", "This, good"]
    return [table(headings, rows, f"This lens beside the start: {title}.")]


def _prediction(data: ReportData) -> StudyPrediction | None:
    """What is predicted of the lens; None where nothing of the study can be."""
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
    if not found.is_trustworthy:
        blocks.append(
            Warning("These tolerances are too large for predictions, which may be 5 % off or more.")
        )
    return blocks


def _predicted_yield(data: ReportData, found: StudyPrediction) -> list[Block]:
    """The joint yield and its parts, beside the yields of the trials."""
    scores = dict(zip((m.label for m in data.study.merits), data.results.scores.T, strict=True))
    kept = [one.merit.passed(scores[one.merit.label]) for one in found.limits]

    def fraction(passed: NDArray[np.bool_]) -> float | None:
        return float(np.mean(passed)) if len(passed) else None

    rows = [
        [
            one.merit.label,
            one.merit.limit_text,
            one.merit.location,
            percent_text(one.yield_fraction),
            percent_text(fraction(own)),
        ]
        for one, own in zip(found.limits, kept, strict=True)
    ]
    together = fraction(np.all(kept, axis=0))
    rows.append(
        ["all of these", "", "", percent_text(found.yield_fraction), percent_text(together)],
    )
    text = (
        f"Predicted from the rays of the nominal lens, without trials: {percent_text(found.yield_fraction)} "
        "of lenses keep all limits of the table at once."
    )
    if found.not_predicted:
        text += f" Limits that only trials can score are not part of it: {', '.join(found.not_predicted)}."
    headings = ["<Merit", "<Limit", "<Field points", "Predicted", "Trials"]
    return [Paragraph(text), table(headings, rows, "Yield limit by limit, and of all limits at once.")]


def _loosened(data: ReportData, found: StudyPrediction) -> list[Block]:
    """The yield with each tolerance halved and doubled, those that matter most first."""
    from tolerancing.budgets.loosening import loosen_each

    loosened = sorted(loosen_each(data.lens, data.study), key=lambda one: one.doubled - one.halved)
    rows = [[one.perturbation, percent_text(one.halved), percent_text(one.doubled)] for one in loosened]
    caption = (
        f"The predicted yield of {percent_text(found.yield_fraction)} with each tolerance halved or doubled, "
        "all others as they are. What changes little when it is doubled may be loosened."
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
            "The wavefront's root mean square over pupil and lenses, shift and focus taken out, and its "
            "limit; a limit on the Strehl ratio S counts as the root mean square of S = exp(−(2π rms)²).",
        ),
        table(
            ["<Perturbation", "Share of rms squared"],
            drivers,
            "What each perturbation contributes to the mean square of the wavefront at the worst object "
            "point.",
        ),
    ]


def _on_front(data: ReportData, front: Front | None, found: StudyPrediction | None) -> list[Block]:
    if front is None:
        return []
    own = {"thickness_mm": data.lens.exit_vertex_z_mm}
    if found is not None and found.wavefronts is not None:
        own["as_built_rms_waves"] = max(p.rms_waves for p in found.wavefronts.points)
    with styled():
        figure = styled_figure(4.7, 3.0)
        axis = figure.subplots()
        for on, color, label in ((False, GREY, "behind the front"), (True, BLUE, "front")):
            at = np.array([(x, y) for x, y, stands in front.lenses if stands == on]).reshape(-1, 2)
            axis.plot(*at.T, "o", color=color, ms=4.0, label=label if len(at) else None)
        x, y = (own.get(column) for column in front.columns)
        if x is not None and y is not None:
            axis.plot(x, y, "*", color=RED, ms=12.0, label="this lens")
        axis.set_xlabel(front.columns[0].replace("_", " "))
        axis.set_ylabel(front.columns[1].replace("_", " "))
        axis.legend(fontsize=8)
    text = "Lenses of the same specification of which none is better in everything, and this one."
    return [FigureBlock((Panel(figure, text),), caption=text)]
