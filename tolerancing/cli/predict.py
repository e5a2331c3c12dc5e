"""The command that predicts a study without trials."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import print_json
from tolerancing.cli.tables import print_table

if TYPE_CHECKING:
    from tolerancing.wavefronts.prediction import WavefrontPrediction

MOST_ROWS = 12
"""Perturbations that the table shows."""


def predict(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="Study file (TOML).")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Predict wavefronts and yield from the rays of the nominal lens, without trials.

    Path differences to second order in the perturbations, shift and focus taken out, at the object points of
    the study's merits of kind rms_waves and strehl.

    Exit status: 0, 1 if second order does not suffice and trials should be run, 2 for bad input.
    """
    from tolerancing.study.files import load_study
    from tolerancing.wavefronts.prediction import predict as predicted

    loaded = load_study(study)
    found = predicted(loaded.lens, loaded.study)
    if as_json:
        print_json(_as_dict(found))
    else:
        _print(loaded.study.title, found)
    raise typer.Exit(0 if found.second_order_suffices else 1)


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
