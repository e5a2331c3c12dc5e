"""Commands for the shop and the model: meshes, scenes, drawings, sag tables."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from lensdesign.common.console import print_json
from lensdesign.errors import InputError

Design = Annotated[Path, typer.Argument(metavar="DESIGN", help="Design file (TOML).", show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


def export(
    design: Design,
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Mesh (.stl, .ply, .obj, .glb, .3mf), exact solid (.step, .stp) or lens file (.zmx, .seq).",
        ),
    ],
    chord_error_um: Annotated[
        float, typer.Option(help="Largest distance between mesh and true surface, on the optical surfaces.")
    ] = 0.1,
    measured: Annotated[
        bool, typer.Option("--measured", help="With the measured figures of the surfaces.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Write the lens's glass as a mesh or as exact solids, or the lens as another program's file.

    Surfaces have their nominal shape unless --measured is given, which only meshes take; a note names those
    whose figure is left out.
    """
    from lensdesign.cli.exchange import FORMATS, write_exchange
    from lensdesign.fabrication.step.export import STEP_SUFFIXES

    if file.suffix.lower() in FORMATS:
        write_exchange(design, file, as_json)
    elif file.suffix.lower() in STEP_SUFFIXES:
        _write_step(design, file, measured, as_json)
    else:
        _write_mesh(design, file, chord_error_um, measured, as_json)


def _write_mesh(design: Path, file: Path, chord_error_um: float, measured: bool, as_json: bool) -> None:
    from lensdesign.fabrication.mesh.mesh import write_mesh
    from lensdesign.files.design import load_design

    lens = load_design(design)
    mesh = write_mesh(
        lens,
        file,
        chord_error_um,
        report=lambda note: typer.echo(note, err=True),
        measured=measured,
    )
    left_out = [] if measured else [i for i, s in enumerate(lens.surfaces, start=1) if s.figure]
    figures = {
        "file": str(file),
        "triangles": mesh.triangles,
        "chord_error_um": mesh.chord_error_um,
        "edge_error_um": mesh.edge_error_um,
        "volume_mm3": mesh.volume_mm3,
        "exact_volume_mm3": mesh.exact_volume_mm3,
        "surfaces_without_their_figure": left_out,
    }
    if as_json:
        print_json(figures)
        return
    typer.echo(
        f"wrote {file}: {mesh.triangles} triangles, within {figures['chord_error_um']:.3g} um of the true "
        f"surface, volume {mesh.volume_mm3:.6g} mm^3 (exact {mesh.exact_volume_mm3:.6g} mm^3)"
    )


def _write_step(design: Path, file: Path, measured: bool, as_json: bool) -> None:
    from lensdesign.fabrication.step.export import write_step
    from lensdesign.files.design import load_design

    if measured:
        raise InputError(
            f"cannot write {file} with --measured: solids have nominal surfaces; a mesh takes it"
        )
    lens = load_design(design)
    found = write_step(lens, file, report=lambda note: typer.echo(note, err=True))
    if as_json:
        print_json(
            {
                "file": str(file),
                "bytes": found.bytes,
                "solids": [asdict(body) for body in found.bodies],
                "surfaces_without_their_figure": [
                    i for i, s in enumerate(lens.surfaces, start=1) if s.figure
                ],
            }
        )
        return
    typer.echo(
        f"wrote {file}: {found.solids} {'solid' if found.solids == 1 else 'solids'}, read back within "
        f"{1e6 * found.largest_error_mm:.2g} nm of the true surface, volume {found.volume_mm3:.9g} mm^3 "
        f"(exact {found.exact_volume_mm3:.9g} mm^3)"
    )


def scene(
    design: Design,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Scene to write, .glb.")],
    as_json: Json = False,
) -> None:
    """Write glass, stop, object, sensor planes and rays as one scene that viewers turn."""
    from lensdesign.files.design import load_design
    from lensdesign.pictures.glb import write_scene

    nodes = write_scene(load_design(design), output)
    if as_json:
        print_json({"file": str(output), "nodes": list(nodes)})
    else:
        typer.echo(f"wrote {output}: {', '.join(nodes)}")


def drawing(
    design: Design,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Drawing, .pdf or .svg.")],
    sheet: Annotated[
        Path | None,
        typer.Option(metavar="SHEET", help="Title block and tolerances (TOML); else those of ISO 10110-11."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Draw the lens for the shop, after ISO 10110: a sheet for each glass element."""
    from lensdesign.common.toml_files import read_toml, validate
    from lensdesign.fabrication.drawing.sheets import DrawingOptions, lens_drawing, write_drawing
    from lensdesign.files.design import load_design

    options = None if sheet is None else validate(DrawingOptions, read_toml(sheet), sheet)
    made = lens_drawing(load_design(design), options)
    write_drawing(made, output)
    if as_json:
        print_json({"file": str(output), "sheets": len(made.sheets)})
    else:
        typer.echo(f"wrote {output}: {len(made.sheets)} {'sheet' if len(made.sheets) == 1 else 'sheets'}")


def sag(
    design: Design,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Table to write, .csv.")],
    surface: Annotated[int, typer.Option(help="Number of the surface, from 1.")],
    spacing_mm: Annotated[float, typer.Option(help="Between radial heights.")] = 0.1,
    as_json: Json = False,
) -> None:
    """Tabulate sag, slope and departure from the best-fit sphere of one surface."""
    from lensdesign.analysis.sag_tables import sag_table, write_sag_table
    from lensdesign.files.design import load_design

    lens = load_design(design)
    if not 1 <= surface <= len(lens.surfaces):
        raise InputError(f"--surface {surface}: the design has surfaces 1 to {len(lens.surfaces)}")
    if output.suffix.lower() != ".csv":
        raise InputError(f"cannot write {output}: the name must end in .csv")
    table = sag_table(lens, surface - 1, spacing_mm)
    write_sag_table(table, output)
    figures = {
        "file": str(output),
        "rows": len(table.sag_mm),
        "best_fit_radius_mm": table.best_fit_radius_mm,
        "largest_departure_mm": float(abs(table.departure_mm).max()),
        "asymmetric_rms_mm": table.asymmetric_rms_mm,
    }
    if as_json:
        print_json(figures)
        return
    departure_um = 1e3 * float(abs(table.departure_mm).max())
    typer.echo(
        f"wrote {output}: {len(table.sag_mm)} rows, at most {departure_um:.4g} um from the best-fit sphere "
        f"of {table.best_fit_radius_mm:.6g} mm"
    )
