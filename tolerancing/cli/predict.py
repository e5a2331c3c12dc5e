"""The command that predicts a study without trials."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import print_json
from tolerancing.cli.tables import print_table

if TYPE_CHECKING:
    from tolerancing.wavefronts.prediction import WavefrontPrediction
    from tolerancing.wavefronts.rays import RayPrediction

MOST_ROWS = 12
"""Perturbations that the table shows."""


def predict(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="Study file (TOML).")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Predict wavefronts, spreads, footprints and yields from the rays of the nominal lens, without trials.

    Path differences to second order in the perturbations, shift and focus taken out, at the object points of
    the study's merits of kind rms_waves and strehl; for largest_spread_deg and footprint_radius_mm rays to
    first order, of which 64 draws are traced to know whether that suffices.

    Exit status: 0, 1 if these orders do not suffice and trials should be run, 2 for bad input.
    """
    from tolerancing.study.files import load_study
    from tolerancing.wavefronts.prediction import predict as predicted
    from tolerancing.wavefronts.prediction import wavefront_points
    from tolerancing.wavefronts.rays import predict_rays

    loaded = load_study(study)
    rays = predict_rays(loaded.lens, loaded.study)
    waves = predicted(loaded.lens, loaded.study) if wavefront_points(loaded.study) or not rays else None
    columns = tuple(p.column for p in loaded.study.perturbations)
    if as_json:
        print_json(({} if waves is None else _as_dict(waves)) | {"rays": _rays_dict(rays, columns)})
    else:
        if waves is not None:
            _print(loaded.study.title, waves)
        if rays:
            _print_rays(loaded.study.title, rays, columns)
    suffices = (waves is None or waves.second_order_suffices) and all(r.first_order_suffices for r in rays)
    raise typer.Exit(0 if suffices else 1)


def _as_dict(found: WavefrontPrediction) -> dict[str, Any]:
    return {
        "good": found.good,
        "draws": found.draws,
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
            "left": r.left,
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
    print_table("Share of the mean square, %", ["perturbation"], points, shares)
    print(f"good at all points: {100.0 * found.good:.1f} % of {found.draws} draws; no trial was traced")
    if not found.second_order_suffices:
        print("tolerances are too large for second order, which may be 5 % off and more: run the study")


def _print_rays(title: str, rays: tuple[RayPrediction, ...], columns: tuple[str, ...]) -> None:
    rows = [
        (
            r.merit.column,
            *(f"{value:.4f}" for value in (r.nominal, r.mean, r.deviation)),
            f"{100.0 * r.good:.1f}",
            f"{100.0 * r.left:.1f}",
        )
        for r in rays
    ]
    heads = ["nominal", "mean", "deviation", "good, %", "off, % of deviation"]
    print_table(f"{title}: rays, to first order", ["merit"], heads, rows)
    order = sorted(range(len(columns)), key=lambda k: -max(r.shares[k] for r in rays))
    alone = [(columns[k], *(f"{r.alone[k]:.4f}" for r in rays)) for k in order[:MOST_ROWS]]
    print_table("Deviation by itself", ["perturbation"], [row[0] for row in rows], alone)
    if not all(r.first_order_suffices for r in rays):
        print("tolerances are too large for rays to first order, as traced draws tell: run the study")
