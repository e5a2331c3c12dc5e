"""What a run has to do, and how long that takes by a clock of the test's own."""

import pytest

from tolerancing.run import estimate
from tolerancing.run.estimate import RunEstimate, estimate_run
from tolerancing.study.files import load_study


@pytest.fixture
def ticking(monkeypatch):
    """Each trial takes a second, each dear one ten."""
    now = [0.0]

    def takes(each):
        def score(_context, _study, trials, *_chosen):
            now[0] += each * len(trials)

        return score

    monkeypatch.setattr(estimate, "score_trials", takes(1.0))
    monkeypatch.setattr(estimate, "score_dear", takes(10.0))
    monkeypatch.setattr(estimate.time, "perf_counter", lambda: now[0])


def test_time_is_shared_by_the_workers(ticking, write_study, ray_study):
    loaded = load_study(write_study(ray_study))
    lacking = {"trials": 100, "steps": 8, "dear": 3}
    alone = estimate_run(loaded, lacking, 1, 16)
    assert alone == RunEstimate(100, 8, 3, 1, 138.0)
    assert alone.sentence == "100 trials, 8 steps, 3 trials by dear merits: about 2.3 min by 1 worker"
    assert estimate_run(loaded, lacking, 4, 16).seconds == 34.5
    cluster = estimate_run(loaded, lacking | {"dear": 0}, 0, 16)
    assert cluster.sentence.endswith("about 108.0 s by one worker of a cluster like this machine")
