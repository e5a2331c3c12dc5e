"""One yield everywhere: starting studies by prediction, report, drawing, workbench and trials.

For five lenses of the gallery, each with one to three grades, `tolerancing start` writes a study. Its joint
yield is predicted by `tolerancing predict`, by the report, by the sheet of `lensdesign drawing --tolerances`
and by the workbench's model. Exact trials give the same yield, with an interval. The last columns compare
lens by lens: the yield that is predicted for the lenses of the trials themselves, and the number of lenses
whose predicted result is wrong.

Identical calls of the prediction, with equal study and equal draws, are computed once.

    python -m benchmarks.starter_studies [--trials 200] [LENS:GRADE ...]
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from benchmarks.timing import DESIGNS
from lensdesign.cli.commands import app as lensdesign_app
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from studio.model import built as workbench
from tolerancing import load_study, start_study
from tolerancing.cli.commands import app as tolerancing_app
from tolerancing.merits.base import all_passed
from tolerancing.prediction import drawing_yield, study_prediction
from tolerancing.prediction.study_prediction import StudyPrediction
from tolerancing.report.report import report_data
from tolerancing.report.sections.prediction import prediction_section
from tolerancing.run.run import run_study
from tolerancing.statistics.yields import yield_of
from tolerancing.store.store import open_store
from tolerancing.study.evaluate import sample_perturbations
from tolerancing.study.study import Study

STUDIES = tuple(
    f"{lens}:{grade}"
    for lens, grades in {
        "paper_singlet": ("commercial", "precision", "high_precision"),
        "stock_pair": ("commercial", "precision", "high_precision"),
        "moulded_pair": ("moulded_glass", "precision", "high_precision"),
        "feasible_singlet": ("precision",),
        "phone_lens": ("precision", "high_precision"),
    }.items()
    for grade in grades
)

HEADINGS = (
    *("study", "predict", "interval", "report", "sheet: study, as drawn", "workbench"),
    *("trials", "interval", "agree", "trials' lenses predicted", "wrong", "s"),
)


def main() -> None:
    """Print a row for each study."""
    parser = argparse.ArgumentParser()
    parser.add_argument("studies", nargs="*", default=STUDIES, metavar="LENS:GRADE")
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--nominal-mounting", action="store_true")
    given = parser.parse_args()
    _compute_identical_predictions_once()
    print(f"| {' | '.join(HEADINGS)} |")
    print("| --- " * len(HEADINGS) + "|", flush=True)
    for item in given.studies:
        lens, _, grade = item.partition(":")
        with tempfile.TemporaryDirectory() as folder:
            start = time.process_time()
            row = _row(lens, grade, not given.nominal_mounting, given.trials, Path(folder))
            print(f"| {' | '.join([item, *row, f'{time.process_time() - start:.0f}'])} |", flush=True)


def _row(name: str, grade: str, calibrated: bool, trials: int, folder: Path) -> list[str]:
    design, study = folder / "lens.toml", folder / "study.toml"
    design.write_bytes((DESIGNS / f"{name}.toml").read_bytes())
    start_study(design, study, grade, calibrated)
    loaded = load_study(study)
    predicted, exit_status = _command(tolerancing_app, "predict", str(study), "--json")
    terminal = CliRunner().invoke(tolerancing_app, ["predict", str(study)]).output
    found, low, high = (predicted[key] for key in ("yield", "yield_low", "yield_high"))
    shown = _percent(found)
    assert found is None or shown in terminal
    assert ("the yield is not predicted" in terminal) == (found is None)
    only_trials = loaded.study.replaced(sensitivity=False, scaled_trials=None)
    loaded = type(loaded)(**{**vars(loaded), "study": only_trials})
    run_study(loaded, folder / "study.db", trials=trials, workers=1)
    with open_store(folder / "study.db") as store:
        data = report_data(store)
    report = _yield_of_report(prediction_section(data))
    good = data.summary.good
    assert good is not None
    drawing, _ = _command(
        lensdesign_app,
        *("drawing", str(design), "--tolerances", str(study), "-o", str(folder / "sheet.pdf")),
        *("--json", "--accept-yield-loss"),
    )
    model = workbench.built(loaded.lens, workbench.manufacturing_quality(str(study), loaded.lens))
    if calibrated:
        of_grade = workbench.built(loaded.lens, workbench.manufacturing_quality(grade, loaded.lens))
        assert of_grade.prediction.yield_fraction == model.prediction.yield_fraction
    same, wrong = _same_lenses(loaded.lens, only_trials, data.results.values, data.results.scores)
    return [
        shown + ("" if exit_status == 0 else " (exit 1)"),
        "" if found is None else f"{100 * low:.1f} to {100 * high:.1f}",
        report,
        f"{_percent(drawing['study_yield'])}, {_percent(drawing['as_drawn_yield'])}",
        _percent(model.prediction.yield_fraction),
        _percent(good.fraction),
        f"{100 * good.low:.1f} to {100 * good.high:.1f}",
        "-" if found is None else "yes" if low <= good.high and good.low <= high else "NO",
        same,
        wrong,
    ]


def _command(app: Any, *words: str) -> tuple[dict[str, Any], int]:
    done = CliRunner().invoke(app, list(words))
    if done.exit_code not in (0, 1):
        raise InputError(f"{' '.join(words)}: {done.output}")
    return json.loads(done.stdout), done.exit_code


def _percent(fraction: float | None) -> str:
    return "not predicted" if fraction is None else f"{100 * fraction:.1f} %"


def _yield_of_report(blocks: list[Any]) -> str:
    (row,) = (row for block in blocks for row in getattr(block, "rows", ()) if row[0] == "all limits")
    return str(row[3]).replace("–", "to")


def _same_lenses(lens: Lens, study: Study, values: Any, scores: Any) -> tuple[str, str]:
    """Predict the lenses of the trials themselves; return their yield and the number of wrong ones."""
    count = min(len(values), study_prediction.SCORED_DRAWS)
    batch = sample_perturbations(study, range(count))
    assert np.array_equal(batch.values, values[:count])
    found = study_prediction.predict_study(lens, study, batch)
    passed, true = found.passed, all_passed(study.merits, scores[:count])
    own = yield_of(passed)
    assert own is not None
    return _percent(own.fraction), f"{int(np.count_nonzero(passed != true))} of {count}"


def _compute_identical_predictions_once() -> None:
    own, known = study_prediction.predict_study, dict[Any, StudyPrediction]()

    def once(lens: Any, study: Any, batch: Any = None, **options: Any) -> StudyPrediction:
        names = {"title", "design", "trials", "sensitivity", "scaled_trials"}
        draws = None if batch is None else batch.values.tobytes()
        default = study_prediction.drawn_batch(study).values.tobytes()
        key = (
            lens.model_dump_json(),
            study.model_dump_json(exclude=names),
            default if draws is None else draws,
            options.get("quick", False),
        )
        if key not in known:
            known[key] = own(lens, study, batch, **options)
        return known[key]

    for module in (study_prediction, drawing_yield, workbench):
        module.predict_study = once


if __name__ == "__main__":
    main()
