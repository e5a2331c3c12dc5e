"""Command that opens the workbench, which a package above this one provides."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import GRADES, Design
from lensdesign.errors import InputError


def studio(
    design: Design,
    port: Annotated[
        int,
        typer.Option(
            min=0,
            max=65535,
            help="Port; 0 uses that of the last session, or a free one.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = 0,
    tolerances: Annotated[
        str,
        typer.Option(
            metavar=f"{GRADES}|STUDY",
            help="Grade or study file with manufacturing tolerances.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = "precision",
    show: Annotated[
        bool,
        typer.Option(
            "--open/--no-open", help="Whether to open the browser.", rich_help_panel=OptionGroup.OUTPUT
        ),
    ] = True,
) -> None:
    """Open the workbench: change the lens in the browser and see the effect at once.

    The server is reachable from this machine only, at an address with a secret token, until it is stopped
    (Ctrl+C). The design file changes only when it is saved; unsaved edits are kept for the next session.
    """
    from importlib.metadata import entry_points
    from importlib.util import find_spec

    found = tuple(entry_points(group="lensdesign.workbench", name="serve"))
    if not found or find_spec("panel") is None:
        raise InputError("lensdesign studio needs an extra: pip install 'transferlens[studio]'")
    found[0].load()(Path(design), port, tolerances, show=show)
