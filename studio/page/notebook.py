"""View of the workbench in a notebook."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench

if TYPE_CHECKING:
    import panel as pn


def studio(lens: Workbench | Lens | str | Path, grade: str = "precision") -> pn.Row:
    """Return the workbench of a lens as one object that a notebook displays, with the panes of the page.

    Parameters
    ----------
    lens
        A lens, a design file, or a workbench (which may have several views).
    grade
        Tolerances for the prediction as built: a grade (default: precision), or a tolerance study's file.

    Raises
    ------
    InputError
        If the file does not describe a lens.
    """
    import panel as pn

    from studio.page.frame import notebook_view

    pn.extension(inline=True)
    bench = lens if isinstance(lens, Workbench) else Workbench(lens, grade)
    bench.request_update()
    return notebook_view(bench)
