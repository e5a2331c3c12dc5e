"""The command that predicts a study without trials."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import StudyFile
from lensdesign.common.text import finite_or_none
from tolerancing.cli.tables import print_table

if TYPE_CHECKING:
    from pathlib import Path

    from tolerancing.prediction.ray_prediction import RayPrediction
    from tolerancing.prediction.study_prediction import StudyPrediction
    from tolerancing.prediction.wavefront_prediction import WavefrontPrediction

MOST_ROWS = 12
"""Perturbations that the table shows."""


def predict(
    study: StudyFile,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object.", rich_help_panel=OptionGroup.OUTPUT)
    ] = False,
) -> None:
    """Predict yields, wavefronts, spreads and footprints from the rays of the nominal lens, without trials.

    The yield is joint: the fraction of lenses that keep all limits of the study at once. It is printed only
    if every limit is predicted: those of rays, of pupils (rms_waves, strehl, line_pair_contrast, ...) and of
    reconstruction_loss. Other merits need trials. Wavefronts are predicted to second order in the
    perturbations, rays and losses to first order; 16 to 64 traced draws measure the error.

    Example: tolerancing predict study.toml

    Exit status: 0 if the yield is predicted and the errors are small, 1 if not and trials should be run, 2
    for bad input.
    """
    from tolerancing.prediction.study_prediction import predict_study
    from tolerancing.study.files import load_study

    loaded = load_study(study)
    found = predict_study(loaded.lens, loaded.study)
    columns = tuple(p.column for p in loaded.study.perturbations)
    if as_json:
        waves = {} if found.wavefronts is None else _as_dict(found.wavefronts)
        print_json(
            {
                **yield_dict(found),
                "limits": {one.merit.label: one.yield_fraction for one in found.limits},
                "errors": {one.merit.label: finite_or_none(one.error) for one in found.limits},
                **waves,
                "rays": _rays_dict(found.rays, columns),
            }
        )
    else:
        if found.wavefronts is not None:
            _print(loaded.study.title, found.wavefronts)
        if found.rays:
            _print_rays(loaded.study.title, found.rays, columns)
        _print_yield(found, study)
    raise typer.Exit(0 if found.is_trustworthy else 1)


def yield_dict(found: StudyPrediction) -> dict[str, Any]:
    """Return the predicted yield over all limits for JSON; null with a reason if it is not predicted."""
    joint = found.joint
    return {
        "yield": None if joint is None else joint.fraction,
        "yield_low": None if joint is None else joint.low,
        "yield_high": None if joint is None else joint.high,
        "draws": found.draws,
        "not_predicted": list(found.not_predicted),
        "reason": found.reason,
    }


def yield_text(found: StudyPrediction) -> str:
    """Return the predicted yield with its interval, or why it is not predicted, as one phrase."""
    joint = found.joint
    if joint is None:
        return f"not predicted: {found.reason}"
    interval = f"{100.0 * joint.low:.1f} - {100.0 * joint.high:.1f} %"
    return f"{100.0 * joint.fraction:.1f} % of lenses keep all limits at once (95 % interval {interval})"


def _print_yield(found: StudyPrediction, study: Path) -> None:
    rows = [
        (
            one.merit.label,
            one.merit.limit_text,
            one.merit.location,
            f"{100.0 * one.yield_fraction:.1f}",
            f"{one.error:.2g}",
        )
        for one in found.limits
    ]
    rows += [(label, "", "", "not predicted", "") for label in found.not_predicted]
    joint = found.joint
    together = "not predicted" if joint is None else f"{100.0 * joint.fraction:.1f}"
    heads = ["good, %", "error of a score"]
    last = ("all limits at once", "", "", together, "")
    print_table("Predicted yield", ["merit", "limit", "field points"], heads, rows, last)
    if joint is None:
        print(
            f"the yield is {yield_text(found)}; by trials: tolerancing run {study} --store "
            f"{study.with_suffix('.db')}"
        )
        return
    print(f"{yield_text(found)}, from {joint.draws} drawn lenses")
    print("the error of a score is that of the draws that were traced as well; no trial was run")


def _as_dict(found: WavefrontPrediction) -> dict[str, Any]:
    return {
        "within_wavefront_limits": found.good,
        "wavefront_error": finite_or_none(found.relative_error),
        "second_order_suffices": found.second_order_suffices,
        "points": [
            {
                "field_mm": list(p.judged.field_mm),
                "wavelength_um": p.judged.wavelength_um,
                "limit_waves": p.judged.limit_waves,
                "rms_waves": p.rms_waves,
                "first_order_rms_waves": p.first_order_rms_waves,
                "good": p.good,
                "shares": dict(zip(found.perturbations, p.shares.tolist(), strict=True)),
            }
            for p in found.points
        ],
    }


def _rays_dict(rays: tuple[RayPrediction, ...], columns: tuple[str, ...]) -> list[dict[str, Any]]:
    return [
        {
            "merit": r.merit.label,
            "unit": r.merit.unit,
            "nominal": r.nominal,
            "mean": r.mean,
            "deviation": r.deviation,
            "good": r.good,
            "alone": dict(zip(columns, r.alone.tolist(), strict=True)),
            "left": r.relative_error,
            "first_order_suffices": r.first_order_suffices,
        }
        for r in rays
    ]


def _print(title: str, found: WavefrontPrediction) -> None:
    rows = [
        (
            "({:g}, {:g})".format(*p.judged.field_mm),
            f"{p.rms_waves:.4f}",
            f"{p.first_order_rms_waves:.4f}",
            f"{p.judged.limit_waves:.4f}",
            f"{100.0 * p.good:.1f}",
        )
        for p in found.points
    ]
    heads = ["rms, waves", "to first order", "limit", "good, %"]
    print_table(title, ["object point, mm"], heads, rows)
    order = sorted(range(len(found.perturbations)), key=lambda k: -max(p.shares[k] for p in found.points))
    shares = [
        (found.perturbations[k], *(f"{100.0 * p.shares[k]:.1f}" for p in found.points))
        for k in order[:MOST_ROWS]
    ]
    points = ["({:g}, {:g})".format(*p.judged.field_mm) for p in found.points]
    print_table("Fraction of the mean square, %", ["perturbation"], points, shares)
    if not found.second_order_suffices:
        print(
            f"tolerances are too large for the second order: it differs from traced draws by "
            f"{100.0 * found.relative_error:.0f} %; run the study"
        )


def _print_rays(title: str, rays: tuple[RayPrediction, ...], columns: tuple[str, ...]) -> None:
    rows = [
        (
            r.merit.column,
            *(f"{value:.4f}" for value in (r.nominal, r.mean, r.deviation)),
            f"{100.0 * r.good:.1f}",
            f"{100.0 * r.relative_error:.1f}",
        )
        for r in rays
    ]
    heads = ["nominal", "mean", "deviation", "good, %", "error, % of deviation"]
    print_table(f"{title}: rays, to first order", ["merit"], heads, rows)
    order = sorted(range(len(columns)), key=lambda k: -max(r.shares[k] for r in rays))
    alone = [(columns[k], *(f"{r.alone[k]:.4f}" for r in rays)) for k in order[:MOST_ROWS]]
    print_table("Deviation by each perturbation alone", ["perturbation"], [row[0] for row in rows], alone)
    if not all(r.first_order_suffices for r in rays):
        print("tolerances are too large for rays to first order, as the traced draws show: run the study")
