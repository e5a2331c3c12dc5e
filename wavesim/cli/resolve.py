"""The command `wavesim resolve-lines`."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Design, Json, output_option
from lensdesign.common.progress import progress_count
from lensdesign.common.text import decimals_text, finite_or_none
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from wavesim.cli.options import (
    numbers,
    print_warnings,
    settings_text,
    validate_picture_request,
    warning_messages,
)
from wavesim.cli.runs import print_table
from wavesim.engines.registry import ENGINES
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.settings import SingleEngineDetails

LinewidthsUm = Annotated[
    str,
    typer.Option(
        metavar="NUMBER,...",
        help="Line widths, separated by commas.",
        rich_help_panel=OptionGroup.EVALUATION,
    ),
]
PlaneDistanceMm = Annotated[
    float,
    typer.Option(help="Distance of the exit plane from the exit vertex.", rich_help_panel=OptionGroup.CAMERA),
]
WavelengthUm = Annotated[
    float | None,
    typer.Option(help="Wavelength; default: the design's first.", rich_help_panel=OptionGroup.ILLUMINATION),
]


@most_used(
    "linewidths_um",
    "field_heights_mm",
    "engine",
    "reference",
    "bars",
    "plane_distance_mm",
    "wavelength_um",
    "slices",
    "pitch_um",
    "spacing",
    "output",
    "as_json",
)
def resolve(
    design: Design,
    details: SingleEngineDetails,
    linewidths_um: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER,...",
            help="Line widths, separated by commas; default: ten from the diffraction limit upwards.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = None,
    field_heights_mm: Annotated[
        str,
        typer.Option(
            "--field-heights-mm",
            "--field-mm",
            metavar="NUMBER,...",
            help="Field heights along y, separated by commas.",
            rich_help_panel=OptionGroup.OBJECT,
        ),
    ] = "0",
    engine: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENGINE[:SETTING=VALUE,...]",
            help="Engine that reconstructs the lines; repeat the option to compare several: eikonal, "
            "slices:slices=30,compensation=oblique.",
            show_default="slices",
            rich_help_panel=OptionGroup.ENGINE,
        ),
    ] = None,
    reference: Annotated[
        str,
        typer.Option(
            metavar=f"[{'|'.join(ENGINES)}]",
            help="Engine that propagates the lines to the exit plane.",
            rich_help_panel=OptionGroup.ENGINE,
        ),
    ] = "eikonal",
    bars: Annotated[
        int,
        typer.Option(
            help="Number of bars of each width, at least 5.", rich_help_panel=OptionGroup.EVALUATION
        ),
    ] = 5,
    plane_distance_mm: PlaneDistanceMm = 2.0,
    wavelength_um: WavelengthUm = None,
    output: Annotated[
        Path | None, output_option("Figure of contrast against line width to write (png, svg, pdf).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Test which lines of an object each engine can reconstruct from the field of a reference engine.

    `wavesim pupil` predicts the resolution of a lens.

    The object is a set of bright bars on a meridional line at each field point. The reference engine
    propagates it to the exit plane, and each named engine propagates the field back to the object. The result
    is refocused and registered. The remaining contrast shows which lines the engine can resolve.
    """
    from wavesim.metrics.resolving import usual_line_widths_um
    from wavesim.plots.frames import save
    from wavesim.plots.resolving import resolving_figure

    validate_picture_request(output)
    lens = load_design(design)
    heights = numbers(field_heights_mm, "--field-heights-mm")
    widths = (
        usual_line_widths_um(lens, wavelength_um)
        if linewidths_um is None
        else numbers(linewidths_um, "--linewidths-um")
    )
    validate_lengths(
        lens,
        {
            "wavelength_um": wavelength_um,
            "linewidths_um": widths,
            "field_heights_mm": heights,
            "plane_distance_mm": plane_distance_mm,
        },
    )
    validate_lengths(lens, details, wavelength_um)
    engines = _engines(engine or ["slices"], details.details())
    common = {
        "reference": reference,
        "wavelength_um": wavelength_um,
        "plane_distance_mm": plane_distance_mm,
        "bars": bars,
    }
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tests = _tests(lens, widths, heights, engines, common)
    print_warnings(warning_messages(caught))
    title = lens.title or design.stem
    if output is not None:
        light = f"{wavelength_um or lens.wavelengths_um[0]:g} µm"
        where = f"exit plane {plane_distance_mm:g} mm behind the exit vertex"
        drawn = resolving_figure(
            [result for results in tests for result in results], f"{title}\n{light}, {where}"
        )
        save(drawn, output, dpi=140)
    if as_json:
        summaries = [_resolve_summary(results, widths, title) for results in tests]
        print_json(summaries[0] if len(tests) == 1 else {"design": title, "engines": summaries})
        return
    for results in tests:
        _print_resolved(results)
    if output is not None:
        typer.echo(f"wrote {output}")


def _tests(
    lens: Any,
    widths: list[float],
    heights: list[float],
    engines: list[tuple[str, dict[str, Any]]],
    common: dict[str, Any],
) -> list[list[Any]]:
    """Return the results of each engine at all field heights, and show a progress bar."""
    from wavesim.metrics.resolving import resolve as resolving_test

    tests: list[list[Any]] = []
    total = len(engines) * len(heights)
    with progress_count("lines") as count:
        for k, (name, settings) in enumerate(engines):
            tests.append([])
            for j, height in enumerate(heights):
                count.update(k * len(heights) + j, total, f"{name}, field {height:g} mm")
                tests[-1].append(resolving_test(lens, widths, height, name, **common, **settings))
    return tests


