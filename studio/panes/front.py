"""Pane for Pareto fronts: lenses appear as they are found and can be loaded by a click."""

from __future__ import annotations

import json
import tomllib
from typing import Any

import numpy as np
import panel as pn

from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.built import manufacturing_quality
from studio.model.jobs import Job
from studio.model.searches import Search, run_exploration, variables_of
from studio.panes.common import JobPane, bench_of, follow, message, text
from studio.panes.themes import Theme, ThemedChart, chart

OBJECTIVES = {
    "thickness": "thickness_mm",
    "spread": "spread_deg",
    "track": "track_mm",
    "semi_diameter": "semi_diameter_mm",
    "as_built_rms": "as_built_rms_waves",
    "yield": "yield",
}
"""Objectives and the columns of their values."""


def explore(lens: Workbench | Lens) -> pn.Column:
    """Return a pane that explores two objectives in a child process; a click on a lens loads it."""
    return _Explore(bench_of(lens)).view


class _Explore(JobPane):
    """Widgets, the running exploration, and the lenses found so far."""

    def __init__(self, bench: Workbench) -> None:
        from bokeh.models import ColumnDataSource

        super().__init__(bench, "Explore")
        self.texts: list[str] = []
        self.over = ("thickness", "spread")
        names = list(OBJECTIVES)
        self.abscissa = pn.widgets.Select(name="across", options=names, value="thickness", width=140)
        self.ordinate = pn.widgets.Select(name="upward", options=names, value="spread", width=140)
        self.count = pn.widgets.IntInput(name="lenses", value=12, start=2, end=200, width=90)
        self.source = ColumnDataSource({"x": [], "y": []})
        self.plot = chart(height=260, x="across", y="upward")
        self.plot.add_tools("tap")
        self.dots = self.plot.scatter("x", "y", source=self.source, size=9, line_color=None)
        self.source.selected.on_change("indices", self._picked)
        self.run.on_click(self._start)
        form = pn.FlexBox(
            self.abscissa, self.ordinate, self.count, self.run, self.cancel, margin=(6, 6, 0, 6)
        )
        shown = ThemedChart(self.plot, self._dress, margin=(5, 10))
        self.view = pn.Column(form, self.message, shown, sizing_mode="stretch_width")
        self.view._explore = self  # keeps this object alive with its view
        follow(bench, self.view, self.update)

    def _dress(self, colors: dict[str, str], _: Theme) -> None:
        self.dots.glyph.fill_color = colors["accent"]

    def _start(self, _: object) -> None:
        bench, self.over = self.bench, (self.abscissa.value, self.ordinate.value)
        if self.is_running:
            return
        try:
            built = any(name in ("as_built_rms", "yield") for name in self.over)
            quality = manufacturing_quality(bench.grade, bench.lens) if built else None
        except TransferLensError as error:
            self.show_error(error)
            return
        varied = tuple(n for n in variables_of(bench.lens) if "asphere" not in n)
        self.texts, self.source.data = [], {"x": [], "y": []}
        arguments = (bench.lens, Search(varied), quality, ",".join(self.over), self.count.value)
        self.job = Job(run_exploration, arguments, bench.notify)
        self.plot.xaxis.axis_label, self.plot.yaxis.axis_label = (OBJECTIVES[n] for n in self.over)
        self.update()

    def _picked(self, _name: str, _old: Any, new: list[int]) -> None:
        if new and new[0] < len(self.texts):
            chosen = self.texts[new[0]]
            self.bench.change("a lens of the front", lambda _: tomllib.loads(chosen))

    def update(self) -> None:
        """Show the lenses found so far."""
        self.enable_buttons()
        job = self.job
        if job is None:
            return
        if len(job.lines) > len(self.texts):
            found = [json.loads(line) for line in job.lines]
            self.texts = [one["text"] for one in found]
            columns = [OBJECTIVES[name] for name in self.over]
            x, y = (np.array([one["values"][column] for one in found], float) for column in columns)
            self.source.data = {"x": x, "y": y}
        if job.state == "failed":
            new = message(text(job.result), is_bad=True)
        else:
            count = len(self.texts)
            new = message(f"{count} lenses, {text(job.state)}. Click one to load it; undo takes it back.")
        if self.message.object != new:
            self.message.object = new
