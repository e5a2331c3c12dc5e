"""Commands that make files of a lens, for shops, viewers and other programs, and the one that reads those."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.common.console import print_json
from lensdesign.common.text import visible
from lensdesign.errors import InputError, atomic_path
from lensdesign.fabrication.exports import ExportOptions, export_kinds, export_lens
from lensdesign.files.formats import LENS_FORMATS, read_lens_file

if TYPE_CHECKING:
    from lensdesign.files.draft import Imported
    from lensdesign.lens.lens import Lens
    from lensdesign.lens.poses import Pose

LENS_FILES = " or ".join(f"{of.program} {suffix}" for suffix, of in LENS_FORMATS.items())

Design = Annotated[Path, typer.Argument(metavar="DESIGN", help="Design file (TOML).", show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


def export(
    design: Design,
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help=f"{export_kinds()}.".capitalize()),
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

    Where the design has no edge, glass has the ground diameter that the drawing of the lens has; the file and
    a note state it.

    Surfaces have their nominal shape unless --measured is given, which only meshes take; a note names those
    whose figure is left out.
    """
    from lensdesign.files.design import load_design

    options = ExportOptions(chord_error_um, measured, report=lambda note: typer.echo(note, err=True))
    made = export_lens(load_design(design), file, options)
    if as_json:
        print_json(made.figures)
    else:
        typer.echo(f"wrote {file}: {made.sentence}")


def scene(
    design: Design,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Scene to write, .glb.")],
    as_json: Json = False,
) -> None:
    """Write glass, stop, object, sensor planes and rays as one scene that viewers turn."""
    from lensdesign.files.design import load_design
    from lensdesign.pictures.glb import write_scene

    lens = load_design(design)
    nodes = write_scene(lens, output)
    outline = print_outline(lens)
    if as_json:
        print_json({"file": str(output), "nodes": list(nodes), "outline": outline})
    else:
        typer.echo(f"wrote {output}: {', '.join(nodes)}")


def print_outline(lens: Lens) -> list[str]:
    """Print the outline of each element, and return the sentences."""
    from lensdesign.analysis.outline import drawn_outline
    from lensdesign.tracing.paths import sized_lens

    statements = list(drawn_outline(sized_lens(lens)).statements)
    for statement in statements:
        typer.echo(f"outline: {visible(statement)}", err=True)
    return statements


