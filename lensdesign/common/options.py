"""Arguments and options that the commands of all packages share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.outputs import output_file, output_folder

Design = Annotated[Path, typer.Argument(metavar="DESIGN", help="Design file (TOML).", show_default=False)]
SpecificationFile = Annotated[
    Path,
    typer.Argument(
        metavar="SPEC", help="Specification (TOML): a design with goal, constraints and variables."
    ),
]
StudyFile = Annotated[
    Path, typer.Argument(metavar="STUDY", help="Study (TOML), as `tolerancing start` writes it.")
]
GRADES = "[commercial|precision|high_precision|moulded_glass|moulded_plastic|iso10110]"
"""Grades of tolerances, as the help shows them."""

Json = Annotated[
    bool,
    typer.Option("--json", help="Print one JSON object instead of text.", rich_help_panel=OptionGroup.OUTPUT),
]


def output_option(text: str, metavar: str | None = None, is_folder: bool = False) -> Any:
    """Return the option `--output` with its help text; the path is checked before the command computes."""
    check = output_folder if is_folder else output_file
    metavar = metavar or ("DIR" if is_folder else "FILE")
    return typer.Option(
        "--output", "-o", callback=check, metavar=metavar, help=text, rich_help_panel=OptionGroup.OUTPUT
    )
