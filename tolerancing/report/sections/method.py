"""Sections 10 to 12 of a report: fidelity, method and its errors, how to reproduce it all."""

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
    "rays": "Geometrical: diffraction and interference are left out; an extreme is that of the rays traced.",
    "point characteristic": "The path between the perturbed and the nominal lens, from rays; diffraction "
    "within the lens and at its rim, noise and phase retrieval are left out.",
    "eikonal patch": "A patch of bars carried through the perturbed lens and back through the nominal one; "
    "internal reflections are left out, and phase retrieval counts as ideal.",
    "whole chain on a line": "From an object on a meridional line to the pixels of all planes, and from "
    "these back by retrieval through the reconstruction's model; light beside the line, internal "
    "reflections and light from beyond the region are left out.",
    "eikonal, two planes, retrieval": "From the object to frames in two planes, and from these back by phase "
    "retrieval; internal reflections, and light from beyond the patch, are left out.",
}
"""What an engine leaves out."""

TEXT_SUFFIXES = (".toml", ".py")


def fidelity_section(data: ReportData) -> list[Block]:
    """Cheap against dear scores, and what both together say."""
    blocks: list[Block] = [Heading("Fidelity: cheap and dear merits")]
    merits, dear = data.study.high_fidelity_merits, data.dear
    if not merits:
        return [*blocks, Paragraph("All merits are scored in all trials: the study has no dear ones.")]
    if dear is None or not len(dear):
        return [*blocks, Paragraph("The dear merits have not been scored yet.")]
    places = np.searchsorted(data.trial_numbers, dear.trials)
    there = places < len(data.results)
    there[there] = data.trial_numbers[places[there]] == np.array(dear.trials)[there]
    panels, rows = [], []
    for k, merit in enumerate(merits):
        cheap = next(m for m in data.study.merits if m.label == merit.predicted_by)
        panels.append(fidelity_panel(data, cheap, merit, places[there], dear.scores[there, k]))
        rows += _estimates(data, cheap, merit, k, places, there)
    headings = [
        "<Estimate", "Value", "95 % interval", "Correlation", "Narrower than dear alone",
        "Narrower than dear, same time", "Dear trials",
    ]  # fmt: skip
    worst = sum(1 for why in dear.chosen if why == WORST)
    text = (
        f"{counted(len(dear), 'trial')} scored by the dear merits: the {worst} worst by the cheap merit and "
        f"{len(dear) - worst} at random from the others. Estimates join both merits (control variate in the "
        "random trials, the worst counted whole)."
    )
    return [*blocks, Paragraph(text, soft=True), FigureBlock(tuple(panels), columns=2), table(headings, rows)]


def _estimates(
    data: ReportData, cheap: Merit, dear: Merit, k: int, places: np.ndarray, there: np.ndarray
) -> list[list[str]]:
    assert data.dear is not None
    column = [m.label for m in data.study.merits].index(cheap.label)
    c, worst = data.results.scores[:, column], np.array([why == WORST for why in data.dear.chosen])
    first, second = there & worst, there & ~worst
    chosen = TrialChoice(places[first].astype(np.intp), places[second].astype(np.intp))
    scores = np.concatenate([data.dear.scores[first, k], data.dear.scores[second, k]])
    seconds = Seconds(_mean_seconds(data.results.seconds), _mean_seconds(data.dear.seconds))
    rows = []
    for name, work in (
        (f"mean of {dear.column}", lambda: combined_mean(c, chosen, scores, seconds)),
        (
            f"yield of {dear.column}",
            lambda: combined_yield(cheap.passed(c), chosen, dear.passed(scores), seconds),
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


def _estimate(name: str, found: ControlVariateEstimate, share: bool) -> list[str]:
    text = percent_text if share else number_text
    return [
        name,
        text(found.estimate),
        f"{text(found.low)} to {text(found.high)}",
        number_text(found.correlation),
        _times(found.narrower_than_dear),
        _times(found.narrower_than_same_time),
        f"{found.dear_trials:,}",
    ]


def _times(factor: float) -> str:
    return f"{factor:.2f} ×" if math.isfinite(factor) else "–"


def method_section(data: ReportData) -> list[Block]:
    """How each merit is computed, what is neglected, what the statistical error is."""
    study, sampling = data.study, data.study.sampling
    rows = [
        [m.column, m.used_level, engine_of(m), samples_text(data, m), cut_meaning(m)]
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
            f"Trials are drawn by the method {study.draws!r} from seed {study.seed}; the lens turns about "
            f"{study.pivot_z_mm:g} mm from its front vertex. Perturbed and nominal lens are compared "
            f"{sampling.plane_distance_mm:g} mm behind the exit vertex."
        ),
        Paragraph(statistics_text(data)),
    ]
    if study.draws != "random":
        blocks.append(
            Paragraph(
                "Designed draws are replicates, each randomised by itself; intervals of yields are those of "
                "the scatter between them, other intervals those of independent trials."
            )
        )
    return blocks


def cut_meaning(merit: Merit) -> str:
    """What a merit is, and its limit."""
    return f"{merit.meaning} Limit: {merit.limit_text}."


def samples_text(data: ReportData, merit: Merit) -> str:
    """How finely a merit is sampled."""
    sampling = data.study.sampling
    if merit.used_level == "ray":
        return f"{sampling.rings} rings and the rim, {sampling.arms} rays each"
    if merit.used_level == "pupil":
        return f"{sampling.pupil_samples} across the pupil"
    for name, unit in (("patch_um", "µm"), ("patch_mm", "mm")):
        if hasattr(merit, name):
            return f"patch of {getattr(merit, name):g} {unit}"
    return "–"


def statistics_text(data: ReportData) -> str:
    """The statistical error of the yield, and what more trials would bring."""
    good = data.summary.good
    if good is None:
        return "There are no trials, and so no statistical error to state."
    half = 0.5 * (good.high - good.low)
    return (
        f"Statistical error: {counted(good.total, 'trial')} tell the yield to ±{100.0 * half:.1f} percentage "
        "points (95 %, Wilson); four times as many would halve that. What the methods neglect moves all "
        "trials alike: no number of trials shows that error."
    )


def reproduction_section(data: ReportData, toolkit: str, written: str) -> list[Block]:
    """Versions, seed, fingerprint, time, commands, files."""
    record = data.record
    name = PurePosixPath(data.loaded.name).name
    spent = float(np.nansum(data.results.seconds)) + sum(s.seconds for s in data.steps)
    spent += float(np.nansum(data.dear.seconds)) if data.dear is not None else 0.0
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
            "Every trial follows from study, seed and the trial's number, whatever ran it; the same toolkit "
            "gives the same numbers. The last command shows the worst trial."
        ),
        Code(commands),
    ]
    for path, content in sorted(data.loaded.files.items(), key=lambda item: item[0] != data.loaded.name):
        blocks.append(Heading(f"File {path}", 3))
        if path.endswith(TEXT_SUFFIXES):
            blocks.append(Code(content.decode("utf-8", "replace")))
        else:
            blocks.append(Paragraph(f"{len(content):,} bytes; it is in the store.", soft=True))
    return blocks


def shell(word: str) -> str:
    """A word as a shell takes it."""
    return word if re.fullmatch(r"[\w./-]+", word) else "'" + word.replace("'", "'\\''") + "'"
