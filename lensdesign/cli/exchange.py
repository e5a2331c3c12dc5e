"""Commands to and from other programs' lens files."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.cli.making import Json
from lensdesign.common.console import print_json
from lensdesign.common.text import visible
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from lensdesign.files.draft import Imported
    from lensdesign.lens.poses import Pose

FORMATS = (".zmx", ".seq")


def import_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Zemax .zmx or CODE V .seq.")],
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
    from lensdesign.files.codev import read_seq
    from lensdesign.files.design import save_design
    from lensdesign.files.draft import LossyImportError, Supplement
    from lensdesign.files.zemax import read_zmx

    readers = {".zmx": read_zmx, ".seq": read_seq}
    reader = readers.get(file.suffix.lower())
    if reader is None:
        raise InputError(f"cannot read {file}: the name must end in {' or '.join(readers)}")
    supplement = Supplement(
        working_distance_mm=working_distance_mm,
        field_diameter_mm=field_diameter_mm,
        numerical_aperture=numerical_aperture,
        pixel_pitch_um=pixel_pitch_um,
        pixels=pixels,
        plane_distances_mm=tuple(plane_distance_mm) if plane_distance_mm else None,
        glass_catalogs=tuple(glass_catalog or ()),
    )
    found = reader(file, supplement, lossy)
    moved = _moved(found.pose)
    if moved and not lossy:
        raise LossyImportError(str(file), [f"the lens stands at {moved}: a design stands on its axis"])
    save_design(found.lens, output)
    _tell(found, output, moved, as_json)


def write_exchange(design: Path, file: Path, as_json: bool) -> None:
    """Write a design as another program's file, by the file's suffix."""
    from lensdesign.files.codev import write_seq
    from lensdesign.files.design import load_design
    from lensdesign.files.zemax import write_zmx

    lens = load_design(design)
    {".zmx": write_zmx, ".seq": write_seq}[file.suffix.lower()](lens, file)
    if as_json:
        print_json({"file": str(file), "surfaces": len(lens.surfaces)})
    else:
        typer.echo(f"wrote {file}: {len(lens.surfaces)} surfaces")


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
