"""Export of a lens from the page."""

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
    "outline in section (.dxf)": ".dxf",
    "drawing for the shop (.pdf)": ".pdf",
    "drawing for the shop (.svg)": ".svg",
    "Zemax (.zmx)": ".zmx",
    "CODE V (.seq)": ".seq",
    "lens to turn in a browser (.html)": ".html",
    "tolerance report (folder)": "",
}
"""Kinds of exports by their names on the page, with the suffixes of their files."""


def write_export(
    lens: Lens, path: Path, quality: ManufacturingQuality | None, replace: bool, report: Callable[[str], None]
) -> str:
    """Write one file or report, and return a sentence on its contents.

    Parameters
    ----------
    lens
        The lens.
    path
        File to write; its suffix selects the format. Without a suffix: folder of a tolerance report.
    quality
        Tolerances of the report.
    replace
        Whether an existing file may be replaced.
    report
        Called with lines on progress and notes.

    Raises
    ------
    InputError
        If the format cannot represent the lens, or the file exists and may not be replaced.
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

        # Chord error of meshes, as in `lensdesign export`.
        mesh_error_um = 0.1
        exported = export_lens(lens, path, ExportOptions(mesh_error_um, False, report))
        for statement in exported.outline:
            report(f"outline: {statement}")
        return f"wrote {path}: {exported.sentence}"
    return _write_report(lens, path, quality, report)


def _write_report(
    lens: Lens, folder: Path, quality: ManufacturingQuality | None, report: Callable[[str], None]
) -> str:
    """Run a short study and write its report."""
    from studio.model.studies import run_trials
    from tolerancing.report.report import write_report
    from tolerancing.store.store import open_store

    if quality is None:
        raise InputError("a tolerance report needs tolerances: choose a grade")
    with tempfile.TemporaryDirectory() as name:
        report_trials = 400
        run_trials(lens, quality, report_trials, Path(name), report)
        with open_store(Path(name) / "study.db") as store:
            write_report(store, folder)
    return f"wrote {folder}/report.html, report.pdf, trials.csv and steps.csv"
