"""Command that compares designs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.cli.tables import print_columns
from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import GRADES, Json, Trust
from lensdesign.common.text import finite_or_none
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from lensdesign.analysis.comparison import ComparedValue
    from lensdesign.analysis.report import CheckReport
    from lensdesign.lens.lens import Lens


def compare(
    designs: Annotated[
        list[Path], typer.Argument(metavar="DESIGNS...", help="Design files (TOML), two or more.")
    ],
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="SPEC",
            help="Compare the constraints of this specification instead.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = None,
    tolerances: Annotated[
        str | None,
        typer.Option(
            metavar=f"{GRADES}|STUDY",
            help="Also predict yield and relative cost of each lens as built, with this grade or study.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = None,
    surfaces: Annotated[
        bool,
        typer.Option(
            "--surfaces",
            help="Also list the values of the surfaces that differ.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = False,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Compare designs side by side: lengths, volume, space-bandwidth product, spread and constraints.

    The constraints are those of `lensdesign check`, each marked if it is not met. With --tolerances, the
    yield is that of `tolerancing predict`, without trials; a grade has the limits of `tolerancing start`. The
    cost is that of `tolerancing cost`: each tolerance and each element, relative to usual ones.

    Example: lensdesign compare a.toml b.toml c.toml --tolerances precision

    Exit status: 0, also if a lens does not meet its constraints; 2 for bad input.
    """
    from lensdesign.analysis.check import check_design
    from lensdesign.analysis.comparison import compare_designs
    from lensdesign.files.design import load_design

    if len(designs) < 2:
        raise InputError(f"{designs[0]}: only one design; give two or more to compare")
    lenses = [load_design(path) for path in designs]
    check: Callable[[Lens], CheckReport] = check_design
    if against is not None:
        from lensdesign.optimization.specification.specification import load_specification
        from lensdesign.optimization.specification_check import check_against

        specification = load_specification(against)
        check = partial(check_against, specification=specification)

    found = compare_designs(lenses, check)
    built = None if tolerances is None else [_as_built(lens, tolerances) for lens in lenses]
    names = _short_names(designs)
    if as_json:
        print_json({"designs": _as_dicts(designs, found, built)})
        return
    rows = [_row(one) for one in found if not one.is_of_surface or (surfaces and one.differs)]
    if built is not None:
        yields = [
            "not predicted  " if one["yield"] is None else f"{100.0 * one['yield']:.1f}  " for one in built
        ]
        costs = ["-  " if one["cost"] is None else f"{one['cost']:.4g}  " for one in built]
        rows += [("predicted yield as built, %", *yields), ("relative cost", *costs)]
    print_columns("", names, rows)
    typer.echo("* constraint not met")


def _row(one: ComparedValue) -> tuple[str, ...]:
    pairs = zip(one.values, one.met, strict=True)
    return one.name, *(f"{value} *" if met is False else f"{value}  " for value, met in pairs)


def _as_built(lens: Lens, tolerances: str) -> dict[str, Any]:
    """Return predicted yield and relative cost of a lens."""
    from lensdesign.optimization.as_built import as_built_by

    study = as_built_by(tolerances, lens)
    prediction = study.predict(lens)
    try:
        cost: float | None = study.cost(lens)
    except InputError:  # the table has no price for one of the tolerances
        cost = None
    return {"yield": finite_or_none(prediction.good), "limits": prediction.merits, "cost": cost}


def _short_names(designs: Sequence[Path]) -> list[str]:
    """Return the names of files, with their folders where names are the same."""
    names = [path.stem for path in designs]
    if len(set(names)) == len(names):
        return names
    return [f"{path.resolve().parent.name}/{path.stem}" for path in designs]


def _as_dicts(
    designs: Sequence[Path], found: Sequence[ComparedValue], built: Sequence[dict[str, Any]] | None
) -> list[dict[str, Any]]:
    """Return all values of each design for JSON."""
    shown = []
    for k, path in enumerate(designs):
        constraints = {one.name: one.met[k] for one in found if one.met[k] is not None}
        values = {one.name: _number(one.values[k]) for one in found if one.values[k]}
        own: dict[str, Any] = {"design": str(path), "values": values, "met": constraints}
        if built is not None:
            own["as_built"] = built[k]
        shown.append(own)
    return shown


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
