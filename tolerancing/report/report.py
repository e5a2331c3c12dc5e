"""The report of a study: a self-contained HTML page, the same content as PDF, and tables as CSV."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.clusters import toolkit_version
from lensdesign.errors import InputError
from tolerancing.report.blocks import Block, Report, plain
from tolerancing.report.data import ReportData
from tolerancing.report.sections.prediction import Front, prediction_section, read_front
from tolerancing.statistics.summary import Summary
from tolerancing.store.store import Store


@dataclass(frozen=True)
class ReportFiles:
    """Paths of the files of a report."""

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
    """Write the report of a store as HTML, PDF and CSV files.

    Parameters
    ----------
    store
        Open store; its run need not be finished.
    folder
        Folder for ``report.html``, ``report.pdf``, ``trials.csv`` and ``steps.csv``. It is created if needed.
    beside
        Open store of the original lens, with which the report compares this lens.
    front
        Output folder of `lensdesign explore`. The report compares this lens with the lenses on the front.

    Returns
    -------
    ReportFiles
        Paths of the written files.

    Raises
    ------
    InputError
        If the store cannot be read or a file cannot be written. Existing files then stay unchanged.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, write_report
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     files = write_report(store, "report")
    >>> files.html.name, files.pdf.name
    ('report.html', 'report.pdf')
    """
    from tolerancing.report.html import html_page
    from tolerancing.report.pdf import write_pdf
    from tolerancing.store.export import write_steps, write_trials

    folder = Path(folder)
    files = ReportFiles(
        folder / "report.html", folder / "report.pdf", folder / "trials.csv", folder / "steps.csv"
    )
    for path in vars(files).values():
        if os.path.exists(path) and path.samefile(store.path):
            raise InputError(f"cannot write {path}: it is the store itself; give another folder")
    comparison = ReportComparison(
        None if beside is None else report_data(beside).summary,
        None if front is None else read_front(Path(front)),
    )
    report = report_of(report_data(store), comparison=comparison)
    with ExitStack() as stack:  # All files are complete before the first one gets its name.
        temporary = {name: stack.enter_context(atomic_path(path)) for name, path in vars(files).items()}
        write_trials(store, temporary["trials_csv"])
        write_steps(store, temporary["steps_csv"])
        temporary["html"].write_text(html_page(report), encoding="utf-8")
        write_pdf(report, temporary["pdf"])
    return files


def report_data(store: Store) -> ReportData:
    """Read from a store all data of its report."""
    from tolerancing.statistics.summary import summary_of

    loaded, record, nominal = store.loaded, store.record(), store.nominal()
    results, steps = store.trials(), store.steps()
    high_fidelity = store.high_fidelity() if store.study.high_fidelity_merits else None
    return ReportData(
        loaded=loaded,
        record=record,
        nominal=nominal,
        results=results,
        high_fidelity=high_fidelity,
        steps=steps,
        summary=summary_of(record, store.study, nominal, results, len(store.finished_steps())),
    )


@dataclass(frozen=True)
class ReportComparison:
    """Results of other lenses for comparison.

    Attributes
    ----------
    original
        Summary of the store of the original lens.
    front
        Lenses of an exploration.
    """

    original: Summary | None = None
    front: Front | None = None


def report_of(
    data: ReportData, written: str | None = None, comparison: ReportComparison = ReportComparison()
) -> Report:
    """Return the content of a report, independent of the output format.

    Parameters
    ----------
    data
        Data of the report.
    written
        Date and time of the report. Default: now.
    comparison
        Results of other lenses for comparison.

    Returns
    -------
    Report
        Title, blocks and tooltips.
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
        blocks=tuple(_blocks(data, written, comparison)),
        trials={int(data.trial_numbers[row]): data.trial_text(row) for row in drawn},
        footer=(
            "Every trial is determined by the study, its seed and the trial's number. All numbers are in the "
            "files trials.csv and steps.csv beside this report."
        ),
    )


def _blocks(data: ReportData, written: str, comparison: ReportComparison) -> Sequence[Block]:
    from tolerancing.report.sections.method import fidelity_section, method_section, reproduction_section
    from tolerancing.report.sections.reconstruction import reconstruction_section
    from tolerancing.report.sections.series import series_section, trial_pictures
    from tolerancing.report.sections.summary import lens_section, summary_section
    from tolerancing.report.sections.tolerances import (
        coefficient_appendix,
        sensitivity_section,
        tolerance_section,
    )
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
        *prediction_section(data, comparison.original, comparison.front),
        *distribution_section(data),
        *scale_section(data),
        *reconstruction_section(data),
        *scatter_section(data),
        *worst_section(data, trial_pictures),
        *series_section(data),
        *fidelity_section(data),
        *method_section(data),
        *reproduction_section(data, toolkit_version(), written),
        *coefficient_appendix(data),
    ]
