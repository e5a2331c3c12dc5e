"""The `lensdesign` command."""

from __future__ import annotations

import os
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.cli import compare as cli_compare
from lensdesign.cli import figure as cli_figure
from lensdesign.cli import ghost as cli_ghost
from lensdesign.cli import manufacture as cli_manufacture
from lensdesign.cli import search as cli_search
from lensdesign.cli import stock as cli_stock
from lensdesign.cli import testplates as cli_testplates
from lensdesign.cli import verify as cli_verify
from lensdesign.cli import view as cli_view
from lensdesign.cli import workbench as cli_workbench
from lensdesign.cli.tables import print_tables, table
from lensdesign.common.console import make_app, print_json, run_app, say
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Design, Json, Trust, output_option
from lensdesign.common.text import quantity_text, relation_symbol, visible
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table

    from lensdesign.analysis.coatings import CoatingReport
    from lensdesign.analysis.moulding import MouldingCheck
    from lensdesign.analysis.report import CheckReport
    from lensdesign.analysis.roughness import RoughnessReport

app = make_app(
    "Design non-imaging spatial information transfer lenses.",
    {
        "Design": {
            "optimize": "Find a lens that meets a specification.",
            "stock": "Find lenses of catalogues that meet a specification.",
            "testplates": "Find one whose spheres have radii of test plates.",
            "explore": "Find a Pareto front of lenses.",
            "limits": "Find the largest field, aperture or tolerances.",
            "scale": "Write the same lens at another size.",
            "glass": "Show a glass, or search for glasses.",
            "studio": "Change a lens in the browser and see the effects.",
        },
        "Evaluate": {
            "check": "Check a lens against its sensor or a specification.",
            "compare": "Compare designs side by side.",
            "draw": "Draw layout, spots, spread and a 3D view.",
            "view": "Show the lens in 3D.",
            "ghost": "Find where light reflected twice in the lens goes.",
        },
        "Exchange and make": {
            "import": "Convert the lens file of another program.",
            "figure": "Convert an interferogram to the figure of a surface.",
            "export": "Write a mesh, solids, an outline or another program's file.",
            "scene": "Write lens, sensor planes and rays as a 3D scene.",
            "drawing": "Draw the sheet for the workshop (ISO 10110).",
            "sag": "Tabulate the sag of a surface for the workshop.",
            "verify": "Compare a mesh with the nominal lens.",
        },
    },
)


class PictureFormat(StrEnum):
    """Formats that pictures can have."""

    PNG = "png"
    SVG = "svg"


class CoatingOfAll(StrEnum):
    """Coatings with a name, see :data:`lensdesign.lens.coatings.coating.CoatingName`."""

    IDEAL = "ideal"
    BARE = "bare"
    MGF2 = "mgf2"


def main() -> None:
    """Entry point of the console script."""
    run_app(app)


