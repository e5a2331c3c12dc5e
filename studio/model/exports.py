"""Files that are made of a lens from the page."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from lensdesign.common.outputs import check_output_file, check_output_folder
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from studio.model.built import ManufacturingQuality

KINDS = {
    "mesh for printing (.stl)": ".stl",
    "mesh with colours (.glb)": ".glb",
    "exact solid (.step)": ".step",
    "drawing for the shop (.pdf)": ".pdf",
    "drawing for the shop (.svg)": ".svg",
    "Zemax (.zmx)": ".zmx",
    "CODE V (.seq)": ".seq",
    "lens to turn in a browser (.html)": ".html",
    "tolerance report (folder)": "",
}
"""What can be made, by its name on the page, and the suffix of its file."""

MESH_ERROR_UM = 0.1
"""As of `lensdesign export`."""

REPORT_TRIALS = 400


def write_export(
    lens: Lens, path: Path, made: ManufacturingQuality | None, replace: bool, report: Callable[[str], None]
) -> str:
    """Write one file, and say in a sentence what it is.

    Parameters
    ----------
    lens
        The lens.
    path
        Its suffix says what is written; without one, a folder for a tolerance report.
    made
        Tolerances of the report.
    replace
        Whether what stands there may be replaced.
    report
        Called with notes.

    Raises
    ------
    InputError
        If the lens cannot be written so, or something stands there.
    """
    if path.exists() and not replace:
        raise InputError(f"{path}: exists already; tick replace, or give another name")
    (check_output_file if path.suffix else check_output_folder)(path)
    report(f"writing {path}")
    if path.suffix in (".pdf", ".svg"):
        from lensdesign.manufacture.drawing.sheets import drawing_as_stated, write_drawing

        drawing, stated = drawing_as_stated(lens)
        write_drawing(drawing, path)
        for note in stated.notes:
            report(note)
        return f"wrote {path}: {len(drawing.sheets)} sheets"
    if path.suffix == ".html":
        from lensdesign.plots.page import write_view

        view = write_view(lens, path)
        return f"wrote {path}: {view.bodies} bodies, {view.rays} rays"
    if path.suffix:
        from lensdesign.manufacture.exports import ExportOptions, export_lens

        made_file = export_lens(lens, path, ExportOptions(MESH_ERROR_UM, False, report))
        for statement in made_file.outline:
            report(f"outline: {statement}")
        return f"wrote {path}: {made_file.sentence}"
    return _write_report(lens, path, made, report)


def _write_report(
    lens: Lens, folder: Path, made: ManufacturingQuality | None, report: Callable[[str], None]
) -> str:
    """Run a short study and write its report."""
    from studio.model.studies import run_trials
    from tolerancing.report.report import write_report
    from tolerancing.store.store import open_store

    if made is None:
        raise InputError("a report needs tolerances: choose a grade")
    with tempfile.TemporaryDirectory() as name:
        run_trials(lens, made, REPORT_TRIALS, Path(name), report)
        with open_store(Path(name) / "study.db") as store:
            write_report(store, folder)
    return f"wrote {folder}/report.html, report.pdf, trials.csv and steps.csv"
