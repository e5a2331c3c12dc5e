"""Results of explorations, searches and studies, which belong to the document and not to a pane."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from lensdesign import Lens
from lensdesign.files.design import design_text
from studio import Workbench, panes
from studio.model.built import manufacturing_quality
from studio.model.searches import SearchSummary
from studio.model.session import ExplorationRun, SearchRun, StudyRun
from studio.model.studies import run_trials


@dataclass
class FinishedJob:
    """A job that has ended."""

    lines: list[str] = field(default_factory=list)
    result: Any = None
    state: str = "done"
    progress: str = ""

    def cancel(self) -> None:
        """Nothing is left to stop."""


@pytest.fixture
def bench(paper_lens: Lens) -> Workbench:
    made = Workbench(paper_lens, "")
    made.settle()
    return made


def test_lenses_of_a_front_surround_the_present_lens_and_load(bench: Workbench, paper_lens: Lens) -> None:
    other = paper_lens.with_surface(0, radius_mm=40.0)
    lines = [
        json.dumps({"values": {"track_mm": 45.0, "spread_deg": s}, "text": design_text(lens, Path("/"))})
        for s, lens in ((4.7, paper_lens), (4.6, other))
    ]
    bench.session.exploration = ExplorationRun(FinishedJob(lines), ("track", "spread"))  # type: ignore[arg-type]
    for _ in range(2):  # a second pane, as after a reload, shows the same
        pane = panes.explore(bench)._explore
        assert pane.source.data == {"x": [45.0, 45.0], "y": [4.7, 4.6]}
        assert pane.here.data["x"] == [paper_lens.track_mm]
        assert pane.here.data["y"] == [bench.analysis.check.max_spread_deg]
        assert pane.plot.xaxis.axis_label == "track (mm)"
        assert "All have the same track (mm)" in pane.message.object
    pane.source.selected.indices = [1]
    assert bench.lens.surfaces[0].radius_mm == 40.0
    bench.undo()
    assert bench.lens.surfaces[0].radius_mm == paper_lens.surfaces[0].radius_mm
    bench.close()


def test_a_search_is_shown_with_its_progress_and_taken(bench: Workbench, paper_lens: Lens) -> None:
    found = design_text(paper_lens.with_surface(0, radius_mm=40.0), Path("/"))
    lines = [
        json.dumps({"text": "start 1"}),
        json.dumps({"seconds": 0.1, "start": 0, "goal": 1.1, "feasible": False}),
        json.dumps({"seconds": 0.5, "start": 0, "goal": 0.9, "feasible": True}),
    ]
    summary = SearchSummary(found, True, (), ("footprint",), "smallest spread 4.6°")
    bench.session.search = SearchRun(FinishedJob(lines, summary), paper_lens)  # type: ignore[arg-type]
    pane = panes.optimize(bench)._optimize
    missed, met = (renderer.data_source.data for renderer in pane.progress.object.renderers)
    assert (missed["x"], missed["y"]) == ([0.1], [1.1])
    assert (met["x"], met["y"], met["start"]) == ([0.5], [0.9], [1])
    start, drawn = (
        next(r for r in pane.layouts.object.renderers if r.glyph.__class__.__name__ == name).data_source.data
        for name in ("MultiLine", "Patches")
    )
    assert len(drawn["xs"]) == 1
    assert start["xs"]
    assert "binding: footprint" in pane.message.object
    pane._accept(None)
    assert bench.lens.surfaces[0].radius_mm == 40.0
    assert bench.session.search is None
    assert "Example" in pane.message.object
    bench.close()


def test_a_study_shows_its_running_yield_and_the_scores_against_the_limit(
    bench: Workbench, paper_lens: Lens
) -> None:
    quality = manufacturing_quality("high_precision", paper_lens)
    coarse = quality.study.sampling.model_copy(update={"pupil_samples": 48})
    study = quality.study.model_copy(
        update={
            "sampling": coarse,
            "sensitivity": False,
            "all_merits": tuple(
                m for m in quality.study.merits if m.kind in ("rms_waves", "largest_spread_deg")
            ),
        }
    )
    quality = type(quality)(quality.name, study)
    storage = tempfile.TemporaryDirectory(prefix="studio")
    run_trials(paper_lens, quality, 12, Path(storage.name), lambda _: None)
    bench.session.study = StudyRun(FinishedJob(), study, storage)  # type: ignore[arg-type]
    pane = panes.tolerances(bench)._tolerances
    good = pane.progress.summary.good
    running = pane.running.source.data
    assert running["x"][-1] == 12
    assert running["y"][-1] == pytest.approx(100.0 * good.fraction)
    assert (running["low"][-1], running["high"][-1]) == pytest.approx((100.0 * good.low, 100.0 * good.high))
    assert f"{100.0 * good.fraction:.1f} %" in pane.message.object
    assert pane.scores.limit.location == study.merits[0].at_most
    assert sum(pane.scores.bars.data["count"]) == 12
    assert pane.scores.steps.data["y"][-1] == pytest.approx(100.0)
    assert sorted(pane.scores.steps.data["x"]) == pytest.approx(sorted(pane.trials.source.data["y"]))
    pane.merit.value = 1
    assert pane.scores.limit.location == study.merits[1].at_most
    pane.trials.source.selected.indices = [3]
    assert bench.what_if.is_active
    assert "irregularities of trial 3" in panes.deviations(bench).words
    assert "Trial 3" in pane.message.object
    storage.cleanup()
    pane.trials.source.selected.indices = [4]
    assert "design.toml" in pane.message.object or "study.toml" in pane.message.object
    assert bench.session.study.picked == 3
    assert "start the study again" in panes.tolerances(bench)._tolerances.message.object
    bench.close()


@pytest.mark.parametrize(
    ("module", "name"), [("search", "optimize"), ("front", "explore"), ("trials", "tolerances")]
)
def test_a_button_leaves_the_update_of_its_page_to_the_workbench(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch, module: str, name: str
) -> None:
    """The document of a page may not be locked when a button is pressed."""
    monkeypatch.setattr(f"studio.panes.{module}.Job", lambda *_: FinishedJob(state="running"))
    bench.set_grade("precision")
    pane = getattr(getattr(panes, name)(bench), f"_{name}")
    updates: list[int] = []
    monkeypatch.setattr(pane, "update", lambda: updates.append(1))
    pane._start(None)
    assert updates == []
    assert pane.is_running
    assert pane.run.disabled
    bench.close()