@app.command()
def check(
    design: Design,
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="SPEC",
            help="Check the constraints of this specification instead.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = None,
    moulding: Annotated[
        bool,
        typer.Option(
            "--moulding/--no-moulding", help="Check moulded elements.", rich_help_panel=OptionGroup.INPUT
        ),
    ] = True,
    coating: Annotated[
        CoatingOfAll | None,
        typer.Option(
            help="Coating of all surfaces; default: the design's.", rich_help_panel=OptionGroup.LENS
        ),
    ] = None,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Check matching, spread, footprint and edges, or a specification's constraints.

    The check covers the match of the object's and the sensor's space-bandwidth products (Eq. 1 of the paper),
    the largest angle of the rays behind the lens that the pixels can still sample (spread, Eq. 2), the
    footprint on the sensor, the numerical aperture, throughput and the edge thickness. A specification
    (--against) replaces these constraints with its own, for its field, aperture, wavelengths and sensor.

    The oversampling ratio extends Eq. 1 to recordings: measurements on the pixels of a plane for each real
    unknown of an object that fills the field (one for an amplitude or phase object, two for a complex one,
    times its space-bandwidth product). A plane has at most four, two for a complex object, since the
    intensity has four times the degrees of freedom of the light. In theory 1 suffices for typical objects and
    2 for every object; noise and the solver need more. It is printed for each plane and for all planes.

    Elements of plastic, and others that the design's [moulding] selects, are also checked for moulding:
    draft, gate, thicknesses, slopes and sags. A check without a stated value or a limit stays open. The
    limits that the design states are binding; published ones are guidelines.

    The check prints the transmittance of the coatings, for unpolarized light, and how they change its
    amplitude and polarization over the stop: largest diattenuation and retardance of a ray, and root mean
    square amplitude of the crossed polarization.

    Surfaces with a roughness scatter light. The check prints its fraction, its angles and its halo.

    Example: lensdesign check lens.toml

    Exit status: 0 if every constraint and every binding limit of moulding is met, 1 if not, 2 for bad input.
    """
    from lensdesign.files.design import load_design

    lens = load_design(design)
    if coating is not None:
        lens = lens.with_coating(coating.value)
    if against is None:
        from lensdesign.analysis.check import check_design

        report = check_design(lens)
    else:
        from lensdesign.optimization.specification.specification import load_specification
        from lensdesign.optimization.specification_check import check_against

        report = check_against(lens, load_specification(against))
    if not moulding:
        report = replace(report, moulding=())
    if as_json:
        print_json(report.as_dict())
    else:
        _print_check(report)
    raise typer.Exit(0 if report.feasible and report.mouldable else 1)


@app.command()
def draw(
    design: Design,
    output: Annotated[Path, output_option("Folder for the pictures.", "DIR", is_folder=True)],
    formats: Annotated[
        list[PictureFormat],
        typer.Option(
            "--format", help="Picture format; may be given twice.", rich_help_panel=OptionGroup.OUTPUT
        ),
    ] = [PictureFormat.PNG],  # noqa: B006
    as_json: Json = False,
) -> None:
    """Draw the layout, spots, arrival angles, spread, measured figures and the lens in 3D.

    The 3D view is omitted, with a note, if off-screen rendering is not available.
    """
    from lensdesign.files.design import load_design
    from lensdesign.plots.plots import draw_all

    lens, chosen = load_design(design), tuple(f.value for f in formats)
    _report_files(draw_all(lens, output, chosen, warn=lambda note: typer.echo(note, err=True)), as_json)


app.command()(cli_compare.compare)
app.command()(cli_search.optimize)
app.command()(cli_search.explore)
app.command()(cli_search.limits)
app.command()(cli_stock.stock)
app.command("import")(cli_manufacture.import_file)
app.command()(cli_figure.figure)
app.command()(cli_manufacture.export)
app.command()(cli_manufacture.scene)
app.command()(cli_manufacture.drawing)
app.command()(cli_manufacture.sag)
app.command()(cli_ghost.ghost)
app.command()(cli_view.view)
app.command()(cli_workbench.studio)
app.command()(cli_verify.verify)
app.command("testplates")(cli_testplates.fit)


@app.command()
def scale(
    design: Design,
    factor: Annotated[
        float,
        typer.Argument(metavar="FACTOR", help="Factor by which all lengths are multiplied, such as 0.125."),
    ],
    output: Annotated[Path, output_option("Design file to write.", "TWIN")],
    study: Annotated[
        Path | None,
        typer.Option(
            metavar="STUDY",
            help="Tolerance study whose tolerances are scaled, too; written beside small.toml as "
            "small_tolerances.toml.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write the same lens at another size.

    Numerical aperture, spread angle, glass and pixel pitch do not change. For a small twin, wave optics of
    the whole field takes seconds. Of the tolerances of a study, lengths scale and angles do not.

    Example: lensdesign scale lens.toml 0.125 --study study.toml -o small.toml
    """
    from lensdesign.files.design import load_design, save_design
    from lensdesign.lens.scaling import scaled

    if os.path.exists(output) and output.samefile(design):
        raise InputError(f"cannot write {output}: it is the design itself; give another file name")
    lens = load_design(design)
    twin = scaled(lens, factor)
    twin = twin.replaced(title=f"{twin.title}, scaled by {factor:g}".lstrip(", "))
    written: dict[str, str] = {}
    if study is not None:
        from lensdesign.optimization.as_built import as_built_by

        built = as_built_by(str(study), lens)
        written["study"] = str(built.write_scaled(factor, twin, output))
    save_design(twin, output)
    if as_json:
        print_json({"design": str(output), "factor": factor, "title": twin.title} | written)
    else:
        for path in written.values():
            typer.echo(f"wrote {path}")
        columns, rows = twin.sensor.pixels
        typer.echo(
            f"wrote {output}: field {twin.object.field_diameter_mm:g} mm, stop "
            f"{2.0 * twin.stop_semi_diameter_mm:g} mm, sensor {columns} x {rows} pixels"
        )


@app.command()
def glass(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Glass, plastic or crystal; or an index.")],
    wavelength_um: Annotated[
        float, typer.Option(help="Wavelength of the index.", rich_help_panel=OptionGroup.ILLUMINATION)
    ] = 0.532,
    catalog: Annotated[
        list[Path],
        typer.Option(
            "--glass-catalog",
            "--catalog",
            help="Glass catalogue (AGF) that is searched first; may be repeated.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = [],  # noqa: B006
    search: Annotated[
        bool,
        typer.Option("--search", help="List the names that contain NAME.", rich_help_panel=OptionGroup.INPUT),
    ] = False,
    as_json: Json = False,
) -> None:
    """Show a glass (index, Abbe number, range), or search."""
    if search:
        _print_matches(name, catalog, as_json)
        return
    from lensdesign.lens.glass import get_material, glass_summary

    material = _name_or_index(name)
    found = get_material(material, catalog)
    index = found.index(wavelength_um)
    figures = glass_summary(material, catalog) | {"wavelength_um": wavelength_um, "index": index}
    if as_json:
        print_json(figures | {"notes": list(found.notes)})
        return
    span = figures["wavelength_range_um"]
    typer.echo(visible(f"{figures['name']} ({figures['catalog']})"))
    typer.echo(f"  index at {wavelength_um:g} µm   {index:.7f}")
    typer.echo(f"  nd                   {_or_unknown(figures['nd'], '.7f')}")
    typer.echo(f"  Vd                   {_or_unknown(figures['vd'], '.3f')}")
    typer.echo(f"  wavelengths          {f'{span[0]:g} to {span[1]:g} µm' if span else 'any'}")
    if figures["source"]:
        typer.echo(visible(f"  source               {figures['source']}"))
    for note in found.notes:
        typer.echo(visible(f"note: {note}"), err=True)


def _name_or_index(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


def _or_unknown(value: float | None, form: str) -> str:
    return "not known" if value is None else format(value, form)


def _print_matches(name: str, catalogs: list[Path], as_json: bool) -> None:
    from lensdesign.lens.glass import list_glasses

    found = [(n, c) for n, c in list_glasses(catalogs) if name.casefold() in n.casefold()]
    if as_json:
        print_json({"matches": [{"name": n, "catalog": c} for n, c in found]})
        return
    for n, c in found:
        typer.echo(visible(f"{n} ({c})"))
    typer.echo(f"{len(found)} names contain {name!r}")


def _report_files(files: list[Path], as_json: bool) -> None:
    if as_json:
        print_json({"files": [str(f) for f in files]})
        return
    for file in files:
        typer.echo(f"wrote {file}")


def _print_check(report: CheckReport) -> None:
    constraints = table(report.title, "constraint", "value", "limit", "")
    for c in report.constraints:
        constraints.add_row(
            c.name,
            quantity_text(c.value, c.unit),
            f"{relation_symbol(c.relation)} {quantity_text(c.limit, c.unit)}",
            _met(c.met),
        )
    figures = table("", "figure", "value")
    heights = ", ".join(f"{h:g}" for h in report.spot_heights_mm)
    spots = ", ".join(f"{d:.2f}" for d in report.rms_spot_diameter_mm)
    rows = [
        ("resolution", f"{report.resolution_um:.4g} µm"),
        ("highest frequency of the sensor", f"{report.highest_frequency_lp_per_mm:.5g} lp/mm"),
        ("effective, back focal length", f"{report.efl_mm:.4f}, {report.bfl_mm:.4f} mm"),
        (f"RMS spot diameter {report.spot_plane_mm:g} mm behind, at {heights} mm", f"{spots} mm"),
        ("exit beam diameter", f"{report.exit_beam_diameter_mm:.3f} mm"),
        ("narrowest beam that the etendue bound allows", f"{report.smallest_exit_beam_diameter_mm:.3f} mm"),
        ("fraction of the beam's etendue that the lens fills", f"{100.0 * report.etendue_share:.1f} %"),
    ]
    rows += [(f"oversampling ratio, {name}", ratios) for name, ratios in report.oversampling_texts()]
    if (edge := report.drawn_edge) is not None:
        label = f"edge at the drawn ground diameter, {edge.drawn_diameter_mm:g} mm"
        rows.append((label, f"{edge.drawn_thickness_mm:.3f} mm"))
    for row in rows:
        figures.add_row(*row)
    tables = [constraints, *([_moulding_table(report)] if report.moulding else []), figures]
    if (light := report.darkest) is not None and not light.is_ideal:
        tables += [_coating_table(light), _light_table(light)]
    if report.roughness is not None:
        tables.append(_scatter_table(report.roughness))
    print_tables(*tables)
    for source, number in _moulding_sources(report).items():
        typer.echo(f"source {number}: {source}")
    for element, key in dict.fromkeys((m.element, m.limit_key) for m in report.moulding if m.limit is None):
        typer.echo(
            f"element {element}: no published limit is known for its material: set {key} in [moulding]"
        )
    if edge is not None and not edge.fits:
        typer.echo(
            f"not drawable with general tolerances: {edge.element}: bevels and thickness tolerance take "
            f"{edge.needed_mm:.4g} mm of its edge"
        )
    if light is not None and light.is_ideal:
        typer.echo(
            "ideal coatings: all light is transmitted; uncoated surfaces would transmit "
            f"{100.0 * light.centre.uncoated_transmittance:.1f} % (--coating bare)"
        )
    for f in report.figures:
        typer.echo(
            f"surface {f.surface} as measured: PV {f.pv_waves:.3f}, RMS {f.rms_waves:.3f} waves at "
            f"{1e3 * f.wavelength_um:.1f} nm without tilt; PV {f.pv_without_power_waves:.3f}, "
            f"RMS {f.rms_without_power_waves:.3f} without power"
        )
    if report.roughness is not None:
        typer.echo(
            "in one lens, the scattered light interferes with the direct light: a pattern of "
            f"{100.0 * report.roughness.interference_rms:.2g} % rms of the intensity in the pixels"
        )
        for note in report.roughness.notes:
            say("warning:", note)
    if report.feasible and report.mouldable:
        typer.echo("every constraint is met")
    for sentence in report.violations:
        say("not met:", sentence)
    for m in report.moulding:
        if m.met is False:
            say("beyond a guideline:" if m.is_guideline else "not met:", m.miss)


def _percent(fraction: float) -> str:
    return f"{100.0 * fraction:.2f} %"


def _coating_table(report: CoatingReport) -> Table:
    found = table(
        f"Coatings at {report.wavelength_um:g} µm", "surface", "coating", "transmits", "at the largest angle"
    )
    for one in report.surfaces:
        found.add_row(
            str(one.surface),
            visible(one.coating),
            _percent(one.transmittance),
            f"{_percent(one.transmittance_at_largest)} at {one.largest_incidence_deg:.1f}°",
        )
    return found


def _light_table(report: CoatingReport) -> Table:
    found = table(
        f"Light behind the lens at {report.wavelength_um:g} µm",
        "field",
        "transmittance",
        "apodization",
        "diattenuation",
        "retardance",
        "crossed",
    )
    for name, point in (("centre", report.centre), ("edge", report.edge)):
        found.add_row(
            name,
            _percent(point.transmittance),
            f"{_percent(point.apodization_rms)} rms",
            _percent(point.largest_diattenuation),
            f"{point.largest_retardance_deg:.2f}°",
            f"{_percent(point.crossed_rms)} rms",
        )
    return found


def _scatter_table(report: RoughnessReport) -> Table:
    planes = ", ".join(f"{z:g}" for z in report.plane_distances_mm)
    found = table(
        f"Scattered light at {report.wavelength_um:g} µm",
        "surface",
        "roughness",
        "mean, largest",
        "half-width",
        f"halo at {planes} mm",
    )

    def percent(mean: float, largest: float) -> str:
        return f"{100.0 * mean:.3g}, {100.0 * largest:.3g} %"

    def halo(radii_mm: Sequence[float]) -> str:
        return ", ".join(f"{radius:.3g}" for radius in radii_mm) + " mm"

    for one in report.surfaces:
        found.add_row(
            str(one.surface),
            f"{one.rms_nm:g} nm rms, {one.correlation_length_um:g} µm",
            percent(one.mean_fraction, one.largest_fraction),
            f"{one.half_width_deg:.3g}°",
            halo(one.halo_radius_mm),
        )
    centre, *edge = zip(report.mean_fractions, report.largest_fractions, strict=True)
    width, radii = f"{report.half_width_deg:.3g}°", halo(report.halo_radius_mm)
    found.add_row("all, centre", "", percent(*centre), width, radii)
    found.add_row("all, edge", "", percent(*(max(values) for values in zip(*edge, strict=True))), "", "")
    return found


def _moulding_sources(report: CheckReport) -> dict[str, int]:
    """Return the sources of the moulding limits with their numbers from 1."""
    sources = dict.fromkeys(m.source_text for m in report.moulding if m.source)
    return {source: number for number, source in enumerate(sources, start=1)}


def _moulding_table(report: CheckReport) -> Table:
    several = len({m.element for m in report.moulding}) > 1
    numbers = _moulding_sources(report)
    found = table("Moulding", "check", "value", "limit", "", "source")
    for m in report.moulding:
        found.add_row(
            f"{f'element {m.element}: ' if several else ''}{m.name}",
            "not stated" if m.value is None else quantity_text(m.value, m.unit),
            "" if m.limit is None else f"{relation_symbol(m.relation)} {quantity_text(m.limit, m.unit)}",
            _moulding_result(m),
            str(numbers[m.source_text]) if m.source else "",
        )
    return found


def _moulding_result(check: MouldingCheck) -> str:
    if check.met is None:
        return "open"
    return _met(check.met) if check.met or not check.is_guideline else "[yellow]beyond[/yellow]"


def _met(met: bool) -> str:
    return "[green]met[/green]" if met else "[red]not met[/red]"
