"""Pane for searches: variables, constraints, progress, and comparison of the result with the start."""

from __future__ import annotations

import json
import tomllib
from functools import partial
from pathlib import Path
from typing import Any

import panel as pn

from lensdesign.common.text import name_with_unit
from lensdesign.errors import InputError, TransferLensError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.built import manufacturing_quality
from studio.model.editing import lens_from
from studio.model.jobs import Job
from studio.model.searches import CONSTRAINTS, GOALS, SearchSummary, run_search, variables_of
from studio.model.session import SearchRun, Session
from studio.panes.common import JobPane, bench_of, bind, explanation, follow, message, message_pane, text
from studio.panes.comparison import comparison
from studio.panes.rays import layouts_over_each_other
from studio.panes.themes import Theme, ThemedChart, chart, hover
from tolerancing.perturbations.grades import GRADES


def optimize(lens: Workbench | Lens) -> pn.FlexBox:
    """Return a pane that runs a search in a child process; its result can be accepted or discarded."""
    bench = bench_of(lens)
    return _Optimize(bench).view


class _Optimize(JobPane):
    """Widgets, and the running search."""

    def __init__(self, bench: Workbench) -> None:
        super().__init__(
            bench, lambda: None if self._run_of is None else self._run_of.job, "Optimize", "Cancel"
        )
        self.shown: Any = ()
        session = bench.session
        self.variables = pn.widgets.CheckBoxGroup(options={}, value=[], margin=(0, 10))
        self.goal = pn.widgets.Select(name="goal", options=list(GOALS), sizing_mode="stretch_width")
        bind(bench, self.goal, lambda: session.goal, partial(setattr, session, "goal"))
        self.limits = [_limit(bench, session, *one) for one in CONSTRAINTS]
        self.accept = pn.widgets.Button(name="Take it", button_type="primary")
        self.discard = pn.widgets.Button(name="Drop it")
        self.run.on_click(self._start)
        self.accept.on_click(self._accept)
        self.discard.on_click(self._discard)
        self.variables.param.watch(self._ticked, "value")
        self.progress, self._draw_progress = _progress_chart()
        self.layouts, self._draw_layouts = layouts_over_each_other()
        self.view = self._view()
        follow(bench, self.view, self.update)

    @property
    def _run_of(self) -> SearchRun | None:
        return self.bench.session.search

    def _view(self) -> pn.FlexBox:
        head = '<div class="head">{}</div>'
        form = pn.Column(
            pn.pane.HTML(head.format("Variables"), margin=0),
            self.variables,
            pn.pane.HTML(
                '<div class="text-block hint">Their ranges are in the table under Surfaces.</div>', margin=0
            ),
            self.goal,
            pn.pane.HTML(head.format("Constraints"), margin=0),
            pn.FlexBox(*self.limits, sizing_mode="stretch_width"),
            pn.Row(self.run, self.cancel),
            width=350,
            margin=(0, 0, 10, 0),
        )
        self.table = message_pane()
        self.choice = pn.Row(self.accept, self.discard, visible=False)
        self.pictures = pn.Column(self.progress, sizing_mode="stretch_width", margin=0, visible=False)
        found = pn.Column(
            self.message,
            self.choice,
            self.pictures,
            self.table,
            min_width=300,
            sizing_mode="stretch_width",
            styles={"min-width": "0", "flex": "1 1 300px"},
        )
        view = pn.FlexBox(form, found, sizing_mode="stretch_width", margin=0, flex_wrap="wrap")
        view._optimize = self  # keeps this object alive with its view
        return view

    def _ticked(self, event: Any) -> None:
        session, names = self.bench.session, list(self.variables.options.values())
        if set(event.new) != set(session.varied_in(self.bench.lens)):
            session.varied = (*(n for n in session.varied if n not in names), *event.new)
            self.bench.notify()

    def _start(self, _: object) -> None:
        bench = self.bench
        if self.is_running:
            return
        try:
            search = bench.session.requested_search(bench.lens)
            grade = bench.grade or next(iter(GRADES))
            quality = manufacturing_quality(grade, bench.lens) if search.needs_tolerances else None
        except InputError as error:
            self.show_error(error)
            return
        job = Job(run_search, (bench.lens, search, quality), bench.notify)
        bench.session.search = SearchRun(job, bench.lens)
        bench.notify()

    def _accept(self, _: object) -> None:
        found = self._found()
        if found is not None:
            self.bench.change("what a search found", lambda _: tomllib.loads(found.text))
        self._discard(None)

    def _discard(self, _: object) -> None:
        self.bench.session.search = None
        self.bench.notify()

    def _found(self) -> SearchSummary | None:
        job = self.job
        return job.result if job is not None and job.state == "done" else None

    def update(self) -> None:
        """Show the progress of the search, or its result."""
        bench = self.bench
        options = {name.replace("_mm", "").replace("_", " "): name for name in variables_of(bench.lens)}
        if self.variables.options != options:
            self.variables.param.update(options=options, value=list(bench.session.varied_in(bench.lens)))
        elif set(self.variables.value) != set(varied := bench.session.varied_in(bench.lens)):
            self.variables.value = list(varied)
        self.enable_buttons()
        job = self.job
        state = None if job is None else (job, job.state, len(job.lines))
        if state == self.shown:
            return
        self.shown = state
        is_found = job is not None and job.state == "done"
        if self.choice.visible is not is_found:
            self.choice.visible = is_found
            self.table.object = ""
        if job is None:
            self.pictures.visible = False
            self.show_message(_EMPTY)
            return
        lines = [json.loads(line) for line in job.lines]
        self._draw_progress([line for line in lines if "goal" in line])
        if not self.pictures.visible:
            self.pictures.visible = True
        if (self.layouts in self.pictures) is not is_found:
            self.pictures.objects = [self.progress, self.layouts] if is_found else [self.progress]
        texts = [line["text"] for line in lines if "text" in line]
        if job.state == "running":
            self.show_message(message(f"searching… {text(texts[-1] if texts else '')}"))
        elif job.state == "cancelled":
            self.show_message(message("cancelled; the lens is as it was"))
        elif job.state == "failed":
            self.show_message(message(text(job.result), is_bad=True))
        else:
            self._show(job.result)

    def _show(self, found: SearchSummary) -> None:
        assert self._run_of is not None  # a search ran
        start, lens = self._run_of.start, lens_from(tomllib.loads(found.text), Path("found.toml"))
        kind, words = ("good", "every constraint is met") if found.feasible else ("bad", "not all is met")
        sentences = "".join(f'<p class="miss">{text(one)}</p>' for one in found.violations)
        sentences += "".join(f"<p>binding: {text(one)}</p>" for one in found.binding)
        self.show_message(
            f'<div class="text-block"><p class="verdict {kind}">{words}</p><p>{text(found.summary)}</p>'
            f"{sentences}</div>"
        )
        self.table.object = comparison(["start", "found"], [start, lens])
        try:
            self._draw_layouts((start, lens))
        except TransferLensError as error:
            self.show_error(error)


