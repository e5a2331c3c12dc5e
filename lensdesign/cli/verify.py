"""Command that verifies a mesh file against a design."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.common.console import print_json, say
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Design, Json

if TYPE_CHECKING:
    from lensdesign.manufacture.mesh.verification import MeshReport


def verify(
    design: Design,
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="Mesh in mm: .stl, .ply, .obj or .3mf.")],
    chord_error_um: Annotated[
        float,
        typer.Option(
            help="Largest allowed distance of the mesh from the optical surfaces.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = 0.1,
    as_json: Json = False,
) -> None:
    """Verify a mesh of any origin against the nominal shape of a lens.

    The report states whether the mesh is closed, and how far its vertices, edge midpoints and facet centres
    are from each optical surface. The mesh must have its front vertex at z = 0 and its axis along z. The
    bodies of the design have the outline of its drawing, as in exports.

    Exit status: 0 if the mesh agrees, 1 if it is open, inside out, too inaccurate or has another number of
    bodies than the design, 2 for bad input.
    """
    from lensdesign.analysis.outline import drawn_outline
    from lensdesign.files.design import load_design
    from lensdesign.manufacture.mesh.reading import read_mesh
    from lensdesign.manufacture.mesh.verification import verify_mesh

    outline = drawn_outline(load_design(design))
    report = verify_mesh(outline.lens, read_mesh(mesh), chord_error_um)
    if as_json:
        print_json({"file": str(mesh)} | report.as_dict() | {"outline": list(outline.statements)})
    else:
        for statement in outline.statements:
            typer.echo(f"outline of the design: {statement}")
        _print_report(report)
    raise typer.Exit(1 if report.faults else 0)


def _print_report(report: MeshReport) -> None:
    closed = "closed" if report.closed else f"open at {report.open_edges} edges"
    bodies = f"{report.bodies} {'body' if report.bodies == 1 else 'bodies'}"
    typer.echo(f"{report.triangles} triangles, {closed}, {bodies} (design: {report.elements})")
    relative = report.volume_mm3 / report.exact_volume_mm3 - 1.0
    typer.echo(
        f"volume {report.volume_mm3:.8g} mm³; of the design {report.exact_volume_mm3:.8g} mm³; "
        f"{relative:+.2g}"
    )
    for side in report.distances:
        name = f"surface {side.surface} of element {side.element}"
        if side.greatest_um is not None:
            typer.echo(
                f"{name}: at most {side.greatest_um:.4g} µm off, RMS {side.rms_um:.4g} µm, "
                f"{side.points} points"
            )
    if report.edge_greatest_um is not None:
        typer.echo(f"edge: at most {report.edge_greatest_um:.4g} µm off (not part of the verification)")
    for fault in report.faults:
        say("not met:", fault)
    if not report.faults:
        typer.echo(f"the mesh agrees with the design within {report.chord_error_um:g} µm")
