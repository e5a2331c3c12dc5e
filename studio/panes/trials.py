"""Pane for a tolerance study of the lens: trials appear as they arrive and can be inspected."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn

from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.built import manufacturing_quality
from studio.model.jobs import Job
from studio.model.studies import run_trials, trial_what_if, trials_so_far
from studio.panes.common import JobPane, bench_of, follow, message, text
from studio.panes.themes import Theme, ThemedChart, chart
from tolerancing.merits.base import Merit
from tolerancing.merits.pupil import RmsWaves
from tolerancing.statistics.yields import yield_of


def tolerances(lens: Workbench | Lens) -> pn.Column:
    """Return a pane that runs a study; a click on a trial sets its deviations in the what-if sliders."""
    return _Tolerances(bench_of(lens)).view


class _Tolerances(JobPane):
    """Widgets, the running study, and its folder."""

    def __init__(self, bench: Workbench) -> None:
        from bokeh.models import ColumnDataSource

        super().__init__(bench, "Start")
        self.polling: Any = None
        self.folder: tempfile.TemporaryDirectory[str] | None = None
        self.count = pn.widgets.IntInput(name="trials", value=400, start=20, end=100_000, step=100, width=120)
        self.source = ColumnDataSource({"x": [], "y": [], "number": [], "color": []})
        self.colors = ("#00796b", "#c62828")
        self.passed, self.by_merit = np.zeros(0, bool), dict[str, float]()
        self.merits: tuple[Merit, ...] = ()
        self.column = 0
        self.chart = plot = chart(height=260, x="trial", y="rms waves")
        plot.add_tools("tap")
        plot.scatter("x", "y", source=self.source, size=5, color="color", line_color=None, alpha=0.8)
        self.source.selected.on_change("indices", self._picked)
        self.run.on_click(self._start)
        form = pn.Row(self.count, self.run, self.cancel, margin=(6, 6, 0, 6))
        self.view = pn.Column(
            form,
            self.message,
            ThemedChart(plot, self._dress, margin=(5, 10)),
            sizing_mode="stretch_width",
        )
        self.view._tolerances = self  # keeps this object alive with its view
        follow(bench, self.view, self.update)

    def _dress(self, colors: dict[str, str], _: Theme) -> None:
        self.colors = (colors["accent"], colors["bad"])
        if len(self.passed):
            self.source.data = dict(self.source.data) | {"color": self._painted()}

    def _painted(self) -> list[str]:
        return [self.colors[0] if good else self.colors[1] for good in self.passed]

    def _start(self, _: object) -> None:
        if self.is_running:
            return
        bench = self.bench
        try:
            quality = manufacturing_quality(bench.grade, bench.lens)
        except TransferLensError as error:
            self.show_error(error)
            return
        self.merits = quality.study.merits
        self.column = next((k for k, m in enumerate(self.merits) if isinstance(m, RmsWaves)), 0)
        self.chart.yaxis.axis_label = self.merits[self.column].column.replace("_", " ")
        self.folder = tempfile.TemporaryDirectory(prefix="studio")
        self.source.selected.indices = []
        self.passed = np.zeros(0, bool)
        self.job = Job(
            run_trials, (bench.lens, quality, self.count.value, Path(self.folder.name)), bench.notify
        )
        poll_milliseconds = 700
        self.polling = pn.state.add_periodic_callback(self._poll, poll_milliseconds)
        self.update()

    def _poll(self) -> None:
        self._read()
        if not self.is_running:
            self.polling.stop()
            self.update()

    def _read(self) -> None:
        found = trials_so_far(Path(self.folder.name)) if self.folder is not None else None
        if found is None or len(found.trials) == len(self.passed):
            return
        self.passed = np.asarray(found.passed, bool)
        self.by_merit = {
            merit.label: float(np.mean(merit.passed(found.scores[:, k])))
            for k, merit in enumerate(self.merits)
        }
        self.source.data = {
            "x": list(found.trials),
            "y": found.scores[:, self.column],
            "number": list(found.trials),
            "color": self._painted(),
        }

    def _picked(self, _name: str, _old: Any, new: list[int]) -> None:
        if not new or self.folder is None:
            return
        trial = int(self.source.data["number"][new[0]])
        self.bench.set_what_if(trial_what_if(Path(self.folder.name), trial))
        self.message.object = message(
            f"trial {trial}: its deviations are set in the what-if sliders, its "
            "wavefronts appear under Live; irregularities have no slider and are omitted"
        )

    def update(self) -> None:
        """Show the progress of the study."""
        self.enable_buttons()
        job = self.job
        if job is None or self.source.selected.indices:
            return
        if job.state == "failed":
            new = message(text(job.result), is_bad=True)
        elif (good := yield_of(self.passed)) is None:
            new = message(f"{text(job.progress or 'starting')}…")
        else:
            fraction, low, high = (100.0 * v for v in (good.fraction, good.low, good.high))
            merits_alone = ", ".join(f"{text(label)} {100.0 * v:.1f} %" for label, v in self.by_merit.items())
            new = message(
                f"<b>{fraction:.1f} %</b> of {good.total} lenses keep all limits ({low:.1f} to "
                f"{high:.1f} %); "
                f"each limit alone: {merits_alone}; {text(job.state)}. "
                "Click a trial to look at its lens."
            )
        self.message.object = new