_EMPTY = explanation(
    "Find a better lens",
    "The search changes the ticked values until the goal is reached as well as the constraints allow. "
    "It runs beside the page, shows each improvement, and changes the lens only when you take the "
    "result.",
    "Example: tick the radii of both surfaces and the conic of surface 2, choose the goal smallest "
    "spread, and press Optimize. The paper's lens is found again in a few seconds, with a spread below "
    "the sensor's limit.",
)


def _limit(bench: Workbench, session: Session, key: str, label: str, unit: str) -> pn.widgets.TextInput:
    widget = pn.widgets.TextInput(
        name=name_with_unit(label, unit), placeholder="no limit", width=155, margin=(5, 5, 5, 10)
    )
    bind(
        bench, widget, lambda: session.limits.get(key, ""), lambda value: session.limits.update({key: value})
    )
    return widget


def _progress_chart() -> tuple[ThemedChart, Any]:
    """Return a chart of the goal against time, and the function that draws its improvements."""
    from bokeh.models import ColumnDataSource

    plot = chart("goal against time", height=170, x="time (s)", y="goal (1: its reference)")
    met, missed = (ColumnDataSource({"x": [], "y": [], "start": []}) for _ in range(2))
    dots = [
        plot.scatter("x", "y", source=missed, size=6, fill_color=None, legend_label="constraints not met"),
        plot.scatter("x", "y", source=met, size=6, line_color=None, legend_label="constraints met"),
    ]
    hover(plot, dots, ("time", "@x{0.0} s"), ("goal", "@y{0.0000}"), ("start", "@start"))
    plot.legend.location = "top_right"

    def dress(colors: dict[str, str], _: Theme) -> None:
        dots[0].glyph.line_color = colors["faint"]
        dots[1].glyph.fill_color = colors["accent"]

    def draw(found: list[dict[str, Any]]) -> None:
        for source, feasible in ((met, True), (missed, False)):
            own = [one for one in found if one["feasible"] is feasible]
            source.data = {
                "x": [one["seconds"] for one in own],
                "y": [one["goal"] for one in own],
                "start": [one["start"] + 1 for one in own],
            }

    return ThemedChart(plot, dress, margin=(5, 10)), draw
