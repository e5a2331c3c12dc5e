"""How a run is cut into tasks."""

import pytest

from tolerancing.run.tasks import Task, all_tasks, chunks, missing_steps, missing_trials
from tolerancing.store.store import create_store, open_store
from tolerancing.study.files import load_study


@pytest.mark.parametrize(
    ("planned", "size", "workers"), [(500, 16, 2), (500, 16, 1), (40, 5, 2), (7, 1, 3), (3, 16, 2), (1, 1, 1)]
)
def test_chunks_hold_each_trial_once_and_end_small(planned, size, workers):
    parts = chunks(planned, size, workers)
    assert [trial for part in parts for trial in part] == list(range(planned))
    sizes = [len(part) for part in parts]
    assert max(sizes) <= size
    if workers > 1:
        assert all(n <= max(size // 4, 1) for n in sizes[-workers:])
        assert sizes == sorted(sizes, reverse=True)
    else:
        assert sizes[:-1] == [size] * (len(sizes) - 1)


@pytest.mark.parametrize("workers", [1, 2])
def test_all_tasks_are_those_that_a_new_store_lacks(write_study, full_study, tmp_path, workers):
    loaded = load_study(write_study(full_study))
    create_store(loaded, tmp_path / "store", {}, 40)
    size = 5 if workers == 2 else 10
    with open_store(tmp_path / "store") as store:
        lacking = [
            *missing_steps(loaded.study, store),
            *missing_trials(store, 40, size, workers, in_order=True),
        ]
    assert list(all_tasks(loaded.study, 40, workers)) == lacking
    assert lacking[-1] == Task(trials=(39,)) or workers == 1