def _engines(named: list[str], settings: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Return names and settings of the engines. Settings come from options, or follow the name."""
    if len(named) > 1 and settings:
        raise InputError(
            f"{', '.join(settings)}: cannot be used with several --engine; write settings behind the name of "
            "their engine, such as slices:slices=30,compensation=oblique"
        )
    return [_engine(text, settings) for text in named]


def _engine(text: str, settings: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    name, *rest = text.split(":", 1)
    found = dict(settings)
    for part in rest[0].split(",") if rest else ():
        setting, equals, value = (piece.strip() for piece in part.partition("="))
        if not (setting and equals and value):
            raise InputError(
                f"--engine = {text!r}: must be NAME or NAME:SETTING=VALUE,..., such as "
                "slices:slices=30,compensation=oblique"
            )
        found[setting] = _plain_value(value)
    return name, found


def _plain_value(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _resolve_summary(results: list[Any], widths: list[float], title: str) -> dict[str, Any]:
    def table(name: str) -> list[list[float | None]]:
        return [[finite_or_none(getattr(line, name)) for line in result.lines] for result in results]

    return {
        "design": title,
        "engine": results[0].engine,
        "reference": results[0].reference,
        "settings": [result.settings for result in results],
        "field_mm": [result.field_mm for result in results],
        "linewidths_um": widths,
        "contrast": table("contrast"),
        "weakest_contrast": table("weakest_contrast"),
        "contrast_as_is": table("contrast_as_is"),
        "contrast_of_reference": table("contrast_of_reference"),
        "smallest_resolved_um": [result.smallest_resolved_um() for result in results],
        "limited_by": [result.limit() for result in results],
        "orientation": "y",
        "aperture_passes_um": results[0].passed_um,
        "sample_um": results[0].sample_um,
        "refocus_um": table("refocus_um"),
        "shift_um": table("shift_um"),
        "exit_correlation": table("exit_correlation"),
    }


def _print_resolved(results: list[Any]) -> None:
    from wavesim.targets.bars import RESOLVED_CONTRAST

    first = results[0]
    settings = settings_text(first.settings)
    print(f"lines propagated by {first.reference}, reconstructed by {first.engine}")
    if settings:
        print(settings)
    print()
    columns = ["field\n(mm)", "line\n(µm)", "contrast", "weakest", "as is", first.reference]
    columns += ["refocus\n(µm)", "shift\n(µm)", "exit\ncorrelation"]
    rows = [
        (
            f"{result.field_mm:g}",
            f"{line.line_width_um:g}",
            f"{line.contrast:.3f}",
            f"{line.weakest_contrast:.3f}",
            f"{line.contrast_as_is:.3f}",
            f"{line.contrast_of_reference:.3f}",
            decimals_text(line.refocus_um, 2),
            decimals_text(line.shift_um),
            f"{line.exit_correlation:.4f}",
        )
        for result in results
        for line in result.lines
    ]
    print_table((), columns, rows)
    for result in results:
        limits = (_down_to(result, contrast) for contrast in (0.5, RESOLVED_CONTRAST))
        print(f"field {result.field_mm:g} mm: {', '.join(limits)}")
        print(f"  limit: {_limit(result)}")
    print("bars are repeated along y; the displacement (shift) is removed before contrast is measured")
    print()


def _down_to(result: Any, contrast: float) -> str:
    """Return the finest lines at several contrasts: a slowly falling contrast has no sharp limit."""
    smallest = result.smallest_resolved_um(contrast)
    if smallest is None:
        return f"no line has a contrast of {contrast:g}"
    return f"contrast of {contrast:g} or more down to {smallest:g} µm"


def _limit(result: Any) -> str:
    """Describe what limits the resolution at the usual contrast."""
    says = {
        "engine": f"the engine {result.engine} does not resolve finer lines",
        "reference": f"the reference engine {result.reference} does not resolve finer lines either",
        "aperture": f"diffraction at the aperture, {result.passed_um:.3g} µm (wavelength / 2 NA)",
        "widths": "none found; finer lines were not tested",
    }
    smallest = result.smallest_resolved_um()
    beyond = (
        f"; {smallest:g} µm is finer than the diffraction limit of {result.passed_um:.3g} µm"
        if smallest is not None and smallest < result.passed_um * (1.0 - 1e-9)
        else ""
    )
    return says[result.limit()] + beyond + _at_end(result)


def _at_end(result: Any) -> str:
    """Return the line widths whose best focus lies at the end of the search range."""
    from wavesim.metrics.resolving import REFOCUS_RANGE_MM, REFOCUS_STEP_MM

    most_um = 1e3 * (REFOCUS_RANGE_MM - 2.0 * REFOCUS_STEP_MM)
    widths = [f"{one.line_width_um:g}" for one in result.lines if abs(one.refocus_um) > most_um]
    if not widths:
        return ""
    return f"; lines of {', '.join(widths)} µm: best focus at the end of the search range (±{most_um:.0f} µm)"
