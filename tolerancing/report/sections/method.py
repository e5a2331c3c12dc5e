"""Sections about fidelity, about the method and its errors, and about reproduction."""

from __future__ import annotations

import math
import re
from pathlib import PurePosixPath

import numpy as np

from lensdesign.common.text import duration_text
from lensdesign.errors import InputError
from tolerancing.merits.base import Merit
from tolerancing.report.blocks import (
    Block,
    Code,
    Facts,
    FigureBlock,
    Heading,
    Paragraph,
    counted,
    number_text,
    percent_text,
    table,
)
from tolerancing.report.data import ReportData
from tolerancing.report.figures.trials import fidelity_panel
from tolerancing.statistics.control_variates import (
    ControlVariateEstimate,
    Seconds,
    TrialChoice,
    combined_mean,
    combined_yield,
)
from tolerancing.store.schema import engine_of
from tolerancing.study.results import WORST

NEGLECTED = {
    "rays": "Geometrical optics: diffraction and interference are neglected; an extreme is that of the "
    "traced rays.",
    "point characteristic": "Path difference between the perturbed and the nominal lens, from rays. "
    "Diffraction within the lens and at its rim, noise and phase retrieval are neglected.",
    "eikonal patch": "A patch of bars is propagated through the perturbed lens and back through the nominal "
    "one. Internal reflections are neglected, and phase retrieval is taken as ideal.",
    "whole chain on a line": "An object on a meridional line is propagated to the pixels of all planes, and "
    "reconstructed with the reconstruction's model. Light outside the line, internal reflections and light "
    "from outside the region are neglected.",
    "eikonal, two planes, retrieval": "The object is propagated to frames in two planes and reconstructed by "
    "phase retrieval. Internal reflections and light from outside the patch are neglected.",
}
"""Effects that each engine neglects."""


def fidelity_section(data: ReportData) -> list[Block]:
    """Compare low- and high-fidelity scores, and return estimates from both."""
    blocks: list[Block] = [Heading("Fidelity: low- and high-fidelity merits")]
    merits, high = data.study.high_fidelity_merits, data.high_fidelity
    if not merits:
        return [*blocks, Paragraph("All merits are scored in all trials: none has `predicted_by`.")]
    if high is None or not len(high):
        return [*blocks, Paragraph("The high-fidelity merits have not been scored yet.")]
    rows_of_trials = np.searchsorted(data.trial_numbers, high.trials)
    stored = rows_of_trials < len(data.results)
    stored[stored] = data.trial_numbers[rows_of_trials[stored]] == np.array(high.trials)[stored]
    panels, rows = [], []
    for k, merit in enumerate(merits):
        low_merit = next(m for m in data.study.merits if m.label == merit.predicted_by)
        panels.append(fidelity_panel(data, low_merit, merit, rows_of_trials[stored], high.scores[stored, k]))
        rows += _estimates(data, low_merit, merit, k, rows_of_trials, stored)
    headings = [
        "<Estimate", "Value", "95 % interval", "Correlation", "Narrower than high fidelity alone",
        "Narrower than high fidelity, same time", "High-fidelity trials",
    ]  # fmt: skip
    worst = sum(1 for reason in high.chosen if reason == WORST)
    text = (
        f"{counted(len(high), 'trial')} scored by the high-fidelity merits: the {worst} worst by the "
        f"low-fidelity merit and {len(high) - worst} drawn at random from the others. The estimates use both "
        "merits: a control variate for the random trials, and all of the worst trials."
    )
    return [*blocks, Paragraph(text, soft=True), FigureBlock(tuple(panels), columns=2), table(headings, rows)]


def _estimates(
    data: ReportData, low: Merit, high: Merit, k: int, rows_of_trials: np.ndarray, stored: np.ndarray
) -> list[list[str]]:
    assert data.high_fidelity is not None
    column = [m.label for m in data.study.merits].index(low.label)
    c = data.results.scores[:, column]
    worst = np.array([reason == WORST for reason in data.high_fidelity.chosen])
    first, second = stored & worst, stored & ~worst
    chosen = TrialChoice(rows_of_trials[first].astype(np.intp), rows_of_trials[second].astype(np.intp))
    scores = np.concatenate([data.high_fidelity.scores[first, k], data.high_fidelity.scores[second, k]])
    seconds = Seconds(_mean_seconds(data.results.seconds), _mean_seconds(data.high_fidelity.seconds))
    rows = []
    for name, work in (
        (f"mean of {high.column}", lambda: combined_mean(c, chosen, scores, seconds)),
        (
            f"yield of {high.column}",
            lambda: combined_yield(low.passed(c), chosen, high.passed(scores), seconds),
        ),
    ):
        try:
            rows.append(_estimate(name, work(), name.startswith("yield")))
        except InputError as error:
            rows.append([name, "–", f"none: {error}", "–", "–", "–", str(len(scores))])
    return rows


def _mean_seconds(seconds: np.ndarray) -> float:
    known = seconds[np.isfinite(seconds)]
    return max(float(known.mean()), 1e-9) if len(known) else 1e-9


