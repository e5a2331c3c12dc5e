"""What all tests share."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from compile_once import take_turns
from cores import keep_to_own_cores
from hypothesis import HealthCheck, settings
from places import DESIGNS, GOLDEN, ROOT
from slow_tests import FixtureClock, Recorder, mark_slow

from lensdesign import Lens, load_design

# The first example compiles kernels, which takes longer than any deadline for a single one.
settings.register_profile(
    "transferlens", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("transferlens")

# `make commands` runs commands that take hours; 0 is no limit.
HUNG_SECONDS = 0 if os.environ.get("DOCUMENTED_COMMANDS") == "all" else 600

# Files that take longest: they come first, so that no worker is left with one when the others are done.
LONG = (
    "test_documented_commands.py",
    "wavesim/calibration/test_frame_calibration.py",
    "wavesim/reconstruction/diagnostics/",
    "lensdesign/optimization/test_search.py",
    "test_documentation.py",
    "test_gallery.py",
    "tolerancing/cli/",
    "test_perfect_benches.py",
    "test_site.py",
    "test_documented_figures.py",
    "lensdesign/optimization/limits/",
    "wavesim/engines/eikonal/test_on_cluster.py",
    "wavesim/engines/test_registry_memory.py",
    "paper/test_registry.py",
    "test_verdict_benchmark.py",
    "wavesim/cli/",
    "wavesim/calibration/",
    "wavesim/reconstruction/",
    "wavesim/sensor/test_recording.py",
    "tolerancing/run/",
    "test_frozen_results.py",
    "tolerancing/prediction/",
    "lensdesign/manufacture/drawing/test_predicted_yield.py",
    "lensdesign/exploration/",
    "tolerancing/store/test_store_trust.py",
    "test_examples.py",
    "test_notebooks.py",
    "studio/",
    "wavesim/",
)


def pytest_configure(config: pytest.Config) -> None:
    """Workers compile in turns, each on cores of its own."""
    recorded = os.environ.get("RECORD_SLOW_TESTS")
    if recorded:
        config.pluginmanager.register(FixtureClock())
    if "PYTEST_XDIST_WORKER" in os.environ:
        keep_to_own_cores()
        take_turns(Path(__file__))
    elif recorded:
        config.pluginmanager.register(Recorder(adds=recorded == "more"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first; otherwise in the order of the folders. Slow ones are marked."""
    mark_slow(items)

    def place(item: pytest.Item) -> int:
        path = item.path.relative_to(ROOT / "tests").as_posix()
        return next((i for i, long in enumerate(LONG) if path.startswith(long)), len(LONG))

    items.sort(key=place)


@pytest.fixture(autouse=True)
def no_hanging() -> Iterator[None]:
    """A test that hangs fails in the end; how fast one is, is for the benchmarks to say."""

    def hung(*_: object) -> None:
        raise TimeoutError(f"this test has not ended in {HUNG_SECONDS} s")

    before = signal.signal(signal.SIGALRM, hung)
    signal.alarm(HUNG_SECONDS)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="session")
def paper_design() -> Path:
    """The paper's lens, as a file."""
    return DESIGNS / "paper_singlet.toml"


@pytest.fixture(scope="session")
def paper_lens(paper_design: Path) -> Lens:
    """The paper's lens."""
    return load_design(paper_design)


@pytest.fixture(scope="session")
def golden() -> Path:
    """Folder of the golden data."""
    return GOLDEN
