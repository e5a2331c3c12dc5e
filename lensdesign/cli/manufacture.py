"""Commands that export a lens for manufacture, viewers and other programs, and the import command."""

from __future__ import annotations

import math
import os
from contextlib import ExitStack
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.analysis.outline import drawn_outline
from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Design, Json, output_option
from lensdesign.common.outputs import output_file
from lensdesign.common.text import alternatives, finite_or_none, visible
from lensdesign.errors import InputError
from lensdesign.files.formats import LENS_FORMATS, read_lens_file
from lensdesign.manufacture.exports import ExportOptions, export_kinds, export_lens
from lensdesign.manufacture.step.step_files import STEP_SUFFIXES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lensdesign.files.draft import Imported
    from lensdesign.lens.lens import Lens
    from lensdesign.lens.poses import Pose
    from lensdesign.manufacture.drawing.nominal import Stated
    from lensdesign.manufacture.drawing.predicted_yield import DrawingYield
    from lensdesign.manufacture.drawing.primitives import Drawing
    from lensdesign.manufacture.step.writing import StepReport

LENS_FILES = alternatives(f"{of.program} {suffix}" for suffix, of in LENS_FORMATS.items())


def export(
    design: Design,
    file: Annotated[
        Path,
        typer.Argument(callback=output_file, metavar="FILE", help=f"{export_kinds()}.".capitalize()),
    ],
    chord_error_um: Annotated[
        float,
        typer.Option(
            help="Largest distance between mesh and exact optical surfaces.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = 0.1,
    measured: Annotated[
        bool,
        typer.Option(
            "--measured", help="With the measured figures of the surfaces.", rich_help_panel=OptionGroup.LENS
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Write the glass as mesh, exact solids or outline in section, or the lens as another program's file.

    If the design has no edge, the glass has the ground diameter of the drawing; the file and a note state it.

    Surfaces have their nominal shape. Meshes support --measured; otherwise a note names surfaces whose
    measured figure is omitted. Files of other programs contain no coatings and no roughness; notes name the
    surfaces.

    Example: lensdesign export lens.toml lens.stl
    """
    from lensdesign.files.design import load_design

    options = ExportOptions(chord_error_um, measured, warn=lambda note: typer.echo(note, err=True))
    exported = export_lens(load_design(design), file, options)
    if as_json:
        print_json(exported.values)
    else:
        print_outline(exported.outline)
        typer.echo(f"wrote {file}: {exported.sentence}")


def scene(
    design: Design,
    output: Annotated[Path, output_option("Scene to write, .glb.", "FILE")],
    as_json: Json = False,
) -> None:
    """Write glass, stop, object, sensor planes and rays as a 3D scene for viewers."""
    from lensdesign.files.design import load_design
    from lensdesign.plots.glb import write_scene

    lens = load_design(design)
    nodes = write_scene(lens, output)
    outline = outline_of(lens)
    if as_json:
        print_json({"file": str(output), "nodes": list(nodes), "outline": list(outline)})
    else:
        print_outline(outline)
        typer.echo(f"wrote {output}: {', '.join(nodes)}")


def outline_of(lens: Lens) -> tuple[str, ...]:
    """Return one sentence on the outline of each element in a scene."""
    from lensdesign.raytrace.paths import sized_lens

    return drawn_outline(sized_lens(lens)).statements


def print_outline(statements: Sequence[str]) -> None:
    """Print the outline of each element, as a note."""
    for statement in statements:
        typer.echo(f"outline: {visible(statement)}", err=True)


def drawing(
    design: Design,
    output: Annotated[
        Path, output_option("Drawing, .pdf, .svg or .dxf; or solids with its tolerances, .step.", "FILE")
    ],
    sheet: Annotated[
        Path | None,
        typer.Option(
            metavar="SHEET",
            help="Title block, tolerances and their unit (TOML); default: an empty title block, and the "
            "tolerances of ISO 10110-11.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = None,
    tolerances: Annotated[
        Path | None,
        typer.Option(
            metavar="STUDY",
            help="Tolerance study or budget whose tolerances the sheet states.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = None,
    as_drawn: Annotated[
        Path | None,
        typer.Option(
            callback=output_file,
            metavar="DESIGN",
            help="Design to write, with the edges and values of the sheet.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = None,
    study_as_drawn: Annotated[
        Path | None,
        typer.Option(
            callback=output_file,
            metavar="STUDY",
            help="Tolerance study to write, with all tolerances of the sheet.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = None,
    accept_yield_loss: Annotated[
        bool,
        typer.Option(
            "--accept-yield-loss",
            help="Draw sheets that lose more than 2 percentage points of the study's predicted yield.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Draw the lens for manufacture after ISO 10110: one sheet for each glass element.

    If the design has no edge, one is chosen with margins for mount, bevel and tolerance. Radii and
    thicknesses are rounded to a tenth of their tolerance. Notes state all chosen and rounded values. A lens
    that cannot be manufactured is rejected.

    A STEP file (AP242) has the solids of the drawing with its tolerances, which CAD and measuring programs
    read.

    With --tolerances the sheet states the tolerances of the study. Tolerances that the study does not specify
    are derived from it, or are general tolerances if these cost no yield; the sheet marks both. The predicted
    yield with all tolerances of the sheet is printed together with that of the study. A sheet that loses more
    than 2 percentage points is rejected.

    Example: lensdesign drawing lens.toml --tolerances study.toml -o lens.pdf
    """
    from lensdesign.common.toml_files import read_toml, validate
    from lensdesign.files.design import load_design
    from lensdesign.manufacture.drawing.assumed import load_tolerances
    from lensdesign.manufacture.drawing.sheets import DRAWING_SUFFIXES, DrawingOptions, drawing_as_stated

    suffixes = (*DRAWING_SUFFIXES, *STEP_SUFFIXES)
    if output.suffix.lower() not in suffixes:
        raise InputError(f"cannot write {output}: the name must end in {alternatives(suffixes)}")
    in_use = {"the design itself": design, "the drawing": output, "the study": tolerances, "the sheet": sheet}
    for written in (as_drawn, study_as_drawn):
        for role, path in in_use.items():
            if written is not None and path is not None and written.resolve() == path.resolve():
                raise InputError(f"cannot write {written}: it is {role}; give another file name")
        in_use["the design as drawn"] = written
    if study_as_drawn is not None and tolerances is None:
        raise InputError(
            "--study-as-drawn needs --tolerances, the study that predicts the yield of the sheet"
        )
    options = DrawingOptions() if sheet is None else validate(DrawingOptions, read_toml(sheet), sheet)
    lens = load_design(design)
    assumed = None if tolerances is None else load_tolerances(tolerances, lens)
    predicted_yield, reason = None, ""
    if assumed is None or tolerances is None:
        made, stated = drawing_as_stated(lens, options, assumed)
    elif not assumed.is_study:
        made, stated = drawing_as_stated(lens, options, assumed)
        reason = f"{tolerances} has no [[merit]] tables"
    else:
        from lensdesign.manufacture.drawing.predicted_yield import drawing_with_yield, read_yield_predictor

        done = drawing_with_yield(lens, options, assumed, read_yield_predictor(tolerances), accept_yield_loss)
        made, stated, predicted_yield = done.drawing, done.stated, done.predicted_yield
        if predicted_yield is None:
            reason = f"none of the merits of {tolerances} can be predicted without trials"
    if study_as_drawn is not None and predicted_yield is None:
        raise InputError(
            f"cannot write {study_as_drawn}, which needs the predicted yield of the sheet: {reason}"
        )
    paths = (output, as_drawn, study_as_drawn)
    step = _write_as_drawn(made, stated, predicted_yield, paths, design)
    notes = list(stated.notes)
    if predicted_yield is not None:
        notes += _yield_notes(predicted_yield, accept_yield_loss)
    if assumed is not None and tolerances is not None:
        if assumed.design and (tolerances.parent / assumed.design).resolve() != design.resolve():
            notes.append(f"{tolerances} is a study of {assumed.design}, not of {design}")
        if predicted_yield is None and (missing := assumed.missing(lens)):
            notes.append(
                f"not stated by {tolerances}, and therefore not derived from it: {', '.join(missing)}"
            )
        if assumed.left_out:
            notes.append(f"not on the sheet: {', '.join(assumed.left_out)}")
    if reason:
        notes.append(f"the yield of the sheet is not predicted: {reason}")
    if as_json:
        values: dict[str, Any] = {"file": str(output), "sheets": len(made.sheets), "notes": notes}
        if step is not None:
            values["tolerances"] = [asdict(body) for body in step.tolerances]
        if assumed is not None:
            values |= {
                "study_yield": None if predicted_yield is None else predicted_yield.study_yield,
                "as_drawn_yield": None if predicted_yield is None else predicted_yield.as_drawn_yield,
                "study_interval": None if predicted_yield is None else predicted_yield.study_interval,
                "as_drawn_interval": None if predicted_yield is None else predicted_yield.as_drawn_interval,
            }
        print_json(values)
    else:
        for note in notes:
            typer.echo(f"note: {visible(note)}", err=True)
        sheets = f"{len(made.sheets)} {'sheet' if len(made.sheets) == 1 else 'sheets'}"
        typer.echo(f"wrote {output}: {sheets if step is None else _step_sentence(step)}")


def _step_sentence(step: StepReport) -> str:
    count = sum(body.count for body in step.tolerances)
    return (
        f"{step.solids} {'solid' if step.solids == 1 else 'solids'} with {count} semantic tolerances, read "
        f"back within {1e6 * step.largest_error_mm:.2g} nm of the true surface"
    )


def _write_as_drawn(
    made: Drawing,
    stated: Stated,
    predicted_yield: DrawingYield | None,
    paths: tuple[Path, Path | None, Path | None],
    design: Path,
) -> StepReport | None:
    """Write the drawing or its solids and, if requested, design and study as drawn: all files or none."""
    from lensdesign.files.design import design_text
    from lensdesign.manufacture.drawing.sheets import write_drawing
    from lensdesign.manufacture.step.writing import write_step

    output, as_drawn, study = paths
    with ExitStack() as stack:
        if as_drawn is not None:
            temporary = stack.enter_context(atomic_path(as_drawn))
            temporary.write_text(design_text(stated.lens, as_drawn.parent), encoding="utf-8")
        if study is not None and predicted_yield is not None:
            temporary = stack.enter_context(atomic_path(study))
            lens_file = (as_drawn or design).resolve()
            predicted_yield.save(
                temporary, Path(os.path.relpath(lens_file, study.resolve().parent)).as_posix()
            )
        if output.suffix.lower() not in STEP_SUFFIXES:
            write_drawing(made, output)
            return None
        outline = "; ".join(drawn_outline(stated.lens).statements)
        warn = partial(typer.echo, err=True)
        return write_step(stated.lens, output, warn, outline, stated.tolerances)


def _yield_notes(predicted_yield: DrawingYield, accepted: bool) -> list[str]:
    notes = [predicted_yield.sentence]
    if predicted_yield.reason:
        notes.append(
            "for the yield by trials, run the study that --study-as-drawn writes: tolerancing run STUDY "
            "--store STORE"
        )
    if predicted_yield.losses and accepted:
        notes.append(f"accepted loss of yield; the largest losses are {predicted_yield.worst}")
    if not (predicted_yield.is_trustworthy or predicted_yield.reason):
        notes.append(
            "tolerances are too large for the prediction: run the study that --study-as-drawn writes"
        )
    return notes


def sag(
    design: Design,
    output: Annotated[Path, output_option("Table to write, .csv.", "FILE")],
    surface: Annotated[
        int, typer.Option(help="Number of the surface, from 1.", rich_help_panel=OptionGroup.LENS)
    ],
    spacing_mm: Annotated[
        float, typer.Option(help="Distance between radial heights.", rich_help_panel=OptionGroup.EVALUATION)
    ] = 0.1,
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
    values = {
        "file": str(output),
        "rows": len(table.sag_mm),
        "best_fit_radius_mm": finite_or_none(table.best_fit_radius_mm),
        "largest_departure_mm": float(abs(table.departure_mm).max()),
        "asymmetric_rms_mm": table.asymmetric_rms_mm,
    }
    if as_json:
        print_json(values)
        return
    departure_um = 1e3 * float(abs(table.departure_mm).max())
    typer.echo(
        f"wrote {output}: {len(table.sag_mm)} rows, at most {departure_um:.4g} µm from {table.best_fit_text}"
    )


def import_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help=f"{LENS_FILES}.")],
    output: Annotated[Path, output_option("Design file to write.", "DESIGN")],
    lossy: Annotated[
        bool,
        typer.Option(
            "--lossy", help="Omit what a design cannot represent.", rich_help_panel=OptionGroup.INPUT
        ),
    ] = False,
    wavelength_um: Annotated[
        list[float] | None,
        typer.Option(
            help="Wavelength; may be repeated. Replaces the file's values.", rich_help_panel=OptionGroup.LENS
        ),
    ] = None,
    configuration: Annotated[
        int | None,
        typer.Option(
            help="Number of the configuration to read from a .zmx file.", rich_help_panel=OptionGroup.INPUT
        ),
    ] = None,
    working_distance_mm: Annotated[
        float | None, typer.Option(help="Replaces the file's value.", rich_help_panel=OptionGroup.LENS)
    ] = None,
    field_diameter_mm: Annotated[
        float | None, typer.Option(help="Replaces the file's value.", rich_help_panel=OptionGroup.LENS)
    ] = None,
    numerical_aperture: Annotated[
        float | None, typer.Option(help="Replaces the file's value.", rich_help_panel=OptionGroup.LENS)
    ] = None,
    pixel_pitch_um: Annotated[
        float | None, typer.Option(help="Pixel pitch of the sensor.", rich_help_panel=OptionGroup.CAMERA)
    ] = None,
    pixels: Annotated[
        tuple[int, int] | None,
        typer.Option(help="Pixels of the sensor along x and y.", rich_help_panel=OptionGroup.CAMERA),
    ] = None,
    plane_distance_mm: Annotated[
        list[float] | None,
        typer.Option(
            help="Distance of a sensor plane from the exit vertex; may be repeated.",
            rich_help_panel=OptionGroup.CAMERA,
        ),
    ] = None,
    glass_catalog: Annotated[
        list[Path] | None, typer.Option(help="AGF file; may be repeated.", rich_help_panel=OptionGroup.INPUT)
    ] = None,
    as_json: Json = False,
) -> None:
    """Convert another program's lens file to a design.

    Most files state no sensor, and some no object: options add what the file lacks, and a message names what
    is still missing. Contents that a design cannot represent are listed, and the import fails unless --lossy
    is given.

    Example: lensdesign import lens.zmx -o lens.toml --pixel-pitch-um 3.2
    """
    from lensdesign.files.design import save_design, validate_lengths
    from lensdesign.files.draft import LossyImportError, Supplement

    supplement = Supplement(
        working_distance_mm=working_distance_mm,
        field_diameter_mm=field_diameter_mm,
        numerical_aperture=numerical_aperture,
        pixel_pitch_um=pixel_pitch_um,
        pixels=pixels,
        plane_distances_mm=tuple(plane_distance_mm) if plane_distance_mm else None,
        glass_catalogs=tuple(glass_catalog or ()),
        wavelengths_um=tuple(wavelength_um) if wavelength_um else None,
        configuration=configuration,
    )
    found = read_lens_file(file, supplement, lossy)
    deviation = _pose_deviation(found.pose)
    if deviation and not lossy:
        raise LossyImportError(str(file), [f"pose of the lens {deviation}: a design has a nominal pose"])
    validate_lengths(found.lens, file)
    save_design(found.lens, output)
    _print_import(found, output, deviation, as_json)


def _pose_deviation(pose: Pose) -> str:
    """Return the components of a pose that are not nominal, in words."""
    names = [f.name for f in fields(pose) if f.name != "pivot_z_mm"]
    values = {name: float(getattr(pose, name)) for name in names}
    return ", ".join(f"{name} = {value:g}" for name, value in values.items() if value)


def _print_import(found: Imported, output: Path, deviation: str, as_json: bool) -> None:
    dropped = [*found.dropped, *([f"pose: {deviation}"] if deviation else [])]
    first = found.first_order
    lens = found.lens
    if as_json:
        values = first and {k: v if math.isfinite(v) else None for k, v in asdict(first).items()}
        print_json(
            {
                "design": str(output),
                "dropped": dropped,
                "remarks": list(found.remarks),
                "first_order": values,
            }
        )
        return
    for entry in dropped:
        typer.echo(f"left out: {visible(entry)}", err=True)
    for remark in found.remarks:
        typer.echo(f"note: {visible(remark)}", err=True)
    typer.echo(f"wrote {output}: {len(found.lens.surfaces)} surfaces")
    if first is not None:
        marginal = (
            f"is {first.stop_height_mm:.6g} mm high at the stop of {lens.stop_semi_diameter_mm:.6g} mm"
            if math.isfinite(first.stop_height_mm)
            else f"does not reach the stop of {lens.stop_semi_diameter_mm:.6g} mm"
        )
        typer.echo(
            f"traced as the file's records imply: focal length {first.efl_mm:.6g} mm, back focal length "
            f"{first.bfl_mm:.6g} mm, magnification {first.magnification:.6g} at "
            f"{first.image_distance_mm:.6g} mm; the marginal ray of NA {first.object_na:.6g} {marginal}"
        )
