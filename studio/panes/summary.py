"""Panes of results: constraints, violations, other properties, and the lens as built."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn

from lensdesign.analysis.report import CheckReport, Constraint
from lensdesign.common.text import quantity_text, relation_symbol, words_and_unit
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.files import remember, typed_path
from studio.panes.common import Guarded, bench_of, follow, message_pane, text
from studio.panes.files import FileChoice
from tolerancing.perturbations.grades import GRADES
from tolerancing.prediction.study_prediction import StudyPrediction
from tolerancing.prediction.wavefront_prediction import WavefrontPrediction


def findings(lens: Workbench | Lens) -> Guarded:
    """Return a pane with the constraints, their present values, and a sentence for each violation."""
    bench = bench_of(lens)
    pane = message_pane()

    def update() -> None:
        report = bench.analysis.check
        if report is None:
            pane.object = ""
            return
        rows = "".join(_constraint(c) for c in report.constraints)
        misses = "".join(f'<p class="miss">{text(one)}</p>' for one in report.violations)
        verdict = (
            '<p class="verdict good">every constraint is met</p>'
            if report.feasible
            else f'<p class="verdict bad">{len(report.violations)} not met</p>'
        )
        is_new = "check" not in bench.analysis.reasons and bench.analysis.lens is bench.lens
        is_exact = "check" in bench.analysis.exact
        state = "settled" if is_exact and is_new else "moving" if is_new else "stale"
        pane.object = (
            f'<div class="text-block" data-state="{state}">{verdict}{rows}'
            f'{misses}<table class="facts">{_facts(report, bench.analysis.lens)}</table></div>'
        )

    follow(bench, pane, update)
    return Guarded(bench, pane, "check")


STUDIES = "studies"
"""Name of the list of recent study files."""


def as_built(lens: Workbench | Lens) -> pn.Column:
    """Return a pane with the predicted rms wavefront errors, yield, main contributions and cost."""
    bench = bench_of(lens)
    names = {grade.replace("_", " "): grade for grade in GRADES}
    if bench.grade not in GRADES:
        names[bench.grade] = bench.grade
    chosen = pn.widgets.Select(
        name="tolerances", options=names, value=bench.grade, sizing_mode="stretch_width"
    )

    def choose_grade(event: Any) -> None:
        if event.new != bench.grade:
            bench.set_grade(event.new)

    chosen.param.watch(choose_grade, "value")

    def choose_study(_: str, name: str) -> None:
        with suppress(InputError):
            remember(STUDIES, typed_path(name))
        bench.set_grade(name)

    study = FileChoice(
        STUDIES,
        choose_study,
        (("study", "Study file…", "open", "Use the tolerances of a study file (TOML)"),),
        suffixes=[".toml"],
        margin=(0, 10),
    )
    shown = message_pane()
    pane = pn.Column(chosen, study, Guarded(bench, shown, "built"), sizing_mode="stretch_width", margin=0)

    def update() -> None:
        if chosen.value != bench.grade:
            known = chosen.options
            if bench.grade not in known.values():
                chosen.options = known | {Path(bench.grade).name: bench.grade}
            chosen.value = bench.grade
        found = bench.analysis.built
        if found is None:
            shown.object = ""
            return
        predicted, waves = found.prediction, found.prediction.wavefronts
        limits = "".join(
            f"<tr><td>{text(words_and_unit(one.merit.column)[0])} {text(one.merit.limit_text)}"
            f"<br><small>{text(one.merit.location)}</small></td>"
            f"<td>{100.0 * one.yield_fraction:.1f} %</td></tr>"
            for one in predicted.limits
        )
        points = "".join(
            f"<tr><td>{p.judged.field_mm[1]:.3g} mm</td><td>{p.rms_waves:.4f} λ</td></tr>"
            for p in (() if waves is None else waves.points)
        )
        bars = "".join(
            f'<tr><td>{text(words_and_unit(name)[0])}</td><td class="bar">'
            f'<i style="width:{fraction:.1f}%"></i></td><td>{fraction:.0f} %</td></tr>'
            for name, fraction in (() if waves is None else _contributions(waves)[:7])
        )
        cost = "" if found.cost is None else f" · cost {found.cost:.2f}"
        is_exact = "built" in bench.analysis.exact
        open_text = "not predicted" if is_exact else "…"
        limits += "".join(
            f"<tr><td>{text(words_and_unit(name)[0])}</td><td>{open_text}</td></tr>"
            for name in predicted.not_predicted
        )
        note = ""
        if is_exact and predicted.joint is not None and not predicted.is_trustworthy:
            note = '<p class="miss">too large tolerances for a prediction: run a study under Tolerances</p>'
        shown.object = (
            f'<div class="text-block">{_yield_line(predicted, is_exact, cost)}'
            f"<table class='facts'><tr><th>each limit alone</th><th>good</th></tr>{limits}</table>"
            f"{note}<table class='facts'><tr><th>field</th><th>rms</th></tr>{points}</table>"
            f'<table class="bars">{bars}</table></div>'
        )

    follow(bench, pane, update)
    return pane


def _yield_line(predicted: StudyPrediction, is_exact: bool, cost: str) -> str:
    """Return the yield over all limits of the study, or why there is none."""
    alone = ",".join(repr(one.yield_fraction) for one in predicted.limits)
    start = f'<p class="yield" data-limits="{alone}" data-yield='
    if (joint := predicted.joint) is not None:
        return (
            f'{start}"{joint.fraction!r}"><b>{100.0 * joint.fraction:.1f} %</b> of lenses keep all limits at '
            f"once{cost}<br><small>95 % interval {100.0 * joint.low:.1f} to {100.0 * joint.high:.1f} %, "
            f"{joint.draws} drawn lenses</small></p>"
        )
    if not is_exact:
        return f'{start}"">yield: predicted when the values rest{cost}</p>'
    why = f"{text(predicted.reason)}: run a study under Tolerances"
    return f'{start}"">yield not predicted{cost}</p><p>{why}</p>'


def _contributions(waves: WavefrontPrediction) -> list[tuple[str, float]]:
    """Return the contribution of each perturbation to the mean square in percent, the largest first."""
    squares = np.array([point.rms_waves**2 for point in waves.points])
    contributions = squares @ np.stack([point.shares for point in waves.points]) / squares.sum()
    return sorted(
        zip(waves.perturbations, (100.0 * contributions).tolist(), strict=True), key=lambda one: -one[1]
    )


def _constraint(one: Constraint) -> str:
    fraction = one.value / one.limit if one.relation == "<=" and one.limit else None
    bar = "" if fraction is None else f'<i style="width:{min(100.0 * fraction, 100.0):.1f}%"></i>'
    near = " near" if one.met and fraction is not None and fraction > 0.999 else ""
    kind = ("met" if one.met else "bad") + near
    state = "binds" if near else "met" if one.met else "not met"
    value, limit = (quantity_text(number, one.unit) for number in (one.value, one.limit))
    return (
        f'<div class="constraint {kind}" data-name="{text(one.name)}" data-value="{one.value!r}">'
        f'<span>{text(one.name)}</span><span class="state">{state}</span><b>{value}</b>'
        f"<span>{relation_symbol(one.relation)} {limit}</span><div class='bar'>{bar}</div></div>"
    )


def _facts(report: CheckReport, lens: Lens) -> str:
    spots = ", ".join(f"{d:.2f}" for d in report.rms_spot_diameter_mm)
    thickness = lens.exit_vertex_z_mm
    rows = [
        ("resolution", f"{report.resolution_um:.4g} µm"),
        ("SBP of the object", f"{report.sbp_object:.4e}"),
        *((f"oversampling, {name}", ratios) for name, ratios in report.oversampling_texts()),
        ("etendue filled", f"{100.0 * report.etendue_share:.1f} %"),
        ("exit beam", f"{report.exit_beam_diameter_mm:.3f} mm"),
        ("narrowest allowed", f"{report.smallest_exit_beam_diameter_mm:.3f} mm"),
        ("effective focal length", f"{report.efl_mm:.4f} mm"),
        ("back focal length", f"{report.bfl_mm:.4f} mm"),
        (f"RMS spot diameters at {report.spot_plane_mm:g} mm", f"{spots} mm"),
        ("thickness, track", f"{thickness:.4g}, {lens.track_mm:.4g} mm"),
    ]
    return "".join(f"<tr><td>{text(name)}</td><td>{text(value)}</td></tr>" for name, value in rows)