def drawing(
    design: Design,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Drawing, .pdf or .svg.")],
    sheet: Annotated[
        Path | None,
        typer.Option(metavar="SHEET", help="Title block and tolerances (TOML); else those of ISO 10110-11."),
    ] = None,
    tolerances: Annotated[
        Path | None,
        typer.Option(metavar="STUDY", help="Tolerance study or budget whose tolerances the sheet states."),
    ] = None,
    as_drawn: Annotated[
        Path | None,
        typer.Option(metavar="DESIGN", help="Design to write, with the edges and values of the sheet."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Draw the lens for the shop, after ISO 10110: a sheet for each glass element.

    Where the design has no edge, one is chosen that leaves room for mount, bevel and tolerance; radii and
    thicknesses are rounded to a tenth of their tolerance. Notes say what was chosen and rounded. A lens that
    cannot be made so is refused.
    """
    from lensdesign.common.toml_files import read_toml, validate
    from lensdesign.fabrication.drawing.assumed import load_tolerances
    from lensdesign.fabrication.drawing.sheets import DrawingOptions, drawing_as_stated, write_drawing
    from lensdesign.files.design import design_text, load_design

    for taken, what in ((design, "the design itself"), (output, "the drawing")):
        if as_drawn is not None and as_drawn.resolve() == taken.resolve():
            raise InputError(f"cannot write {as_drawn}: it is {what}; give another file name")
    options = None if sheet is None else validate(DrawingOptions, read_toml(sheet), sheet)
    lens = load_design(design)
    assumed = None if tolerances is None else load_tolerances(tolerances, lens)
    made, stated = drawing_as_stated(lens, options, assumed)
    if as_drawn is None:
        write_drawing(made, output)
    else:
        # Both or neither: a sheet beside a design that could not be written would be another lens's.
        with atomic_path(as_drawn) as temporary:
            temporary.write_text(design_text(stated.lens, as_drawn.parent), encoding="utf-8")
            write_drawing(made, output)
    notes = list(stated.notes)
    if assumed is not None and tolerances is not None:
        if assumed.design and (tolerances.parent / assumed.design).resolve() != design.resolve():
            notes.append(f"{tolerances} is a study of {assumed.design}, not of {design}")
        if missing := assumed.missing(lens):
            notes.append(f"not in {tolerances}, so not by it: {', '.join(missing)}")
        if assumed.left_out:
            notes.append(f"not on the sheet: {', '.join(assumed.left_out)}")
    if as_json:
        print_json({"file": str(output), "sheets": len(made.sheets), "notes": notes})
    else:
        for note in notes:
            typer.echo(f"note: {visible(note)}", err=True)
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


def import_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help=f"{LENS_FILES}.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DESIGN", help="Design file to write.")],
    lossy: Annotated[bool, typer.Option("--lossy", help="Leave out what a design cannot hold.")] = False,
    working_distance_mm: Annotated[float | None, typer.Option(help="In place of the file's.")] = None,
    field_diameter_mm: Annotated[float | None, typer.Option(help="In place of the file's.")] = None,
    numerical_aperture: Annotated[float | None, typer.Option(help="In place of the file's.")] = None,
    pixel_pitch_um: Annotated[float | None, typer.Option(help="Of the sensor.")] = None,
    pixels: Annotated[tuple[int, int] | None, typer.Option(help="Of the sensor, across x and y.")] = None,
    plane_distance_mm: Annotated[
        list[float] | None, typer.Option(help="Of a sensor plane from the exit vertex; several times.")
    ] = None,
    glass_catalog: Annotated[list[Path] | None, typer.Option(help="AGF file; several times.")] = None,
    as_json: Json = False,
) -> None:
    """Read another program's lens file into a design.

    What the file holds and a design cannot is listed and refused, or left out with --lossy.
    """
    from lensdesign.files.design import save_design
    from lensdesign.files.draft import LossyImportError, Supplement

    supplement = Supplement(
        working_distance_mm=working_distance_mm,
        field_diameter_mm=field_diameter_mm,
        numerical_aperture=numerical_aperture,
        pixel_pitch_um=pixel_pitch_um,
        pixels=pixels,
        plane_distances_mm=tuple(plane_distance_mm) if plane_distance_mm else None,
        glass_catalogs=tuple(glass_catalog or ()),
    )
    found = read_lens_file(file, supplement, lossy)
    moved = _moved(found.pose)
    if moved and not lossy:
        raise LossyImportError(str(file), [f"the lens stands at {moved}: a design stands on its axis"])
    save_design(found.lens, output)
    _tell(found, output, moved, as_json)


def _moved(pose: Pose) -> str:
    """What of a pose is not nominal, in words."""
    names = [f.name for f in fields(pose) if f.name != "pivot_z_mm"]
    values = {name: float(getattr(pose, name)) for name in names}
    return ", ".join(f"{name} = {value:g}" for name, value in values.items() if value)


def _tell(found: Imported, output: Path, moved: str, as_json: bool) -> None:
    dropped = [*found.dropped, *([f"pose: {moved}"] if moved else [])]
    if as_json:
        print_json({"design": str(output), "dropped": dropped, "remarks": list(found.remarks)})
        return
    for entry in dropped:
        typer.echo(f"left out: {visible(entry)}", err=True)
    for remark in found.remarks:
        typer.echo(f"note: {visible(remark)}", err=True)
    typer.echo(f"wrote {output}: {len(found.lens.surfaces)} surfaces")
