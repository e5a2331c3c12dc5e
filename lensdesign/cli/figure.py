"""Command that converts an interferogram into the measured figure of a surface."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Json, output_option


class Side(StrEnum):
    FRONT = "front"
    BACK = "back"


def figure(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Interferogram: Zygo .dat (MetroPro) or .datx (Mx).")
    ],
    output: Annotated[Path, output_option("Grid file to write, .csv.", "FILE")],
    side: Annotated[
        Side,
        typer.Option(help="Side of the glass on which the surface lies.", rich_help_panel=OptionGroup.LENS),
    ],
    keep_power: Annotated[
        bool,
        typer.Option(
            "--keep-power",
            help="Keep the power of the map; default: it is removed, like piston and tilt.",
            rich_help_panel=OptionGroup.LENS,
        ),
    ] = False,
    spacing_mm: Annotated[
        float | None,
        typer.Option(
            help="Distance between neighbouring points on the surface; default: that of the file.",
            rich_help_panel=OptionGroup.LENS,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Convert an interferogram into a grid file with the sag errors of a surface.

    A design with `[surface.figure]` and `file = "front.csv"` then has the surface as made. The middle of the
    measured area becomes the vertex. Isolated points without data are filled from their neighbours.

    Example: lensdesign figure front.dat --side front -o front.csv
    """
    from lensdesign.files.interferograms import figure_map, read_interferogram
    from lensdesign.files.surface_figures import write_surface_figure_grid

    found = figure_map(read_interferogram(file, spacing_mm), side.value, keep_power=keep_power)
    write_surface_figure_grid(found.sag_error_mm, found.spacing_mm, output)
    rows, columns = found.sag_error_mm.shape
    if as_json:
        print_json(
            {
                "points": [columns, rows],
                "spacing_mm": found.spacing_mm,
                "semi_diameter_mm": found.semi_diameter_mm,
                "tilt_x_deg": found.tilt_deg[0],
                "tilt_y_deg": found.tilt_deg[1],
                "power_um": found.power_um,
                "pv_um": found.pv_um,
                "rms_um": found.rms_um,
                "bridged_points": found.bridged_points,
                "ignored_points": found.ignored_points,
            }
        )
        return
    power = "kept" if keep_power else "removed"
    typer.echo(f"{columns} x {rows} points, {found.spacing_mm:.4g} mm apart")
    if found.bridged_points:
        typer.echo(f"{found.bridged_points} isolated points without data, filled from their neighbours")
    if found.ignored_points:
        typer.echo(f"{found.ignored_points} points with heights far from all others, ignored")
    typer.echo(f"measured without gaps up to a semi-diameter of {found.semi_diameter_mm:.4g} mm")
    typer.echo(f"tilt {found.tilt_deg[0]:.3g}° and {found.tilt_deg[1]:.3g}° along x and y, removed")
    typer.echo(f"power {found.power_um:.3g} µm, {power}")
    typer.echo(f"sag error {found.pv_um:.3g} µm peak to valley, {found.rms_um:.3g} µm rms")
    typer.echo(f"wrote {output}")
