"""Command that locates the ghost of a lens."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.common.console import print_json, print_whole
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Design, Json

if TYPE_CHECKING:
    from lensdesign.analysis.ghosts import GhostOnPlane


def ghost(
    design: Design,
    fraction: Annotated[
        float | None,
        typer.Option(
            "--share",
            help="Fraction of the light after both reflections, 0 to 1; default: that of uncoated surfaces.",
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
    """Locate light that is reflected twice inside the lens, and the fringes that the pixels resolve.

    The ghost is coherent with the directly transmitted light. The sensor records interference fringes that
    are wider than two pixels.
    """
    from rich.table import Table

    from lensdesign.analysis.ghosts import ghost_report
    from lensdesign.common.lengths import WAVELENGTH_UM, validate_length
    from lensdesign.files.design import load_design

    validate_length("--wavelength-um", wavelength_um, "um", WAVELENGTH_UM)
    report = ghost_report(load_design(design), fraction, wavelength_um)
    if as_json:
        print_json(report.as_dict())
        return
    typer.echo(f"fraction of the light {report.fraction:.3g}")
    typer.echo(f"effective and back focal length of the ghost {report.efl_mm:.4g}, {report.bfl_mm:.4g} mm\n")
    table = Table(box=None, pad_edge=False)
    for name in ("plane", "field", "falls on", "fringes on"):
        table.add_column(f"{name}\n(mm)", justify="right", no_wrap=True)
    for name in ("relative\nirradiance", "contrast\nof fringes"):
        table.add_column(name, justify="right", no_wrap=True)
    for one in report.on_planes:
        table.add_row(*_cells(one))
    print_whole(table)


def _cells(one: GhostOnPlane) -> list[str]:
    cells = [f"{one.plane_distance_mm:g}", f"{one.field_mm:g}", f"{one.from_mm:.2f} to {one.to_mm:.2f}"]
    if one.relative_irradiance is None:
        return [*cells, "none", "", ""]
    fringes = f"{one.fringes_from_mm:.2f} to {one.fringes_to_mm:.2f}"
    return [*cells, fringes, f"{one.relative_irradiance:.2g}", f"{one.contrast:.3f}"]
