"""Pane for Pareto fronts: lenses appear as they are found and can be loaded by a click."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from functools import partial
from typing import Any

import panel as pn

from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from studio.model.analysis import LensAnalysis
from studio.model.bench import Workbench
from studio.model.built import manufacturing_quality
from studio.model.jobs import Job
from studio.model.searches import run_exploration
from studio.model.session import ExplorationRun
from studio.panes.common import JobPane, bench_of, bind, explanation, follow, message, text
from studio.panes.themes import Theme, ThemedChart, chart, hover

OBJECTIVES = {
    "thickness": "thickness_mm",
    "spread": "spread_deg",
    "track": "track_mm",
    "semi_diameter": "semi_diameter_mm",
    "as_built_rms": "as_built_rms_waves",
    "yield": "yield",
}
"""Objectives and the columns of their values."""

AXES = {
    "thickness": "thickness (mm)",
    "spread": "spread (°)",
    "track": "track (mm)",
    "semi_diameter": "semi-diameter (mm)",
    "as_built_rms": "as-built rms (waves)",
    "yield": "yield",
}
"""Objectives and the labels of their axes."""


def explore(lens: Workbench | Lens) -> pn.Column:
    """Return a pane that explores two objectives in a child process; a click on a lens loads it."""
    return _Explore(bench_of(lens)).view


def objective_value(analysis: LensAnalysis, name: str) -> float | None:
    """Return the value of an objective for the analysed lens; None if it is not known."""
    lens, check, built = analysis.lens, analysis.check, analysis.built
    if name == "thickness":
        return lens.exit_vertex_z_mm
    if name == "track":
        return lens.track_mm
    if name == "spread":
        return check.max_spread_deg if check is not None and "check" not in analysis.reasons else None
    if name == "semi_diameter":
        return _largest_height_mm(analysis)
    if built is None or "built" in analysis.reasons:
        return None
    if name == "yield":
        return built.prediction.yield_fraction
    waves = built.prediction.wavefronts
    return None if waves is None else max(point.rms_waves for point in waves.points)


def _largest_height_mm(analysis: LensAnalysis) -> float | None:
    layout = analysis.layout
    if layout is None or "layout" in analysis.reasons:
        return None
    # Corners of a ray between the object and the first sensor plane lie on the surfaces.
    count = len(analysis.lens.surfaces)
    return max(float(abs(rays[:, 1 : count + 1, 1]).max()) for rays in layout.rays)


class _Explore(JobPane):
    """Widgets, the running exploration, and the lenses found so far."""

    def __init__(self, bench: Workbench) -> None:
        from bokeh.models import ColumnDataSource

        session = bench.session
        super().__init__(
            bench, lambda: None if session.exploration is None else session.exploration.job, "Explore"
        )
        self.texts: list[str] = []
        self.drawn: Any = None
        names = {label: name for name, label in AXES.items()}
        self.abscissa = pn.widgets.Select(name="across", options=names, width=170)
        self.ordinate = pn.widgets.Select(name="upward", options=names, width=170)
        self.count = pn.widgets.IntInput(name="lenses", start=2, end=200, width=90)
        bind(bench, self.abscissa, lambda: session.over[0], partial(self._set_objective, 0))
        bind(bench, self.ordinate, lambda: session.over[1], partial(self._set_objective, 1))
        bind(bench, self.count, lambda: session.lenses, partial(setattr, session, "lenses"))
        self.source = ColumnDataSource({"x": [], "y": []})
        self.here = ColumnDataSource({"x": [], "y": []})
        self.plot = chart("lenses of the exploration", height=280, x="across", y="upward")
        self.plot.add_tools("tap")
        self.dots = self.plot.scatter(
            "x", "y", source=self.source, size=9, line_color=None, legend_label="found lenses: click to load"
        )
        self.mark = self.plot.scatter(
            "x", "y", source=self.here, size=14, marker="star", line_color=None, legend_label="present lens"
        )
        hover(self.plot, [self.dots, self.mark], ("across", "@x{0.0000}"), ("upward", "@y{0.0000}"))
        self.source.selected.on_change("indices", self._picked)
        self.run.on_click(self._start)
        form = pn.FlexBox(
            self.abscissa, self.ordinate, self.count, self.run, self.cancel, margin=(6, 6, 0, 6)
        )
        self.shown = ThemedChart(self.plot, self._dress, margin=(5, 10))
        self.shown.visible = False
        self.view = pn.Column(form, self.message, self.shown, sizing_mode="stretch_width")
        self.view._explore = self  # keeps this object alive with its view
        follow(bench, self.view, self.update)

    def _set_objective(self, index: int, name: str) -> None:
        over = self.bench.session.over
        self.bench.session.over = (name, over[1]) if index == 0 else (over[0], name)

    def _dress(self, colors: dict[str, str], _: Theme) -> None:
        self.dots.glyph.fill_color = colors["accent"]
        self.mark.glyph.fill_color = colors["near"]

    def _start(self, _: object) -> None:
        bench, session = self.bench, self.bench.session
        if self.is_running:
            return
        try:
            search = session.requested_search(bench.lens)
            over = session.over
            built = "min_yield" in search.constraints or {"as_built_rms", "yield"} & set(over)
            quality = manufacturing_quality(bench.grade, bench.lens) if built else None
        except TransferLensError as error:
            self.show_error(error)
            return
        # The goal of each search is one of the objectives.
        search = replace(search, goal="smallest spread")
        arguments = (bench.lens, search, quality, ",".join(over), session.lenses)
        session.exploration = ExplorationRun(Job(run_exploration, arguments, bench.notify), over)
        bench.notify()

    def _picked(self, _name: str, _old: Any, new: list[int]) -> None:
        if new and new[0] < len(self.texts):
            chosen = self.texts[new[0]]
            self.bench.change("a lens of the front", lambda _: tomllib.loads(chosen))

    def update(self) -> None:
        """Show the lenses found so far, and the present lens among them."""
        self.enable_buttons()
        run, job = self.bench.session.exploration, self.job
        if run is None or job is None:
            self.show_message(_EMPTY)
            return
        if (state := (job, len(job.lines))) != self.drawn:
            self.drawn = state
            found = [json.loads(line) for line in job.lines]
            self.texts = [one["text"] for one in found]
            columns = [OBJECTIVES[name] for name in run.over]
            x, y = ([float(one["values"][column]) for one in found] for column in columns)
            self.source.selected.indices = []
            self.source.data = {"x": x, "y": y}
            self.plot.xaxis.axis_label, self.plot.yaxis.axis_label = (AXES[name] for name in run.over)
        if not self.shown.visible:
            self.shown.visible = True
        x_here, y_here = (objective_value(self.bench.analysis, name) for name in run.over)
        known = x_here is not None and y_here is not None
        here = {"x": [x_here], "y": [y_here]} if known else {"x": [], "y": []}
        if dict(self.here.data) != here:
            self.here.data = here
        if job.state == "failed":
            self.show_message(message(text(job.result), is_bad=True))
        else:
            words = f"{len(self.texts)} lenses, {text(job.state)}. Click one to load it; undo takes it back."
            for name, column in zip(run.over, ("x", "y"), strict=True):
                found = self.source.data[column]
                if len(found) > 1 and max(found) - min(found) < 1e-6 * max(map(abs, found)):
                    words += f" All have the same {text(AXES[name])}: tick more values under Surfaces."
            self.show_message(message(words))


_EMPTY = explanation(
    "See what one property costs in another",
    "The exploration changes the values that are ticked under Optimize or Surfaces, within the "
    "constraints there, and finds lenses that no other lens beats in both properties.",
    "Example: tick the thickness of surface 1, and explore thickness across, spread upward, 12 lenses. "
    "After some seconds the chart shows how much spread each millimetre of glass saves. The star is the "
    "present lens, and a click on a dot loads that lens.",
)
