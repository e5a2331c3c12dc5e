"""Arguments and options that the commands of all packages share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lensdesign.common.consent import trust_user_code
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


def _trust(context: typer.Context, trust: bool) -> bool:
    """Allow Python code of studies to be executed until the command ends."""
    context.with_resource(trust_user_code(trust))
    return trust


Trust = Annotated[
    bool,
    typer.Option(
        "--trust",
        callback=_trust,
        help="Execute the Python code of the study's merits; only for files from people you trust.",
        rich_help_panel=OptionGroup.INPUT,
    ),
]
"""Consent to execute Python code. It holds for the whole command, which need not pass the value on."""


def output_option(text: str, metavar: str | None = None, is_folder: bool = False) -> Any:
    """Return the option `--output` with its help text; the path is checked before the command computes."""
    check = output_folder if is_folder else output_file
    metavar = metavar or ("DIR" if is_folder else "FILE")
    return typer.Option(
        "--output", "-o", callback=check, metavar=metavar, help=text, rich_help_panel=OptionGroup.OUTPUT
    )
