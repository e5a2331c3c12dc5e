"""The workbench: typed values, listeners, and the newest state that wins."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign import InputError, check_design, load_design
from studio.model import bench as bench_module
from studio.model.analysis import AnalysisRequest, LensAnalysis
from studio.model.bench import Workbench
from studio.model.document import Autosave
from studio.model.whatif import WhatIf

RADIUS = "surface.1.radius_mm"


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Workbench]:
    file = Path(shutil.copy(DESIGNS / "paper_singlet.toml", tmp_path / "lens.toml"))
    made = Workbench(file, "", Autosave(file, tmp_path / "aside"))
    yield made
    made.close()


def wait(until: Callable[[], bool], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_figures_follow_and_settle_to_those_of_the_check(bench: Workbench) -> None:
    assert bench.edit(RADIUS, "number", "-12.2")
    wait(lambda: bench.analysis.settled and bench.analysis.lens == bench.lens)
    assert bench.analysis.check == check_design(bench.lens)


def test_a_bad_value_is_refused_and_the_last_good_lens_stays(bench: Workbench) -> None:
    undo_steps = bench.lens
    assert not bench.edit(RADIUS, "number", "0")
    assert bench.refused[RADIUS].startswith("surface 2, radius_mm: a radius of 0 is not a surface")
    assert bench.lens is undo_steps
    assert bench.edit(RADIUS, "number", "-12.1")
    assert bench.refused == {}


def test_the_newest_state_wins(bench: Workbench) -> None:
    for k in range(200):
        bench.edit(RADIUS, "number", str(-12.0 - 0.001 * k), "drag")
    made: list[float] = []
    bench.listen(lambda: made.append(bench.analysis.lens.surfaces[1].radius_mm or 0.0))
    wait(lambda: bench.analysis.lens == bench.lens and bench.analysis.settled)
    assert len(set(made)) < 20
    assert made[-1] == pytest.approx(-12.199)
    bench.undo()
    assert bench.lens.surfaces[1].radius_mm == -12.0


def test_a_slow_analysis_of_an_earlier_state_does_not_replace_a_settled_one(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    (rays, names), *others = bench_module.STAGES
    is_started, may_end = threading.Event(), threading.Event()

    def slow(request: AnalysisRequest, settled: bool) -> LensAnalysis:
        found = rays(request, settled=settled)
        if threading.current_thread().name == "analysis":
            is_started.set()
            assert may_end.wait(120.0)
        return found

    monkeypatch.setattr(bench_module, "STAGES", ((slow, names), *others))
    bench.edit("surface.1.semi_diameter_mm", "number", "0.04")
    assert is_started.wait(120.0)
    bench.undo()
    settled = bench.settle()
    assert not settled.reasons
    may_end.set()
    bench.close()
    for thread in threading.enumerate():
        if thread.name == "analysis":
            thread.join(120.0)
    assert bench.analysis is settled


def test_saving_is_asked_for(bench: Workbench) -> None:
    bench.edit(RADIUS, "number", "-12.2")
    assert not bench.is_saved
    assert load_design(bench.document.path).surfaces[1].radius_mm == -12.0
    bench.save()
    assert bench.is_saved
    assert load_design(bench.document.path) == bench.lens


def test_edits_outlive_the_process(bench: Workbench, tmp_path: Path) -> None:
    bench.edit(RADIUS, "number", "-12.2")
    wait(lambda: bool(bench.autosave and bench.autosave.read().get("tables")))
    again = Workbench(bench.document.path, "", Autosave(bench.document.path, tmp_path / "aside"))
    assert again.lens == bench.lens
    assert not again.is_saved


def test_who_stopped_listening_is_not_told(bench: Workbench) -> None:
    calls: list[int] = []
    end = bench.listen(lambda: calls.append(1))
    end()
    end()
    bench.notify()
    assert calls == []


def test_what_if_is_of_the_lens(bench: Workbench) -> None:
    bench.set_what_if(WhatIf({"lens.tilt_x_deg": 0.1, "element 2.tilt_x_deg": 0.1}))
    assert set(bench.what_if.of(bench.lens).values) == {"lens.tilt_x_deg"}
    wait(lambda: bool(bench.analysis.pupils))
    assert threading.active_count() < 20


def test_results_of_an_earlier_lens_have_a_reason(bench: Workbench) -> None:
    good = bench.settle()
    assert good.settled
    assert good.reasons == {}
    bench.edit("surface.1.semi_diameter_mm", "number", "0.04")
    bad = bench.settle()
    assert bad.check is good.check
    assert set(bad.reasons) == {"check", "pupils", "patch"}
    assert all("ray" in why for why in bad.refused)
    bench.undo()
    assert bench.settle().reasons == {}


def test_a_grade_that_cannot_be_used_has_a_reason_that_stays(bench: Workbench) -> None:
    bench.grade = "none.toml"
    assert "none.toml" in bench.settle().reasons["built"]
    bench.edit(RADIUS, "number", "-12.1")
    assert "none.toml" in bench.settle().reasons["built"]
    bench.grade = ""
    assert bench.settle().reasons == {}


def test_an_unexpected_error_is_a_reason_for_every_result(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("broken")

    monkeypatch.setattr("studio.model.analysis.layout_of", broken)
    bench.request_update()
    wait(lambda: len(bench.analysis.reasons) == 5)
    assert "ZeroDivisionError: broken" in bench.analysis.refused[0]
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_another_design_is_opened_and_edits_of_the_first_stay(bench: Workbench, tmp_path: Path) -> None:
    first = bench.document.path
    bench.edit(RADIUS, "number", "-12.2")
    other = Path(shutil.copy(DESIGNS / "moulded_pair.toml", tmp_path / "other.toml"))
    bench.open(other)
    assert bench.lens == load_design(other)
    assert bench.is_saved
    assert not bench.editing.undo_steps
    bench.open(first)
    assert bench.lens.surfaces[1].radius_mm == -12.2
    with pytest.raises(InputError, match="none"):
        bench.open(tmp_path / "none.toml")
    assert bench.document.path == first
