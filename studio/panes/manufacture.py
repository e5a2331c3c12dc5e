"""Pane for exports of the lens for manufacture, viewers and other programs."""

from __future__ import annotations

import panel as pn

from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.built import manufacturing_quality
from studio.model.exports import KINDS, write_export
from studio.model.files import typed_path
from studio.model.jobs import Job
from studio.panes.common import bench_of, explanation, follow, message, message_pane, text
from studio.panes.files import FileChoice


def export(lens: Workbench | Lens) -> pn.Column:
    """Return a pane that writes the lens as mesh, solid, drawing, lens file or report, in a child process."""
    bench = bench_of(lens)
    jobs = bench.session.exports
    kind = pn.widgets.Select(name="what", options=list(KINDS), width=260)
    file = FileChoice("exports", label="file", value=_name(bench, kind.value), mode="save", width=420)
    replace = pn.widgets.CheckBoxGroup(options=["replace an existing file"], value=[], align="end")
    write = pn.widgets.Button(name="Write", button_type="primary", align="end")
    note = message_pane()
    form = pn.FlexBox(kind, file, replace, write, sizing_mode="stretch_width", margin=(6, 6, 0, 6))
    pane = pn.Column(form, note, sizing_mode="stretch_width", margin=0)
    kind.param.watch(lambda event: setattr(file, "value", _name(bench, event.new)), "value")

    def start(_: object) -> None:
        try:
            path = typed_path(file.value)
            quality = None if path.suffix else manufacturing_quality(bench.grade, bench.lens)
        except TransferLensError as error:
            note.object = message(text(error), is_bad=True)
            return
        jobs.append(Job(write_export, (bench.lens, path, quality, bool(replace.value)), bench.notify))
        bench.notify()

    def update() -> None:
        lines = []
        for job in jobs[-8:][::-1]:
            bad = "miss" if job.state == "failed" else ""
            lines.append(
                f'<p class="{bad}">{text(job.progress if job.state == "running" else job.result)}</p>'
            )
        new = f'<div class="text-block">{"".join(lines)}</div>' if jobs else _EMPTY
        if note.object != new:
            note.object = new

    write.on_click(start)
    follow(bench, pane, update)
    return pane


_EMPTY = explanation(
    "Take the lens to a shop or another program",
    "Choose what to write. The file is written next to the design under its name, and never replaces a "
    "file unless you tick the box.",
    "Example: drawing for the shop (.pdf) writes one sheet for each element, with the tolerances of the "
    "design.",
)


def _name(bench: Workbench, kind: str) -> str:
    path = bench.document.path
    suffix = KINDS[kind]
    return str(path.with_suffix(suffix) if suffix else path.with_name(f"{path.stem}_report"))
