"""Pane for searches: variables, constraints, progress, and comparison of the result with the start."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import panel as pn

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.built import manufacturing_quality
from studio.model.editing import lens_from
from studio.model.jobs import Job
from studio.model.searches import CONSTRAINTS, GOALS, Search, SearchSummary, run_search, variables_of
from studio.panes.common import JobPane, bench_of, follow, message, text
from studio.panes.comparison import comparison
from tolerancing.perturbations.grades import GRADES


def optimize(lens: Workbench | Lens) -> pn.Row:
    """Return a pane that runs a search in a child process; its result can be accepted or discarded."""
    bench = bench_of(lens)
    return _Optimize(bench).view


class _Optimize(JobPane):
    """Widgets, and the running search."""

    def __init__(self, bench: Workbench) -> None:
        super().__init__(bench, "Optimize", "Cancel")
        self.start: Lens | None = None
        self.shown: Any = None
        self.variables = pn.widgets.CheckBoxGroup(options=[], value=[], margin=(0, 10))
        self.goal = pn.widgets.Select(
            name="goal", options=list(GOALS), value=GOALS[0], sizing_mode="stretch_width"
        )
        self.limits = {
            key: pn.widgets.TextInput(
                name=f"{label}{f' ({unit})' if unit else ''}",
                value="sensor" if key in ("max_spread_deg", "max_footprint_radius_mm") else "",
                placeholder="no limit",
                width=140,
            )
            for key, label, unit in CONSTRAINTS
        }
        self.accept = pn.widgets.Button(name="Take it", visible=False, button_type="primary")
        self.discard = pn.widgets.Button(name="Drop it", visible=False)
        self.run.on_click(self._run)
        self.accept.on_click(self._accept)
        self.discard.on_click(self._discard)
        self.view = self._view()
        follow(bench, self.view, self.update)

    def _view(self) -> pn.Row:
        head = '<div class="head">{}</div>'
        form = pn.Column(
            pn.pane.HTML(head.format("Variables"), margin=0),
            self.variables,
            self.goal,
            pn.pane.HTML(head.format("Constraints"), margin=0),
            pn.FlexBox(*self.limits.values(), sizing_mode="stretch_width"),
            pn.Row(self.run, self.cancel),
            width=330,
            margin=(0, 0, 10, 0),
        )
        found = pn.Column(
            self.message,
            pn.Row(self.accept, self.discard),
            sizing_mode="stretch_width",
            styles={"min-width": "0"},
        )
        view = pn.Row(form, found, sizing_mode="stretch_width", margin=0)
        view._optimize = self  # keeps this object alive with its view
        return view

    def _requested_search(self) -> Search:
        limits: dict[str, float | str] = {}
        for key, widget in self.limits.items():
            given = widget.value.strip()
            if given in ("sensor", "none") and widget.value:
                limits[key] = given
            elif given:
                try:
                    limits[key] = float(given)
                except ValueError:
                    raise InputError(f"{widget.name}: {given!r}: must be a number, or empty") from None
            elif key in ("max_spread_deg", "max_footprint_radius_mm"):
                limits[key] = "none"
        return Search(tuple(self.variables.value), self.goal.value, limits)

    def _run(self, _: object) -> None:
        bench = self.bench
        if self.is_running:
            return
        try:
            search = self._requested_search()
            if not search.variables:
                raise InputError("no variable is selected: tick at least one")
            grade = bench.grade or next(iter(GRADES))
            quality = manufacturing_quality(grade, bench.lens)
            needs = search.goal in ("as-built rms", "yield") or "min_yield" in search.constraints
        except InputError as error:
            self.show_error(error)
            return
        self.start, self.shown = bench.lens, None
        self.accept.visible = self.discard.visible = False
        self.job = Job(run_search, (bench.lens, search, quality if needs else None), bench.notify)
        self.update()

    def _accept(self, _: object) -> None:
        found = self._found()
        if found is not None:
            self.bench.change("what a search found", lambda _: tomllib.loads(found.text))
        self._discard(None)

    def _discard(self, _: object) -> None:
        self.job, self.shown, self.message.object = None, None, ""
        self.accept.visible = self.discard.visible = False

    def _found(self) -> SearchSummary | None:
        job = self.job
        return job.result if job is not None and job.state == "done" else None

    def update(self) -> None:
        """Show the progress of the search, or its result."""
        names = list(variables_of(self.bench.lens))
        if list(self.variables.options) != names:
            kept = [n for n in self.variables.value if n in names]
            self.variables.options = names
            self.variables.value = kept or [n for n in names if "radius" in n or n == "surface 2 conic"]
        self.enable_buttons()
        job = self.job
        if job is None or (state := (job.state, job.progress)) == self.shown:
            return
        self.shown = state
        if job.state == "running":
            self.message.object = message(f"searching… {text(job.progress)}")
        elif job.state == "cancelled":
            self.message.object = message("cancelled; the lens is as it was")
        elif job.state == "failed":
            self.message.object = message(text(job.result), is_bad=True)
        else:
            self._show(job.result)

    def _show(self, found: SearchSummary) -> None:
        assert self.start is not None  # a search ran
        lens = lens_from(tomllib.loads(found.text), Path("found.toml"))
        kind, words = ("good", "every constraint is met") if found.feasible else ("bad", "not all is met")
        sentences = "".join(f'<p class="miss">{text(one)}</p>' for one in found.violations)
        sentences += "".join(f"<p>binding: {text(one)}</p>" for one in found.binding)
        self.message.object = (
            f'<div class="text-block"><p class="verdict {kind}">{words}</p><p>{text(found.summary)}</p>'
            f"{sentences}</div>" + comparison(["start", "found"], [self.start, lens])
        )
        self.accept.visible = self.discard.visible = True
