"""Command that shows a lens in 3D."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lensdesign.cli.manufacture import outline_of, print_outline
from lensdesign.common.console import print_json
from lensdesign.common.options import Design, Json, output_option


def view(
    design: Design,
    output: Annotated[
        Path | None, output_option("Page for a browser to write, .html; default: open a window.", "FILE")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show the lens in 3D: in a window, or on a self-contained page for a browser."""
    from lensdesign.errors import InputError
    from lensdesign.files.design import load_design
    from lensdesign.lens.solid import closed_elements
    from lensdesign.plots.page import write_view
    from lensdesign.plots.window import open_window
    from lensdesign.raytrace.paths import sized_lens

    lens = load_design(design)
    if output is None:
        closed_elements(sized_lens(lens))
        open_window(design)
        if as_json:
            print_json({"file": None})
        return
    if output.exists() and output.samefile(design):
        raise InputError(f"cannot write {output}: it is the design itself; give another file name")
    page = write_view(lens, output)
    outline = outline_of(lens)
    if as_json:
        print_json({"file": str(output)} | page.as_dict() | {"outline": list(outline)})
    else:
        print_outline(outline)
        typer.echo(
            f"wrote {output}: {page.bodies} {'body' if page.bodies == 1 else 'bodies'}, {page.rays} rays, "
            f"{1e-6 * page.bytes:.2g} MB"
        )
