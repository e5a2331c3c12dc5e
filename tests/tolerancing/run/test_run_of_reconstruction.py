"""A study of the whole chain: slices, decenter and tilt together, killed, resumed, estimated and reported."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import stored_rows

from lensdesign import scaled
from lensdesign.files.design import save_design
from tolerancing.merits.reconstruction import matrices
from tolerancing.report.report import report_data, report_of
from tolerancing.run.estimate import estimate_run
from tolerancing.run.run import run_study
from tolerancing.run.tasks import Task
from tolerancing.store.store import open_store
from tolerancing.study.files import load_study

TRIALS = 8
SCRIPT = Path(stored_rows.__file__).with_name("run_into_store.py")
STUDY = """
title = "the whole chain on a twin"
design = "twin.toml"
trials = 8
seed = 5
sensitivity = false

[[perturbation]]
target = "lens"
parameter = "decenter_y_mm"
distribution = "uniform"
half_width = 0.001

[[perturbation]]
target = "lens"
parameter = "tilt_x_deg"
distribution = "uniform"
half_width = 0.1

[[perturbation]]
target = "reconstruction"
parameter = "slices"
distribution = "discrete"
values = [2, 6]
"""
MERIT = """
[[merit]]
name = "{figure}_{name}"
kind = "reconstruction"
figure = "{figure}"
field_mm = [0.0, {height}]
line_widths_um = [0.775]
region_mm = 0.03
reconstruction_engine = "slices"
slices = 6
iterations = 10
at_least = 0.5
"""
SWEEP = """
[[sweep]]
name = "slices"
target = "reconstruction"
parameter = "slices"
values = [2, 6]
merits = ["correlation_axis"]
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory, paper_lens):
    folder = tmp_path_factory.mktemp("chain")
    save_design(scaled(paper_lens, 1 / 16), folder / "twin.toml")
    text = STUDY + SWEEP
    for name, height in (("axis", 0.0), ("field", 0.06)):
        text += "".join(MERIT.format(figure=f, name=name, height=height) for f in ("correlation", "contrast"))
    (folder / "study.toml").write_text(text)
    return folder / "study.toml"


@pytest.fixture(scope="module")
def unbroken(study):
    path = study.with_name("unbroken.db")
    run_study(load_study(study), path, workers=1)
    return path


def test_all_vary_together_and_matter(unbroken):
    with open_store(unbroken) as store:
        results, steps = store.trials(), store.steps()
    assert len(results) == TRIALS
    assert np.all(np.isfinite(results.scores))
    assert set(results.values[:, 2]) == {2.0, 6.0}
    assert np.all(np.ptp(results.values[:, :2], axis=0) > 0.0)
    assert np.all(np.ptp(results.scores, axis=0) > 1e-3)
    few, many = (s.scores["correlation_axis"] for s in steps if s.series == "slices")
    assert few != many


def test_a_run_that_is_killed_goes_on_and_makes_the_same_rows(study, unbroken, tmp_path):
    path = tmp_path / "killed.db"
    fewer = str(TRIALS - 2)  # so that trials are missing, though they ended before the run is killed
    command = [sys.executable, SCRIPT, study, path, "1", fewer]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    for _ in range(5):  # two steps and three trials are stored
        assert run.stdout.readline()
    os.killpg(run.pid, signal.SIGKILL)
    run.communicate()
    with open_store(path) as store:
        assert 2 <= store.trial_count() < TRIALS
    run_study(load_study(study), path, workers=1)
    assert stored_rows.rows(path) == stored_rows.rows(unbroken)


def test_what_is_set_up_for_each_number_of_slices_is_told(study, monkeypatch):
    """Matrices of slices are made once in a process, and each worker makes its own."""
    own = matrices.Matrices()
    for module in ("matrices", "line_imaging_chain"):
        monkeypatch.setattr(f"tolerancing.merits.reconstruction.{module}.MATRICES", own)
    monkeypatch.setattr(matrices.Matrices, "seconds", lambda self, engine: 1000.0 * engine.slices)
    loaded = load_study(study)
    lacking = {"trials": TRIALS, "high_fidelity": 0}
    found = [estimate_run(loaded, lacking, [], workers, 1).seconds for workers in (1, 2)]
    # Trial 0 has been scored for its time, and its number of slices is set up by now at both field points.
    assert found[0] == pytest.approx(2 * 1000.0 * 6, rel=0.01) or found[0] == pytest.approx(
        2 * 1000.0 * 2, rel=0.01
    )
    assert found[1] == pytest.approx(found[0], rel=0.01)
    swept = estimate_run(
        loaded, {"trials": 0, "high_fidelity": 0}, [Task(series=0, step=k) for k in range(2)], 1, 1
    )
    assert swept.seconds == pytest.approx(found[0], rel=0.01)


def test_the_report_shows_both_figures_by_field_point(unbroken):
    with open_store(unbroken) as store:
        report = report_of(report_data(store), written="now")
    texts = [getattr(block, "text", "") for block in report.blocks]
    at = texts.index("Reconstruction: correlation and contrast")
    panels = report.blocks[at + 2].panels
    assert [panel.alt.split(" over ")[1] for panel in panels] == [
        "lens_decenter_y_mm, by field point",
        "lens_tilt_x_deg, by field point",
        "reconstruction_slices, by field point",
    ]
    for panel in panels:
        titles = [axis.get_title(loc="left") for axis in panel.figure.axes]
        assert titles == ["correlation", "contrast of 0.775 µm lines"]
        names = {text.get_text() for legend in panel.figure.legends for text in legend.get_texts()}
        assert {"on the axis, trials", "0.06 mm off the axis, trials"} <= names
    slices = panels[2].figure.axes[0]
    assert "on the axis, all else nominal" in {line.get_label() for line in slices.lines}
