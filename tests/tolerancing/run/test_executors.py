"""A Dask cluster: the same rows as here, workers that die, and plain words where it cannot be used."""

import logging
import os
import signal
import socket
import sys
from dataclasses import replace

import numpy as np
import pytest
from dask_cluster import Cluster
from stored_rows import rows

import lensdesign.common.clusters as module
import tolerancing.run.workers as workers
from lensdesign import InputError
from lensdesign.common.clusters import toolkit_version
from tolerancing.run.run import RunError, run_study
from tolerancing.run.tasks import Task
from tolerancing.run.workers import StudyParcel, work_in_cluster
from tolerancing.store.store import open_store
from tolerancing.study.files import load_study

distributed = pytest.importorskip("distributed")

PYTHON_MERIT = """
[[merit]]
name = "mine"
kind = "python"
function = "mine.py:slow_distance"
at_most = 0.05
"""

MINE = """
import time

def slow_distance(trial):
    time.sleep(0.004)
    return abs(trial.deltas["lens_decenter_y_mm"])
"""


@pytest.fixture
def loaded(write_study, full_study, tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    return load_study(write_study(full_study + PYTHON_MERIT), trust=True)


@pytest.fixture
def rays(write_study, ray_study):
    """Of the toolkit's own merits, which need no process of their own at the start."""
    return load_study(write_study(ray_study))


@pytest.fixture
def slow_rays(write_study, ray_study, tmp_path):
    """Trials that take a few milliseconds, so that a worker dies in the middle of a run."""
    (tmp_path / "mine.py").write_text(MINE)
    return load_study(write_study("sensitivity = false\n" + ray_study + PYTHON_MERIT), trust=True)


@pytest.fixture
def cluster(tmp_path_factory):
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    yield made
    made.close()


def test_a_worker_that_is_killed_half_way_changes_no_row(loaded, cluster, tmp_path):
    first, _ = cluster.worker(), cluster.worker()

    def progress(done, total):
        if done > 50:
            first.kill()

    outcome = run_study(loaded, tmp_path / "cluster", trials=150, cluster=cluster.address, progress=progress)
    assert (outcome.trials_run, outcome.workers, first.poll() is not None) == (150, 0, True)
    run_study(loaded, tmp_path / "here", trials=150, workers=1)
    assert rows(tmp_path / "cluster") == rows(tmp_path / "here")


def test_workers_of_another_version_are_refused(rays, cluster, tmp_path, monkeypatch, caplog):
    cluster.worker()
    monkeypatch.setattr(module, "toolkit_version", lambda: "99.0")
    with pytest.raises(InputError, match=rf"worker tcp.* has version {toolkit_version()} .* 99\.0"):
        run_study(rays, tmp_path / "store", cluster=cluster.address)
    assert caplog.text == ""


def test_parts_of_a_field_travel_without_a_warning(cluster, recwarn):
    cluster.worker()
    with module.open_cluster(cluster.address) as connected:
        part = np.zeros(2**21, np.complex64)  # 17 MB
        assert connected.submit(np.size, part).result() == part.size
    assert [str(one.message) for one in recwarn if "large graph" in str(one.message)] == []


def test_a_cluster_without_workers_is_refused(rays, cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "CONNECT_SECONDS", 4.0)
    with pytest.raises(InputError, match=r"no worker.*4 s"):
        run_study(rays, tmp_path / "store", cluster=cluster.address)


def test_no_scheduler_there_is_told_within_the_time_and_quietly(rays, tmp_path, monkeypatch, capfd):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setattr(module, "CONNECT_SECONDS", 1.0)
    before = logging.getLogger("distributed").level
    with pytest.raises(InputError, match=f"{address}: no Dask scheduler answers"):
        run_study(rays, tmp_path / "store", cluster=address)
    assert "".join(capfd.readouterr()) == ""
    assert logging.getLogger("distributed").level == before


def test_missing_package_is_told(rays, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match="extra cluster"):
        run_study(rays, tmp_path / "store", cluster="tcp://127.0.0.1:1")


def test_a_cluster_has_its_own_workers(rays, tmp_path):
    with pytest.raises(InputError, match="give one or the other"):
        run_study(rays, tmp_path / "store", cluster="tcp://127.0.0.1:1", workers=2)


@pytest.fixture
def parcel(loaded):
    levels = {merit.label: merit.used_level for merit in loaded.study.all_merits}
    return StudyParcel(toolkit_version(), loaded.name, dict(loaded.files), loaded.fingerprint, levels, True)


def test_a_parcel_is_unpacked_once_and_needs_no_file_of_its_sender(parcel, tmp_path, monkeypatch):
    for path in tmp_path.glob("*.*"):
        path.unlink()
    monkeypatch.setattr(workers, "_unpacked", {})
    results = work_in_cluster(parcel, Task(trials=(0, 1)))
    assert len(results) == 2
    monkeypatch.setattr(workers, "load_from_files", None, raising=False)
    assert len(work_in_cluster(parcel, Task(trials=(2,)))) == 1
    assert len(workers._unpacked) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [({"toolkit_version": "99.0"}, r"worker on .* has version .* 99\.0"), ({"fingerprint": "x"}, "indices")],
)
def test_a_worker_refuses_what_it_would_score_otherwise(parcel, monkeypatch, change, message):
    monkeypatch.setattr(workers, "_unpacked", {})
    monkeypatch.setattr(workers, "_by_thread", type("Empty", (), {})())
    with pytest.raises(InputError, match=message):
        work_in_cluster(replace(parcel, **change), Task(trials=(0,)))


