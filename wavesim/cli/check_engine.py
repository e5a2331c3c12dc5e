"""The command `wavesim check-engine`: compare an engine with an exact solution."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Json
from wavesim.analytic.registry import ANALYTIC_CASES
from wavesim.cli.options import print_warnings, settings_text
from wavesim.cli.runs import print_table
from wavesim.engines.registry import ENGINES
from wavesim.scene.settings import SingleEngineDetails


@most_used(
    "engine",
    "solution",
    "radius_mm",
    "semi_diameter_mm",
    "incidence_deg",
    "tile_width_mm",
    "slices",
    "compensation",
    "spacing",
    "step_um",
    "pitch_um",
    "as_json",
)
def check_engine(
    engine: Annotated[
        str,
        typer.Option(
            metavar=f"[{'|'.join(ENGINES)}]",
            help="Engine that is compared with the exact solution.",
            rich_help_panel=OptionGroup.ENGINE,
        ),
    ],
    details: SingleEngineDetails,
    solution: Annotated[
        str,
        typer.Option(
            "--solution",
            "--oracle",
            metavar=f"[{'|'.join(ANALYTIC_CASES)}]",
            help="Exact solution.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = "cylinder",
    radius_mm: Annotated[
        float | None,
        typer.Option(help="Radius of the cylinder or sphere.", rich_help_panel=OptionGroup.EVALUATION),
    ] = None,
    semi_diameter_mm: Annotated[
        float | None,
        typer.Option(
            help="Semi-diameter of the stigmatic lens or the stop.", rich_help_panel=OptionGroup.EVALUATION
        ),
    ] = None,
    incidence_deg: Annotated[
        float | None,
        typer.Option(
            help="Angle of incidence on the plate or plane.", rich_help_panel=OptionGroup.EVALUATION
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare an engine with an exact solution.

    The error is the L2 norm of the difference of both exit fields, divided by that of the exact field.
    Neither phase nor amplitude is fitted. Options that are not given keep the defaults of the solution and
    the engine.
    """
    from wavesim.metrics.accuracy import run_analytic_case

    of_solution = {"semi_diameter_mm": semi_diameter_mm, "incidence_deg": incidence_deg}
    result = run_analytic_case(
        engine,
        solution,
        radius_mm,
        {name: value for name, value in of_solution.items() if value is not None},
        **details.details(),
    )
    print_warnings(result.warnings)
    if as_json:
        print_json(_summary(result))
    else:
        _print_table(result)


def _summary(result: Any) -> dict[str, Any]:
    return {
        "engine": result.engine,
        "solution": result.solution,
        "radius_mm": result.radius_mm,
        "relative_error": result.relative_error,
        "uncertainty": result.uncertainty,
        "seconds": result.seconds,
        "setup_seconds": result.setup_seconds,
        "peak_mb": result.peak_mb,
        "predicted": {
            "seconds": result.predicted.seconds,
            "setup_seconds": result.predicted.setup_seconds,
            "peak_mb": 1e-6 * result.predicted.peak_bytes,
        },
        "settings": result.settings,
        "warnings": list(result.warnings),
    }


def _print_table(result: Any) -> None:
    of_radius = "" if result.radius_mm is None else f", radius {result.radius_mm:g} mm"
    print(f"{result.engine} on the exact {result.solution}{of_radius}")
    print(f"relative error {result.relative_error:.3g} (error of the exact field: {result.uncertainty:.1g})")
    print()
    predicted = result.predicted
    rows = (
        ("seconds", f"{result.seconds:.3g}", f"{predicted.seconds:.3g}"),
        ("set-up seconds", f"{result.setup_seconds:.3g}", f"{predicted.setup_seconds:.3g}"),
        ("peak memory (MB)", f"{result.peak_mb:.3g}", f"{1e-6 * predicted.peak_bytes:.3g}"),
    )
    print_table(("",), ("measured", "predicted"), rows)
    if result.settings:
        print(f"\nsettings: {settings_text(result.settings)}")
