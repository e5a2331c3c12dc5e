"""What a run has to do, and how long that takes by a clock of the test's own."""

import pytest

from tolerancing.run import estimate
from tolerancing.run.estimate import RunEstimate, estimate_run
from tolerancing.run.tasks import Task
from tolerancing.study.files import load_study
from wavesim.engines.slices import cost as slices_cost
from wavesim.metrics import resolving


@pytest.fixture
def ticking(monkeypatch):
    """Each trial takes a second, each high-fidelity trial ten."""
    now = [0.0]

    def takes(each):
        def score(_context, _study, trials, *_chosen):
            now[0] += each * len(trials)

        return score

    monkeypatch.setattr(estimate, "score_trials", takes(1.0))
    monkeypatch.setattr(estimate, "score_high_fidelity", takes(10.0))
    monkeypatch.setattr(estimate.time, "perf_counter", lambda: now[0])


def test_time_is_shared_by_the_workers(ticking, write_study, ray_study):
    loaded = load_study(write_study(ray_study))
    missing = {"trials": 100, "high_fidelity": 3}
    steps = [Task(series=0, step=step) for step in range(8)]
    alone = estimate_run(loaded, missing, steps, 1, 16)
    assert alone == RunEstimate(100, 8, 3, 1, 138.0)
    assert (
        alone.sentence == "100 trials, 8 steps, 3 trials by high-fidelity merits: about 2.3 min by 1 worker"
    )
    assert estimate_run(loaded, missing, steps, 4, 16).seconds == 34.5
    cluster = estimate_run(loaded, missing | {"high_fidelity": 0}, steps, 0, 16)
    assert cluster.sentence.endswith("about 108.0 s by one cluster worker as fast as this machine")


SLICES = """
[[slice_count]]
slices = [10, 400]
compensations = ["oblique"]
line_widths_um = [1.0]
"""


def test_a_step_of_many_slices_takes_longer_than_a_trial(ticking, monkeypatch, write_study, ray_study):
    monkeypatch.setattr(slices_cost, "fft_seconds", lambda *_: 0.1)
    for name in ("pass_seconds", "exponential_seconds"):
        monkeypatch.setattr(slices_cost, name, lambda *_: 0.0)
    monkeypatch.setattr(resolving, "_registering_seconds", lambda _: 0.0)
    loaded = load_study(write_study(ray_study + SLICES))
    counts = [type(part).__name__ for part in loaded.study.series].index("SliceCounts")
    missing = {"trials": 0, "high_fidelity": 0}
    few, many = (estimate_run(loaded, missing, [Task(series=counts, step=k)], 1, 16).seconds for k in (0, 1))
    # 390 slices more of both surfaces, there and back; both transforms of a slice count as one.
    assert many - few == pytest.approx(390 * 2 * 2 * 0.1)
