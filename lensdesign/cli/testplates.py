"""Command that fits a lens to test plates."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.console import print_json, say
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Json, SpecificationFile, Trust, output_option
from lensdesign.common.progress import progress_text
from lensdesign.common.text import number_with_unit
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from lensdesign.optimization.testplates import PlateFit


def fit(
    specification: SpecificationFile,
    plates: Annotated[
        Path,
        typer.Option(
            help="Radii in mm: TOML with radii_mm = [...], or one a line.", rich_help_panel=OptionGroup.INPUT
        ),
    ],
    output: Annotated[Path, output_option("Design file to write.", "DESIGN")],
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Optimize a lens whose spheres have the radii of test plates.

    Spheres are fitted one by one, starting with the one that changes least; the other variables are optimized
    again each time. Conics and aspheres have no test plates.

    Exit status: 0 if the lens meets every constraint, 1 if not, or if a limit ended a search (the lens is
    written nevertheless), 2 for bad input.
    """
    from lensdesign.files.design import design_text
    from lensdesign.optimization.specification.specification import load_specification
    from lensdesign.optimization.testplates import fit_plates, load_plates

    asked, radii = load_specification(specification), load_plates(plates)
    if os.path.exists(output) and any(output.samefile(given) for given in (specification, plates)):
        raise InputError(f"cannot write {output}: it is an input of this command; give another file name")
    with atomic_path(output) as temporary:
        with progress_text("searching") as status:
            found = fit_plates(asked, radii, report=status.update)
        temporary.write_text(design_text(found.lens, output.parent), encoding="utf-8")
    if as_json:
        print_json(found.as_dict() | {"design": str(output)})
    else:
        _print_fit(found)
        typer.echo(f"wrote {output}")
    raise typer.Exit(0 if found.check.feasible and not found.unfinished else 1)


def _print_fit(found: PlateFit) -> None:
    for one in found.fitted:
        typer.echo(f"surface {one.surface}: {one.radius_mm:.6g} mm, plate {one.plate_mm:.6g} mm")
    before = found.before
    last = (
        "no variable remained"
        if found.after is None
        else number_with_unit(f"{found.after.goal_value:.6g}", before.goal_unit)
    )
    first = number_with_unit(f"{before.goal_value:.6g}", before.goal_unit)
    typer.echo(f"{before.goal}: {first} before, {last} with the plates")
    for violation in found.check.violations:
        say("not met:", violation)
    for sentence in found.unfinished:
        typer.echo(f"not finished: {sentence}")
