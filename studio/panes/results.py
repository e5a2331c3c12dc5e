"""Reconstructions to look at: verdict, residuals, what was calibrated, and the page that zooms."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from pathlib import Path

import panel as pn

from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.jobs import Job
from studio.model.results import Seen, look_at
from studio.panes.common import bench_of, follow, text


def look(lens: Workbench | Lens) -> pn.Column:
    """Open a folder of frames, a reconstruction or a calibration."""
    bench = bench_of(lens)
    jobs: list[Job] = []
    name = pn.widgets.TextInput(name="folder that wavesim wrote", placeholder="object", width=420)
    show = pn.widgets.Button(name="Open", button_type="primary", align="end")
    said = pn.pane.HTML("", sizing_mode="stretch_width", margin=0)
    form = pn.Row(name, show, margin=(6, 6, 0, 6))
    pane = pn.Column(form, said, sizing_mode="stretch_width", margin=0)
    shown: list[object] = [None]

    def begin(_: object) -> None:
        if jobs and jobs[-1].state == "running":
            jobs[-1].cancel()
        jobs.append(Job(look_at, (Path(name.value.strip()),), bench.tell))
        update()

    def update() -> None:
        if not jobs or (state := (jobs[-1], jobs[-1].state, jobs[-1].progress)) == shown[0]:
            return
        shown[0], job = state, jobs[-1]
        if job.state == "done":
            said.object = _markup(job.result)
        else:
            bad = ' class="miss"' if job.state == "failed" else ""
            told = job.result if job.state == "failed" else job.progress
            said.object = f'<div class="told"><p{bad}>{text(told or "")}</p></div>'

    show.on_click(begin)
    follow(bench, pane, update)
    return pane


def _markup(seen: Seen) -> str:
    kind = {True: "good", False: "bad", None: ""}[seen.explained]
    verdict = f'<p class="verdict {kind}">{text(seen.verdict)}</p>' if seen.verdict else ""
    rows = "".join(f"<tr><td>{text(name)}</td><td>{text(value)}</td></tr>" for name, value in seen.facts)
    # The page comes from a file: its scripts run in a frame of their own, which reaches nothing of this page.
    page = (
        f'<iframe class="zoom" sandbox="allow-scripts" title="zoom" srcdoc="{escape(seen.page)}"></iframe>'
        if seen.page
        else ""
    )
    pictures = "".join(
        f'<figure><img alt="{text(name)}" src="data:image/png;base64,{b64encode(data).decode()}">'
        f"<figcaption>{text(name)}</figcaption></figure>"
        for name, data in seen.pictures
    )
    return f'<div class="told">{verdict}{page}{pictures}<table class="facts">{rows}</table></div>'
