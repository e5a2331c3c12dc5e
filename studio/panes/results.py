"""Pane for reconstructions: goodness of fit, residuals, calibrated values, and a zoomable picture."""

from __future__ import annotations

from base64 import b64encode
from html import escape

import panel as pn

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.files import remember, typed_path
from studio.model.jobs import Job
from studio.model.results import FolderContents, read_folder
from studio.panes.common import bench_of, explanation, follow, message, message_pane, text
from studio.panes.files import FileChoice


def result_folder_pane(lens: Workbench | Lens) -> pn.Column:
    """Return a pane that opens a folder of frames, a reconstruction or a calibration."""
    bench = bench_of(lens)
    session = bench.session
    name = FileChoice(
        "folders", label="folder that wavesim wrote", placeholder="object", mode="folder", width=480
    )
    show = pn.widgets.Button(name="Open", button_type="primary", align="end")
    note = message_pane()
    form = pn.FlexBox(name, show, margin=(6, 6, 0, 6))
    pane = pn.Column(form, note, sizing_mode="stretch_width", margin=0)
    last_state: list[object] = [""]

    def start(_: object) -> None:
        if session.opened_folder is not None:
            session.opened_folder.cancel()
        try:
            path = typed_path(name.value)
        except InputError as error:
            note.object = message(text(error), is_bad=True)
            return
        remember("folders", path)
        session.opened_folder = Job(read_folder, (path,), bench.notify)
        bench.notify()

    def update() -> None:
        job = session.opened_folder
        state = None if job is None else (job, job.state, job.progress)
        if state == last_state[0]:
            return
        last_state[0] = state
        if job is None:
            note.object = _EMPTY
        elif job.state == "done":
            note.object = _markup(job.result)
        else:
            failed = job.state == "failed"
            note.object = message(text((job.result if failed else job.progress) or ""), is_bad=failed)

    show.on_click(start)
    follow(bench, pane, update)
    return pane


_EMPTY = explanation(
    "Look at frames and reconstructions",
    "Open a folder that wavesim image, reconstruct or calibrate wrote. It shows the verdict, a picture "
    "to zoom, the residuals, and the calibrated deviations.",
    "Example: wavesim image designs/paper_singlet.toml -o frames, then wavesim reconstruct "
    "designs/paper_singlet.toml frames/frame_1.tif frames/frame_2.tif -o object, and open the folder "
    "object.",
)


def _markup(contents: FolderContents) -> str:
    kind = {True: "good", False: "bad", None: ""}[contents.explained]
    verdict = f'<p class="verdict {kind}">{text(contents.verdict)}</p>' if contents.verdict else ""
    rows = "".join(f"<tr><td>{text(name)}</td><td>{text(value)}</td></tr>" for name, value in contents.facts)
    # The page comes from a file, so its scripts run in a sandbox without access to this page.
    page = (
        '<iframe class="zoom" sandbox="allow-scripts" title="zoom" '
        f'srcdoc="{escape(contents.page)}"></iframe>'
        if contents.page
        else ""
    )
    pictures = "".join(
        f'<figure><img class="on-light" alt="{text(name)}" src="{_source(light)}">'
        f'<img class="on-dark" alt="{text(name)}" src="{_source(dark)}">'
        f"<figcaption>{text(name)}</figcaption></figure>"
        for name, light, dark in contents.pictures
    )
    return f'<div class="text-block">{verdict}{page}{pictures}<table class="facts">{rows}</table></div>'


def _source(data: bytes) -> str:
    return f"data:image/png;base64,{b64encode(data).decode()}"
