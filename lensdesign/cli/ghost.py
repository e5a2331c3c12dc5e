"""Command that lists the ghosts of a lens and its sensor."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.common.console import print_json, print_whole, say
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Design, Json

if TYPE_CHECKING:
    from rich.table import Table

    from lensdesign.analysis.double_reflections import GhostPath, GhostPaths
    from lensdesign.analysis.ghosts import GhostOnPlane, GhostReport
    from lensdesign.lens.lens import Lens


def ghost(
    design: Design,
    fraction: Annotated[
        float | None,
        typer.Option(
            "--share",
            help="Fraction of the light after reflection at both outer surfaces, 0 to 1; default: that of "
            "the design's coatings at normal incidence. It applies to the fringes alone.",
            rich_help_panel=OptionGroup.LENS,
        ),
    ] = None,
    wavelength_um: Annotated[
        float | None,
        typer.Option(
            help="Wavelength in µm; default: the design's first wavelength.",
            rich_help_panel=OptionGroup.ILLUMINATION,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """List light that is reflected twice in lens, cover glass and sensor, and fringes that pixels resolve.

    The list has the power of each path with the coatings of the design, and where it is focused. The ghost of
    the outer surfaces of the lens is coherent with the directly transmitted light. The sensor records
    interference fringes that are wider than two pixels.
    """
    from lensdesign.analysis.double_reflections import ghost_paths
    from lensdesign.analysis.ghosts import ghost_report
    from lensdesign.common.lengths import WAVELENGTH_UM, validate_length
    from lensdesign.files.design import load_design

    validate_length("--wavelength-um", wavelength_um, "um", WAVELENGTH_UM)
    lens = load_design(design)
    report, found = ghost_report(lens, fraction, wavelength_um), ghost_paths(lens, wavelength_um)
    if as_json:
        print_json({**report.as_dict(), "ghost_paths": found.as_dict()})
        return
    _print_paths(lens, found)
    typer.echo()
    _print_fringes(report)


def _print_paths(lens: Lens, found: GhostPaths) -> None:
    typer.echo("Ghosts: light that is reflected at a first and then at a second surface\n")
    table = _table()
    table.add_column("plane\n(mm)", justify="right", no_wrap=True)
    for name in ("first\nsurface", "second\nsurface"):
        table.add_column(name, no_wrap=True)
    columns = ("power", "on the\nsensor", "relative\nirradiance", "focus behind\nplane (mm)", "radius\n(mm)")
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    shown = [path for path in found.paths if path.power > 0.0]
    for path in shown:
        table.add_row(*_path_cells(path))
    print_whole(table)
    totals = ", ".join(f"{power:.3g} at {plane_mm:g} mm" for plane_mm, power in found.totals.items())
    typer.echo(f"\nall ghosts on the sensor: {totals}. Powers are fractions of that of the direct light.")
    if found.assumes_bare_surfaces:
        typer.echo("The list is for bare surfaces, because all coatings of the design are ideal.")
    elif len(shown) < len(found.paths):
        typer.echo("Paths without power, such as those via surfaces with an ideal coating, are not listed.")
    if not found.includes_sensor:
        typer.echo(
            "Paths via the sensor are missing, because the design does not state its reflectance: add "
            "reflectance = 0.05 (a fraction from 0 to 1) to [sensor]."
        )
    if lens.sensor.cover_glass is None:
        typer.echo("The sensor has no cover glass; [sensor.cover_glass] states one.")
    for warning in found.warnings:
        say("warning:", warning)


def _print_fringes(report: GhostReport) -> None:
    typer.echo("Fringes of the ghost between the outer surfaces of the lens, along y\n")
    typer.echo(f"fraction of the light at normal incidence {report.fraction:.3g}")
    typer.echo(f"effective and back focal length of the ghost {report.efl_mm:.4g}, {report.bfl_mm:.4g} mm\n")
    table = _table()
    for name in ("plane", "field", "falls on", "fringes on"):
        table.add_column(f"{name}\n(mm)", justify="right", no_wrap=True)
    for name in ("relative\nirradiance", "contrast\nof fringes"):
        table.add_column(name, justify="right", no_wrap=True)
    for one in report.on_planes:
        table.add_row(*_cells(one))
    print_whole(table)


def _table() -> Table:
    from rich.table import Table

    return Table(box=None, pad_edge=False)


def _path_cells(path: GhostPath) -> list[str]:
    numbers = (path.power, path.power_on_sensor, path.relative_irradiance)
    focus = f"{path.focus_mm:.4g}" if math.isfinite(path.focus_mm) else "at infinity"
    return [
        f"{path.plane_distance_mm:g}",
        path.first,
        path.second,
        *(f"{number:.2g}" if math.isfinite(number) else "" for number in numbers),
        focus,
        f"{path.radius_mm:.3g}" if math.isfinite(path.radius_mm) else "",
    ]


def _cells(one: GhostOnPlane) -> list[str]:
    cells = [f"{one.plane_distance_mm:g}", f"{one.field_mm:g}", f"{one.from_mm:.2f} to {one.to_mm:.2f}"]
    if one.relative_irradiance is None:
        return [*cells, "none", "", ""]
    fringes = f"{one.fringes_from_mm:.2f} to {one.fringes_to_mm:.2f}"
    return [*cells, fringes, f"{one.relative_irradiance:.2g}", f"{one.contrast:.3f}"]
