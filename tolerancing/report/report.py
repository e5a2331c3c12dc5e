"""The report of a study: one self-contained HTML page, the same as PDF, and tables for other programs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from lensdesign.common.clusters import toolkit_version
from lensdesign.errors import InputError, atomic_path
from tolerancing.report.blocks import Block, Report, plain
from tolerancing.report.data import ReportData
from tolerancing.report.sections.designed import Front, designed_section, read_front
from tolerancing.statistics.summary import Summary
from tolerancing.store.store import Store


@dataclass(frozen=True)
class ReportFiles:
    """What a report consists of."""

    html: Path
    pdf: Path
    trials_csv: Path
    steps_csv: Path


def write_report(
    store: Store,
    folder: str | os.PathLike[str],
    *,
    beside: Store | None = None,
    front: str | os.PathLike[str] | None = None,
) -> ReportFiles:
    """Write a store's report.

    Parameters
    ----------
    store
        An open store, finished or not.
    folder
        Where ``report.html``, ``report.pdf``, ``trials.csv`` and ``steps.csv`` go; made if needed.
    beside
        An open store of the lens from which this one was made, to be put beside it.
    front
        Folder of `lensdesign explore`, to show where this lens stands.

    Raises
    ------
    InputError
        If the store cannot be read or a file cannot be written; files there stay as they were.
    """
    from tolerancing.report.html import html_page
    from tolerancing.report.pdf.pdf import write_pdf
    from tolerancing.store.export import write_steps, write_trials

    folder = Path(folder)
    files = ReportFiles(
        folder / "report.html", folder / "report.pdf", folder / "trials.csv", folder / "steps.csv"
    )
    for path in vars(files).values():
        if os.path.exists(path) and path.samefile(store.path):
            raise InputError(f"cannot write {path}: it is the store itself; give another folder")
    shown = ReportComparison(
        None if beside is None else report_data(beside).summary,
        None if front is None else read_front(Path(front)),
    )
    report = report_of(report_data(store), beside=shown)
    with ExitStack() as stack:  # all are written before the first takes its place
        temporary = {name: stack.enter_context(atomic_path(path)) for name, path in vars(files).items()}
        write_trials(store, temporary["trials_csv"])
        write_steps(store, temporary["steps_csv"])
        temporary["html"].write_text(html_page(report), encoding="utf-8")
        write_pdf(report, temporary["pdf"])
    return files


def report_data(store: Store) -> ReportData:
    """All that a store's report is made from."""
    from tolerancing.statistics.summary import summary_of

    loaded, record, nominal = store.loaded, store.record(), store.nominal()
    results, steps = store.trials(), store.steps()
    dear = store.dear() if store.study.high_fidelity_merits else None
    return ReportData(
        loaded=loaded,
        record=record,
        nominal=nominal,
        results=results,
        dear=dear,
        steps=steps,
        summary=summary_of(record, store.study, nominal, results, len(store.finished_steps())),
    )


@dataclass(frozen=True)
class ReportComparison:
    """What a report puts beside its own lens: another store's results, and an exploration's front."""

    before: Summary | None = None
    front: Front | None = None


def report_of(
    data: ReportData, written: str | None = None, beside: ReportComparison = ReportComparison()
) -> Report:
    """The report's content, whatever it is rendered to.

    Parameters
    ----------
    data
        What it is made from.
    written
        When; now where left out.
    beside
        What is shown beside it.
    """
    written = written or datetime.now(UTC).isoformat(timespec="seconds")
    summary, study = data.summary, data.study
    drawn = data.drawn.tolist()
    return Report(
        title=plain(study.title or study.design),
        subtitle=plain(
            f"Design {study.design}; {summary.trials:,} of {summary.record.planned_trials:,} trials, seed "
            f"{study.seed}; report written {written}"
        ),
        blocks=tuple(_blocks(data, written, beside)),
        trials={int(data.trial_numbers[place]): data.trial_text(place) for place in drawn},
        footer=(
            "Every trial follows from the study, its seed and the trial's number. All numbers stand in "
            "trials.csv and steps.csv beside this report."
        ),
    )


def _blocks(data: ReportData, written: str, beside: ReportComparison) -> Sequence[Block]:
    from tolerancing.report.sections.method import fidelity_section, method_section, reproduction_section
    from tolerancing.report.sections.reconstruction import reconstruction_section
    from tolerancing.report.sections.series import series_section, trial_pictures
    from tolerancing.report.sections.summary import lens_section, summary_section
    from tolerancing.report.sections.tolerances import sensitivity_section, tolerance_section
    from tolerancing.report.sections.trials import (
        distribution_section,
        scale_section,
        scatter_section,
        worst_section,
    )

    return [
        *summary_section(data),
        *lens_section(data),
        *tolerance_section(data),
        *sensitivity_section(data),
        *designed_section(data, beside.before, beside.front),
        *distribution_section(data),
        *scale_section(data),
        *reconstruction_section(data),
        *scatter_section(data),
        *worst_section(data, trial_pictures),
        *series_section(data),
        *fidelity_section(data),
        *method_section(data),
        *reproduction_section(data, toolkit_version(), written),
    ]
