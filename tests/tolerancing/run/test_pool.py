"""Workers of a run: what they score before it begins, and that they are gone when it is refused."""

from functools import partial
from multiprocessing import active_children

import pytest
from stored_rows import rows

import tolerancing.run.run as module
from lensdesign import InputError
from lensdesign.common.processes import Processes
from tolerancing.run.pool import LocalPool
from tolerancing.run.run import run_study
from tolerancing.run.tasks import Task
from tolerancing.store.store import open_store
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
    """How many processes there are when a store is made."""
    counts, made = [], module.create_store

    def counted(*study, **named):
        counts.append(len(active_children()))
        return made(*study, **named)

    monkeypatch.setattr(module, "create_store", counted)
    return counts


@pytest.mark.parametrize(("workers", "number"), [(1, 0), (2, 2)])
def test_workers_score_the_nominal_lens(write_study, ray_study, tmp_path, there, workers, number):
    loaded = load_study(write_study("sensitivity = false\n" + ray_study))
    assert run_study(loaded, tmp_path / "store", workers=workers).trials_run == 40
    assert there == [number]
    assert not active_children()


@pytest.fixture
def pool(write_study, full_study, copied_workers):
    with LocalPool(load_study(write_study(full_study)), 2) as pool:
        yield pool


def test_tasks_are_done_while_one_process_finds_out_what_must_be_known(pool):
    early, levels = [Task(series=0, step=0), Task(trials=(3, 4))], {"largest_spread_deg": "ray"}
    assert pool.run_with_prefetch(partial(int, "7"), iter(early), levels) == 7
    handed_out = dict(pool._prefetched)
    assert list(handed_out) == early
    assert pool._submit_task(early[1], levels) is handed_out[early[1]]
    assert handed_out[early[1]].result().trials == (3, 4)
    assert pool._submit_task(early[1], levels) is not handed_out[early[1]]


def test_what_is_early_already_keeps_nothing_else_from_coming_early(pool):
    first, more, levels = Task(series=0, step=0), Task(trials=(0,)), {"largest_spread_deg": "ray"}
    pool.run_with_prefetch(partial(int, "7"), [first], levels)
    pool.run_with_prefetch(partial(int, "8"), [first] * 10 + [more], levels)
    assert list(pool._prefetched) == [first, more]


def test_what_was_done_at_other_levels_is_not_taken(pool):
    task, cheapest = Task(trials=(0,)), {"largest_spread_deg": "ray"}
    pool.run_with_prefetch(partial(int, "7"), [task], cheapest)
    early = pool._prefetched[task]
    assert pool.run_with_prefetch(partial(int, "8"), (), {"largest_spread_deg": "wave"}) == 8
    assert pool._submit_task(task, cheapest) is not early


AUTO = """
[fidelity]
largest_difference = 0.0

[[merit]]
name = "undecided"
kind = "line_pair_contrast"
line_width_um = 1.0
orientation = "y"
patch_um = 10.0
at_least = 0.3
"""


@pytest.mark.usefixtures("copied_workers")
def test_levels_that_are_not_the_cheapest_make_the_rows_of_one_worker(write_study, ray_study, tmp_path):
    loaded = load_study(write_study("sensitivity = false\n" + ray_study + AUTO))
    for workers in (1, 2):
        run_study(loaded, tmp_path / str(workers), workers=workers, trials=6)
    assert rows(tmp_path / "1") == rows(tmp_path / "2")
    with open_store(tmp_path / "2") as store:
        assert [merit.level for merit in store.merits()] == ["ray", "wave"]


@pytest.mark.usefixtures("copied_workers")
def test_workers_end_where_the_nominal_lens_cannot_be_scored(write_study, full_study, tmp_path):
    text = full_study.replace("line_widths_um = [1.0]", "line_widths_um = [50.0]")
    with pytest.raises(InputError, match="µm wide"):
        run_study(load_study(write_study(text)), tmp_path / "store", workers=2)
    assert not active_children()


@pytest.mark.usefixtures("copied_workers")
def test_python_is_run_by_no_worker_before_the_nominal_lens_is_scored(
    write_study, ray_study, tmp_path, monkeypatch
):
    (tmp_path / "mine.py").write_text("def nothing(trial):\n    return 0.0\n")
    loaded = load_study(write_study("sensitivity = false\n" + ray_study + PYTHON_MERIT), trust=True)
    submitted, submit = [], Processes.submit

    def noted(self, work, *arguments, **named):
        submitted.append(getattr(work, "func", work).__name__)
        return submit(self, work, *arguments, **named)

    monkeypatch.setattr(Processes, "submit", noted)
    run_study(loaded, tmp_path / "store", workers=2, trials=4)
    assert submitted[:2] == ["prepare_merits", "levels_and_nominal_scores"]
    assert set(submitted[2:]) == {"work_local"}
