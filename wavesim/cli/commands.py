"""The command `wavesim`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from lensdesign.common.console import make_app, print_json, run_app
from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Design, Json, output_option
from lensdesign.common.text import decimals_text, quantity_sentence, visible
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from wavesim.cli.calibrate import calibrate
from wavesim.cli.check_engine import check_engine
from wavesim.cli.choose import choose
from wavesim.cli.colours import colours
from wavesim.cli.compare import compare
from wavesim.cli.image import image
from wavesim.cli.options import numbers, validate_picture_request, with_settings
from wavesim.cli.plan import plan
from wavesim.cli.reconstruct import reconstruct
from wavesim.cli.resolve import LinewidthsUm, resolve
from wavesim.cli.runs import print_table
from wavesim.cli.view import view
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.settings import PoseSettings

app = make_app(
    "Wave-optical simulation of spatial information transfer lenses.",
    {
        "Simulate and reconstruct": {
            "image": "Simulate the frames that a sensor records of an object.",
            "reconstruct": "Find the object from frames.",
            "colours": "Find an object or heights at several wavelengths.",
            "calibrate": "Find from frames how the bench differs from the design.",
            "plan": "Recommend planes and exposures for an object.",
            "view": "Show a whole field or frame in the browser.",
        },
        "Predict and compare": {
            "pupil": "Predict the resolution with a lens that is displaced.",
            "choose-engine": "Choose the cheapest engine that is accurate enough.",
            "compare-engines": "Chart error against time of all engines.",
            "resolve-lines": "Test which lines each engine reconstructs.",
            "check-engine": "Compare an engine with an exact solution.",
        },
    },
    {
        "choose": "choose-engine",
        "compare": "compare-engines",
        "resolve": "resolve-lines",
        "oracle": "check-engine",
    },
)
for command in (plan, image, reconstruct, colours, calibrate, view):
    app.command()(with_settings(command))
app.command("choose-engine")(with_settings(choose))
app.command("compare-engines")(with_settings(compare))
app.command("resolve-lines")(with_settings(resolve))
app.command("check-engine")(with_settings(check_engine))


@app.command()
@with_settings
@most_used(
    "field_mm",
    "wavelength_um",
    "plane_distance_mm",
    "decenter_x_mm",
    "decenter_y_mm",
    "despace_mm",
    "tilt_x_deg",
    "tilt_y_deg",
    "linewidths_um",
    "refocus",
    "samples",
    "as_json",
    "output",
)
def pupil(
    design: Design,
    mounted: PoseSettings,
    field_mm: Annotated[
        str,
        typer.Option(
            metavar="X,Y", help="Position x,y of the object point.", rich_help_panel=OptionGroup.OBJECT
        ),
    ] = "0,0",
    wavelength_um: Annotated[
        float | None,
        typer.Option(
            help="Wavelength; default: the design's first.", rich_help_panel=OptionGroup.ILLUMINATION
        ),
    ] = None,
    plane_distance_mm: Annotated[
        float,
        typer.Option(help="Distance of the plane from the exit vertex.", rich_help_panel=OptionGroup.CAMERA),
    ] = 3.0,
    linewidths_um: LinewidthsUm = "1.55,0.775,0.6",
    refocus: Annotated[
        bool,
        typer.Option(help="Refocus the reconstruction digitally.", rich_help_panel=OptionGroup.EVALUATION),
    ] = True,
    samples: Annotated[
        int, typer.Option(help="Samples across the pupil.", rich_help_panel=OptionGroup.EVALUATION)
    ] = 128,
    as_json: Json = False,
    output: Annotated[Path | None, output_option("Picture to write (png, svg, pdf).")] = None,
) -> None:
    """Predict the resolution of a reconstruction if the lens is displaced.

    The reconstruction assumes the nominal lens. The difference between the displaced and the nominal lens is
    the phase of the reconstruction pupil, from which contrast and MTF are computed. Lines are resolved down
    to the finest ones with a contrast of 0.2 or more.

    Example: wavesim pupil lens.toml --decenter-y-mm 0.03 -o pupil.png
    """
    from wavesim.plots.frames import save
    from wavesim.plots.pupils import pupil_figure
    from wavesim.pupil.characteristic import PupilSampler
    from wavesim.pupil.pupil import refocus as to_best_focus
    from wavesim.pupil.pupil import remove_shift

    field = numbers(field_mm, "--field-mm", 2)
    widths = numbers(linewidths_um, "--linewidths-um")
    validate_picture_request(output)
    lens = load_design(design)
    validate_lengths(
        lens,
        {
            "wavelength_um": wavelength_um,
            "field_mm": field,
            "plane_distance_mm": plane_distance_mm,
            "linewidths_um": widths,
        },
    )
    validate_lengths(lens, mounted, wavelength_um)
    if math.hypot(*field) > lens.half_field_mm * (1.0 + 1e-9):
        raise InputError(
            f"--field-mm = {field_mm!r}: lies {math.hypot(*field):g} mm from the axis; allowed: up to "
            f"{lens.half_field_mm:g} mm, half the design's field_diameter_mm"
        )
    sampler = PupilSampler(lens, field, wavelength_um, plane_distance_mm, samples)
    registered = (to_best_focus if refocus else remove_shift)(sampler.pupil(mounted.pose))
    summary = {
        "design": lens.title or design.stem,
        "pose": vars(mounted.pose),
        "field_mm": list(field),
        "wavelength_um": sampler.grid.wavelength_um,
        "plane_distance_mm": plane_distance_mm,
        "samples": samples,
        "refocused": refocus,
    } | _pupil_metrics(registered, widths)
    if output is not None:
        save(pupil_figure(registered.pupil, widths, _title(summary, "µm")), output, dpi=110)
        summary["picture"] = str(output)
    if as_json:
        print_json(summary)
    else:
        _print_tables(summary)


def _pupil_metrics(registered: Any, widths_um: list[float]) -> dict[str, Any]:
    """Return all measures of one registered pupil for JSON."""
    import numpy as np

    from wavesim.pupil.line_pairs import line_pair_contrast, smallest_resolved_line_width_um
    from wavesim.pupil.pupil import mtf, rms_waves, strehl

    pupil = registered.pupil
    smallest_x = smallest_resolved_line_width_um(pupil, "x")
    smallest_y = smallest_resolved_line_width_um(pupil, "y")
    cut_off = 2e3 * pupil.grid.half_width / pupil.wavelength_um
    frequencies = cut_off * np.array((0.125, 0.25, 0.5, 0.75))
    transfer_x, transfer_y = mtf(pupil, frequencies, "x"), mtf(pupil, frequencies, "y")
    return {
        "throughput": pupil.throughput,
        "rms_waves": rms_waves(pupil),
        "strehl": strehl(pupil),
        "refocus_um": registered.refocus_um,
        "shift_um": registered.shift_um.tolist(),
        "line_pairs": [
            {
                "line_width_um": width,
                "contrast_x": line_pair_contrast(pupil, width, "x"),
                "contrast_y": line_pair_contrast(pupil, width, "y"),
            }
            for width in widths_um
        ],
        "smallest_resolved_line_width_x_um": smallest_x if np.isfinite(smallest_x) else None,
        "smallest_resolved_line_width_y_um": smallest_y if np.isfinite(smallest_y) else None,
        "mtf": [
            {"frequency_lp_per_mm": float(f), "modulation_x": float(x), "modulation_y": float(y)}
            for f, x, y in zip(frequencies, transfer_x, transfer_y, strict=True)
        ],
    }


def _title(summary: dict[str, Any], um: str) -> str:
    x, y = summary["field_mm"]
    focus = (
        f"refocused by {decimals_text(summary['refocus_um'])} {um}"
        if summary["refocused"]
        else "not refocused"
    )
    moved = ", ".join(_moved(name, value) for name, value in summary["pose"].items() if value)
    place = f"field ({x:g}, {y:g}) mm, {summary['wavelength_um']:g} {um}"
    return f"{summary['design']}\nlens: {moved or 'as designed'}; {place}, {focus}"


def _moved(name: str, value: float) -> str:
    """Describe one displacement of the lens, such as "decenter y 0.03 mm"."""
    return quantity_sentence(name, f"{value:g}")


def _print_tables(summary: dict[str, Any]) -> None:
    x, y = summary["shift_um"]
    for line in _title(summary, "µm").split("\n"):
        print(visible(line))
    print(f"wavefront {summary['rms_waves']:.4f} waves rms, Strehl ratio {summary['strehl']:.4f}")
    shift = f"x {decimals_text(x)} µm, y {decimals_text(y)} µm"
    print(f"image shift {shift}; throughput {summary['throughput']:.4f}")
    smallest = [summary[f"smallest_resolved_line_width_{axis}_um"] for axis in "xy"]
    pairs = [
        *(
            (f"{row['line_width_um']:g}", f"{row['contrast_x']:.3f}", f"{row['contrast_y']:.3f}")
            for row in summary["line_pairs"]
        ),
        ("smallest resolved", *("none" if s is None else f"{s:.3f} µm" for s in smallest)),
    ]
    print()
    print_table((), ("line width (µm)", "contrast, lines across x", "across y"), pairs)
    transfer = [
        (f"{row['frequency_lp_per_mm']:.0f}", f"{row['modulation_x']:.3f}", f"{row['modulation_y']:.3f}")
        for row in summary["mtf"]
    ]
    print()
    print_table((), ("frequency (lp/mm)", "modulation, across x", "across y"), transfer)
    if "picture" in summary:
        print(f"\npicture written to {summary['picture']}")


def main() -> None:
    """Run the command line."""
    run_app(app)


if __name__ == "__main__":
    main()
