"""How a run is cut into tasks."""

import pytest

from tolerancing.run.tasks import chunks


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
