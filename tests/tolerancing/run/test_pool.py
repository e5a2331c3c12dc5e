"""Processes of a run: started beside the first scores, deaf to stops meanwhile, gone when it is refused."""

import signal
from multiprocessing import active_children

import pytest

import tolerancing.run.run as module
from lensdesign import InputError
from tolerancing.run.pool import Processes
from tolerancing.run.run import run_study
from tolerancing.run.workers import follow_parent
from tolerancing.study.files import load_study

PYTHON_MERIT = """
[[merit]]
name = "mine"
kind = "python"
function = "mine.py:nothing"
at_most = 1.0
"""


@pytest.fixture
def there(monkeypatch):
    """How many processes there are when the nominal lens has been scored."""
    counts, scored = [], module.first_scores

    def counted(*study):
        result = scored(*study)
        counts.append(len(active_children()))
        return result

    monkeypatch.setattr(module, "first_scores", counted)
    return counts


@pytest.mark.parametrize(("workers", "number"), [(1, 0), (2, 2)])
def test_workers_start_while_the_nominal_lens_is_scored(
    write_study, ray_study, tmp_path, there, workers, number
):
    loaded = load_study(write_study("sensitivity = false\n" + ray_study))
    assert run_study(loaded, tmp_path / "store", workers=workers).trials_run == 40
    assert there == [number]
    assert not active_children()


def test_workers_end_where_the_nominal_lens_cannot_be_scored(write_study, full_study, tmp_path):
    text = full_study.replace("line_widths_um = [1.0]", "line_widths_um = [50.0]")
    with pytest.raises(InputError, match="um wide"):
        run_study(load_study(write_study(text)), tmp_path / "store", workers=2)
    assert not active_children()


def test_python_is_run_by_no_worker_before_the_nominal_lens_is_scored(
    write_study, ray_study, tmp_path, monkeypatch
):
    (tmp_path / "mine.py").write_text("def nothing(trial):\n    return 0.0\n")
    loaded = load_study(write_study("sensitivity = false\n" + ray_study + PYTHON_MERIT))
    submitted, submit = [], Processes.submit

    def noted(self, work, *arguments, **named):
        submitted.append(work.__name__)
        return submit(self, work, *arguments, **named)

    monkeypatch.setattr(Processes, "submit", noted)
    run_study(loaded, tmp_path / "store", workers=2, trials=4)
    assert "get_warm" not in submitted
    assert submitted[:2] == ["make_ready", "first_scores"]


def test_processes_do_not_hear_of_stops_while_they_start():
    with Processes(1, follow_parent) as one:
        blocked = one.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
    assert {signal.SIGINT, signal.SIGHUP} <= blocked
    assert not {signal.SIGINT, signal.SIGHUP} & signal.pthread_sigmask(signal.SIG_BLOCK, [])