def _estimate(name: str, found: ControlVariateEstimate, is_fraction: bool) -> list[str]:
    text = percent_text if is_fraction else number_text
    return [
        name,
        text(found.estimate),
        f"{text(found.low)} to {text(found.high)}",
        number_text(found.correlation),
        _times(found.narrower_than_high_fidelity),
        _times(found.narrower_than_same_time),
        f"{found.high_fidelity_trials:,}",
    ]


def _times(factor: float) -> str:
    return f"{factor:.2f} ×" if math.isfinite(factor) else "–"


def method_section(data: ReportData) -> list[Block]:
    """Return how each merit is computed, which effects are neglected, and the statistical error."""
    study, sampling = data.study, data.study.sampling
    rows = [
        [m.column, m.used_level, engine_of(m), samples_text(data, m), meaning_text(m)]
        for m in study.all_merits
    ]
    engines = dict.fromkeys(engine_of(m) for m in study.all_merits)
    blocks: list[Block] = [
        Heading("Method, fidelity and error"),
        table(["<Merit", "<Level", "<Engine", "<Samples", "<Meaning"], rows),
        *(
            Paragraph(f"{engine.capitalize()}. {NEGLECTED[engine]}")
            for engine in engines
            if engine in NEGLECTED
        ),
        Paragraph(
            f"Trials are drawn by the method {study.draws!r} from seed {study.seed}. The lens tilts about "
            f"a pivot {study.pivot_z_mm:g} mm from its front vertex. Perturbed and nominal lens are compared "
            f"{sampling.plane_distance_mm:g} mm behind the exit vertex."
        ),
        Paragraph(statistics_text(data)),
    ]
    if study.draws != "random":
        blocks.append(
            Paragraph(
                "The design of the draws consists of replicates that are randomized independently. Intervals "
                "of yields follow from the scatter between replicates; other intervals are those of "
                "independent trials."
            )
        )
    return blocks


def meaning_text(merit: Merit) -> str:
    """Describe the meaning and the limit of a merit."""
    return f"{merit.meaning} Limit: {merit.limit_text}."


def samples_text(data: ReportData, merit: Merit) -> str:
    """Describe the sampling of a merit."""
    sampling = data.study.sampling
    if merit.used_level == "ray":
        return f"{sampling.rings} rings and the edge of the pupil, {sampling.arms} rays each"
    if merit.used_level == "pupil":
        return f"{sampling.pupil_samples} across the pupil"
    for name, unit in (("patch_um", "µm"), ("patch_mm", "mm")):
        if hasattr(merit, name):
            return f"patch of {getattr(merit, name):g} {unit}"
    return "–"


def statistics_text(data: ReportData) -> str:
    """Describe the statistical error of the yield, and the effect of more trials."""
    good = data.summary.good
    if good is None:
        return "There are no trials, and therefore no statistical error."
    half = 0.5 * (good.high - good.low)
    return (
        f"Statistical error: the yield from {counted(good.total, 'trial')} is known to ±{100.0 * half:.1f} "
        "percentage points (95 %, Wilson). Four times as many trials would halve this error. What the "
        "methods neglect changes all trials alike, and more trials do not reveal it."
    )


def reproduction_section(data: ReportData, toolkit: str, written: str) -> list[Block]:
    """Return versions, seed, fingerprint, computing time, commands and files."""
    record = data.record
    name = PurePosixPath(data.loaded.name).name
    spent = float(np.nansum(data.results.seconds)) + sum(s.seconds for s in data.steps)
    spent += float(np.nansum(data.high_fidelity.seconds)) if data.high_fidelity is not None else 0.0
    facts = (
        ("Toolkit of the run", record.toolkit_version),
        ("Toolkit of this report", toolkit),
        ("Study begun", record.created),
        ("Report written", written),
        ("Seed", str(record.seed)),
        ("Fingerprint", record.fingerprint),
        ("Computing time", duration_text(spent)),
    )
    worst = int(data.trial_numbers[data.by_badness[0]]) if len(data.results) else 0
    commands = (
        f"tolerancing run {shell(name)} --store STORE --trials {record.planned_trials}\n"
        f"tolerancing report STORE --output FOLDER\n"
        f"tolerancing show STORE --trial {worst}"
    )
    blocks: list[Block] = [
        Heading("Versions and reproduction"),
        Facts(facts),
        Paragraph(
            "Every trial is determined by the study, the seed and the trial's number. The same version of "
            "the toolkit gives the same numbers on any number of workers. The last command shows the worst "
            "trial."
        ),
        Code(commands),
    ]
    for path, content in sorted(data.loaded.files.items(), key=lambda item: item[0] != data.loaded.name):
        blocks.append(Heading(f"File {path}", 3))
        if path.endswith((".toml", ".py")):
            blocks.append(Code(content.decode("utf-8", "replace")))
        else:
            blocks.append(Paragraph(f"{len(content):,} bytes; the file is in the store.", soft=True))
    return blocks


def shell(word: str) -> str:
    """Quote a word for a shell if needed."""
    return word if re.fullmatch(r"[\w./-]+", word) else "'" + word.replace("'", "'\\''") + "'"