def test_when_the_last_worker_dies_the_run_says_so_and_ends(
    slow_rays, cluster, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(module, "REPORT_SECONDS", 0.5)
    monkeypatch.setattr(module, "WAIT_SECONDS", 2.0)
    only = cluster.worker()

    def progress(done, total):
        if done > 100:
            only.kill()

    with pytest.raises(RunError, match="last worker is gone, and none has joined within 2 s"):
        run_study(slow_rays, tmp_path / "store", trials=400, cluster=cluster.address, progress=progress)
    assert "the cluster's last worker is gone; waiting 2 s" in capsys.readouterr().err
    with open_store(tmp_path / "store") as store:
        held = store.trial_count()
    assert 0 < held < 400
    assert run_study(slow_rays, tmp_path / "store", trials=400, workers=2).trials_run == 400 - held


def test_a_worker_that_comes_in_time_goes_on(slow_rays, cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "WAIT_SECONDS", 60.0)
    first, killed = cluster.worker(), []

    def progress(done, total):
        if done > 100 and not killed:
            first.kill()
            killed.append(cluster.worker())

    outcome = run_study(slow_rays, tmp_path / "store", trials=200, cluster=cluster.address, progress=progress)
    assert (outcome.trials_run, len(killed)) == (200, 1)


def test_a_scheduler_that_hangs_ends_the_run_with_a_message(slow_rays, cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "SILENT_SCHEDULER_SECONDS", 2.0)
    monkeypatch.setattr(module, "ANSWER_SECONDS", 0.5)
    cluster.worker()

    def progress(done, total):
        if done > 50:
            os.kill(cluster.processes[0].pid, signal.SIGSTOP)

    with pytest.raises(RunError, match=r"scheduler has not answered for 2 s.*repeat the command"):
        run_study(slow_rays, tmp_path / "store", trials=4000, cluster=cluster.address, progress=progress)
    with open_store(tmp_path / "store") as store:
        assert 50 < store.trial_count() < 4000


def test_a_worker_that_hangs_is_reported_until_it_is_ended(slow_rays, cluster, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(module, "SILENT_WORKER_SECONDS", 3.0)
    first, _ = cluster.worker(), cluster.worker()
    reports = []

    def end_worker(self, now, report=module.Cluster._report_silent_workers):
        report(self, now)
        reports.append(capsys.readouterr().err)
        if reports[-1]:
            first.kill()

    monkeypatch.setattr(module.Cluster, "_report_silent_workers", end_worker)

    def progress(done, total):
        if done > 20:
            os.kill(first.pid, signal.SIGSTOP)

    outcome = run_study(slow_rays, tmp_path / "store", trials=150, cluster=cluster.address, progress=progress)
    assert outcome.trials_run == 150
    assert [text.startswith("worker tcp://127.0.0.1:") for text in reports if text] == [True]


@pytest.mark.parametrize("hangs", ["worker", "scheduler"])
def test_a_cluster_that_hangs_from_the_start_is_refused(rays, cluster, tmp_path, monkeypatch, hangs):
    workers = cluster.worker(), cluster.worker()
    with module.open_cluster(cluster.address) as connected:
        while connected.threads() < len(workers):
            pass
    monkeypatch.setattr(module, "CONNECT_SECONDS", 3.0)
    monkeypatch.setattr(module, "ANSWER_SECONDS", 1.0)
    process = workers[0] if hangs == "worker" else cluster.processes[0]
    os.kill(process.pid, signal.SIGSTOP)
    message = (
        r"no answer within 3 s from tcp://[^,]*: end" if hangs == "worker" else "no Dask scheduler answers"
    )
    with pytest.raises(InputError, match=message):
        run_study(rays, tmp_path / "store", cluster=cluster.address)
