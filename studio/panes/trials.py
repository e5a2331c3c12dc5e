"""Pane for a tolerance study of the lens: trials appear as they arrive and can be inspected."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn

from lensdesign.common.text import quantity_label, words_and_unit
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.built import manufacturing_quality
from studio.model.jobs import Job
from studio.model.session import StudyRun
from studio.model.studies import StudyProgress, run_trials, study_progress, trial_what_if
from studio.panes.common import JobPane, bench_of, bind, explanation, follow, message, text
from studio.panes.themes import Theme, ThemedChart, chart, hover, set_range
from tolerancing.merits.base import Merit
from tolerancing.merits.pupil import RmsWaves


def tolerances(lens: Workbench | Lens) -> pn.Column:
    """Return a pane that runs a study; a click on a trial sets its deviations in the what-if sliders."""
    return _Tolerances(bench_of(lens)).view


class _Tolerances(JobPane):
    """Widgets, the running study, and its charts."""

    def __init__(self, bench: Workbench) -> None:
        session = bench.session
        super().__init__(bench, lambda: None if session.study is None else session.study.job, "Start")
        self.polling: Any = None
        self.drawn: Any = None
        self.progress: StudyProgress | None = None
        self.count = pn.widgets.IntInput(name="trials", start=20, end=100_000, step=100, width=120)
        bind(bench, self.count, lambda: session.trials, partial(setattr, session, "trials"))
        self.merit = pn.widgets.Select(name="limit", options={}, width=260, visible=False)
        self.merit.param.watch(lambda _: self._draw(), "value")
        self.trials, self.running, self.scores = _TrialsChart(self._picked), _YieldChart(), _ScoreChart()
        self.run.on_click(self._start)
        form = pn.FlexBox(self.count, self.run, self.cancel, self.merit, margin=(6, 6, 0, 6))
        self.charts = pn.Column(
            pn.Row(self.running.pane, self.scores.pane, sizing_mode="stretch_width", margin=0),
            self.trials.pane,
            sizing_mode="stretch_width",
            visible=False,
        )
        self.view = pn.Column(form, self.message, self.charts, sizing_mode="stretch_width")
        self.view._tolerances = self  # keeps this object alive with its view
        follow(bench, self.view, self.update)

    def _start(self, _: object) -> None:
        if self.is_running:
            return
        bench = self.bench
        try:
            quality = manufacturing_quality(bench.grade, bench.lens)
        except TransferLensError as error:
            self.show_error(error)
            return
        storage = tempfile.TemporaryDirectory(prefix="studio")
        arguments = (bench.lens, quality, bench.session.trials, Path(storage.name))
        bench.session.study = StudyRun(Job(run_trials, arguments, bench.notify), quality.study, storage)
        bench.notify()

    def _poll(self) -> None:
        self._read()
        if not self.is_running:
            self.polling.stop()
            self.polling = None
            self.update()

    def _read(self) -> None:
        run = self.bench.session.study
        found = None if run is None else study_progress(run.folder)
        if found is not None:
            self.progress = found
            self._draw()
            self._show_result()

    def _draw(self) -> None:
        if self.progress is not None and self.merit.value is not None:
            column = int(self.merit.value)
            merit = self.progress.summary.study.merits[column]
            self.trials.draw(self.progress, column, merit)
            self.scores.draw(self.progress, column, merit)
            self.running.draw(self.progress)

    def _picked(self, trial: int) -> None:
        run = self.bench.session.study
        if run is not None:
            try:
                what_if = trial_what_if(run.folder, trial)
            except TransferLensError as error:
                self.show_error(error)
                return
            run.picked = trial
            self.bench.set_what_if(what_if)

    def update(self) -> None:
        """Show the progress of the study."""
        self.enable_buttons()
        run = self.bench.session.study
        if run is None:
            self.show_message(_EMPTY)
            return
        if self.drawn is not run:
            self.drawn, self.progress = run, None
            labels = {quantity_label(merit.label): k for k, merit in enumerate(run.study.merits)}
            first = next((k for k, m in enumerate(run.study.merits) if isinstance(m, RmsWaves)), 0)
            self.merit.param.update(options=labels, value=first, visible=True)
            self._read()
        if self.is_running and self.polling is None and pn.state.curdoc is not None:
            poll_milliseconds = 700
            self.polling = pn.state.add_periodic_callback(self._poll, poll_milliseconds)
        self._show_result()

    def _show_result(self) -> None:
        run, job, found = self.bench.session.study, self.job, self.progress
        if run is None or job is None:
            return
        if self.charts.visible is not (found is not None):
            self.charts.visible = found is not None
        if job.state == "failed":
            self.show_message(message(text(job.result), is_bad=True))
        elif found is None and job.state == "done":
            lost = f"the trials in {run.folder} were removed or changed: start the study again"
            self.show_message(message(text(lost), is_bad=True))
        elif found is None or (good := found.summary.good) is None:
            self.show_message(message(f"{text(job.progress or 'starting')}…"))
        else:
            fraction, low, high = (100.0 * v for v in (good.fraction, good.low, good.high))
            alone = ", ".join(
                f"{text(words_and_unit(one.merit.label)[0])} {100.0 * one.good.fraction:.1f} %"
                for one in found.summary.merits
                if one.good is not None
            )
            picked = (
                "Click a trial to look at its lens."
                if run.picked is None
                else f"Trial {run.picked} is set as the what-if: its wavefronts are under Live."
            )
            self.show_message(
                message(
                    f"<b>{fraction:.1f} %</b> of {good.total} lenses keep all limits at once ({low:.1f} to "
                    f"{high:.1f} %); each limit alone: {alone}; {text(job.state)}. {picked}"
                )
            )


_EMPTY = explanation(
    "Make the lens many times",
    "A study draws lenses with the tolerances that are chosen under As built, and scores each one by "
    "tracing. It checks the predicted yield, and shows which limit the bad lenses miss.",
    "Example: 400 trials with the precision grade take about a minute. The yield and its 95 % interval "
    "appear while they run. A click on a trial sets its deviations as the what-if.",
)


class _TrialsChart:
    """Chart of the score of each trial; a click on one picks it."""

    def __init__(self, picked: Any) -> None:
        from bokeh.models import ColumnDataSource, Span

        self.source = ColumnDataSource({"x": [], "y": [], "color": []})
        self.colors = ("#00796b", "#c62828")
        self.passed = np.zeros(0, bool)
        self.plot = plot = chart("scores of the trials", height=200, x="trial", y="score")
        plot.add_tools("tap")
        dots = plot.scatter("x", "y", source=self.source, size=5, color="color", line_color=None, alpha=0.8)
        hover(plot, [dots], ("trial", "@x"), ("score", "@y{0.0000}"))
        self.limit = Span(dimension="width", line_dash="dashed", line_width=1.2)
        plot.add_layout(self.limit)

        def on_selected(_name: str, _old: Any, new: list[int]) -> None:
            if new:
                picked(int(self.source.data["x"][new[0]]))

        self.source.selected.on_change("indices", on_selected)
        self.pane = ThemedChart(plot, self._dress, margin=(5, 10))

    def _dress(self, colors: dict[str, str], _: Theme) -> None:
        self.colors = (colors["accent"], colors["bad"])
        self.limit.line_color = colors["ink"]
        if len(self.passed):
            self.source.data = dict(self.source.data) | {"color": self._painted()}

    def _painted(self) -> list[str]:
        return [self.colors[0] if good else self.colors[1] for good in self.passed]

    def draw(self, found: StudyProgress, column: int, merit: Merit) -> None:
        """Draw the scores of a merit, good lenses in one colour and bad ones in another."""
        self.passed = np.asarray(found.trials.passed, bool)
        self.limit.location = merit.at_most if merit.at_least is None else merit.at_least
        self.plot.yaxis.axis_label = quantity_label(merit.column)
        self.source.data = {
            "x": np.asarray(found.trials.trials).tolist(),
            "y": found.trials.scores[:, column].tolist(),
            "color": self._painted(),
        }


class _YieldChart:
    """Chart of the yield of the first trials, with its interval, against their number."""

    def __init__(self) -> None:
        from bokeh.models import Band, ColumnDataSource, Range1d

        self.source = ColumnDataSource({"x": [], "y": [], "low": [], "high": []})
        plot = chart(
            "yield against the number of trials",
            height=190,
            x="trials",
            y="yield (%), 95 % interval",
            y_range=Range1d(0, 100),
        )
        self.band = Band(base="x", lower="low", upper="high", source=self.source, fill_alpha=0.25)
        plot.add_layout(self.band)
        self.line = plot.line("x", "y", source=self.source, line_width=2)
        hover(
            plot,
            [self.line],
            ("trials", "@x"),
            ("yield", "@y{0.0} %"),
            ("interval", "@low{0.0} to @high{0.0} %"),
        )
        self.pane = ThemedChart(plot, self._dress, margin=(5, 10))

    def _dress(self, colors: dict[str, str], _: Theme) -> None:
        self.line.glyph.line_color = colors["accent"]
        self.band.update(fill_color=colors["accent"], line_color=None)

    def draw(self, found: StudyProgress) -> None:
        """Draw the running yield."""
        self.source.data = {
            "x": list(found.counts),
            "y": [100.0 * one.fraction for one in found.yields],
            "low": [100.0 * one.low for one in found.yields],
            "high": [100.0 * one.high for one in found.yields],
        }


class _ScoreChart:
    """Histogram of the scores of a merit with its limit, and the fraction of lenses up to each score."""

    def __init__(self) -> None:
        from bokeh.models import ColumnDataSource, Range1d, Span

        self.bars = ColumnDataSource({"left": [], "right": [], "top": [], "count": []})
        self.steps = ColumnDataSource({"x": [], "y": []})
        self.plot = plot = chart(
            "histogram and cumulative curve of the scores",
            height=190,
            x="score",
            y="lenses (%)",
            x_range=Range1d(0, 1),
            y_range=Range1d(0, 102),
        )
        self.quads = plot.quad(
            left="left", right="right", bottom=0, top="top", source=self.bars, legend_label="histogram"
        )
        self.curve = plot.line("x", "y", source=self.steps, line_width=2, legend_label="cumulative")
        self.limit = Span(dimension="height", line_dash="dashed", line_width=1.4)
        plot.add_layout(self.limit)
        plot.legend.location = "right"
        hover(plot, [self.quads], ("score", "@left{0.0000} to @right{0.0000}"), ("lenses", "@count"))
        hover(plot, [self.curve], ("score", "$x{0.0000}"), ("lenses up to it", "$y{0.0} %"))
        self.pane = ThemedChart(plot, self._dress, margin=(5, 10))

    def _dress(self, colors: dict[str, str], _: Theme) -> None:
        self.quads.glyph.update(fill_color=colors["faint"], fill_alpha=0.5, line_color=colors["paper"])
        self.curve.glyph.line_color = colors["accent"]
        self.limit.line_color = colors["bad"]

    def draw(self, found: StudyProgress, column: int, merit: Merit) -> None:
        """Draw the scores of a merit."""
        scores = found.trials.scores[:, column]
        known = np.sort(scores[np.isfinite(scores)])
        if not len(known):
            return
        limit = merit.at_most if merit.at_least is None else merit.at_least
        self.limit.location = limit
        self.plot.xaxis.axis_label = f"{words_and_unit(merit.column)[0]} ({merit.limit_text})"
        counts, edges = np.histogram(known, bins=min(40, max(8, round(len(known) ** 0.5))))
        self.bars.data = {
            "left": edges[:-1].tolist(),
            "right": edges[1:].tolist(),
            "top": (100.0 * counts / len(scores)).tolist(),
            "count": counts.tolist(),
        }
        steps = np.arange(1, len(known) + 1) * 100.0 / len(scores)
        self.steps.data = {"x": known.tolist(), "y": steps.tolist()}
        ends = [known[0], known[-1]] + ([] if limit is None else [limit])
        margin = 0.03 * (max(ends) - min(ends) or abs(ends[0]) or 1.0)
        set_range(self.plot.x_range, float(min(ends) - margin), float(max(ends) + margin))
