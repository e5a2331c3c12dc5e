"""Progress without a terminal: lines on standard error."""

from __future__ import annotations

import threading

import pytest

from lensdesign.common import progress
from lensdesign.common.progress import progress_count, progress_text


def lines_of(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], show: object) -> list[str]:
    """Return the lines that are printed until there are two."""
    monkeypatch.setattr(progress, "LINE_INTERVAL_S", 0.01)
    printed = threading.Semaphore(0)
    monkeypatch.setattr(progress, "visible", lambda text: printed.release() or text)
    show(lambda: [printed.acquire(timeout=10.0) for _ in range(2)])  # type: ignore[operator]
    return capsys.readouterr().err.splitlines()


def test_counts_are_printed_with_and_without_a_total(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def show(wait: object) -> None:
        with progress_count("trials") as count:
            count.advance(3, 10, "trials")
            count.advance(2, 10, "trials")
            wait()  # type: ignore[operator]

    assert "s: trials: 5 of 10" in lines_of(monkeypatch, capsys, show)[-1]

    def without(wait: object) -> None:
        with progress_count("lenses") as count:
            count.advance(7, None, "lenses")
            wait()  # type: ignore[operator]

    assert lines_of(monkeypatch, capsys, without)[-1].endswith("s: lenses: 7")

    def not_counted(wait: object) -> None:
        with progress_count("starting") as count:
            count.update(0, None, "effect of each distance")
            wait()  # type: ignore[operator]

    assert lines_of(monkeypatch, capsys, not_counted)[-1].endswith("s: effect of each distance")


def test_texts_are_printed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def show(wait: object) -> None:
        with progress_text("searching") as status:
            status.update("start 2")
            wait()  # type: ignore[operator]

    assert lines_of(monkeypatch, capsys, show)[-1].endswith("s: start 2")


def test_the_remaining_time_is_that_of_the_stage(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stage that ended early is followed by one whose steps take ten times as long."""
    clock = [0.0]
    monkeypatch.setattr(progress, "now", lambda: clock[0])

    def show(wait: object) -> None:
        with progress_count("starting") as count:
            steps = [(0, 12, 1.0), (1, 12, 1.0), (2, 12, 5.0), (0, None, 5.0), (0, 20, 10.0), (1, 20, 10.0)]
            for done, total, seconds in steps:
                count.update(done, total, "stage")
                clock[0] += seconds
            count.update(2, 20, "standard deviations")
            wait()  # type: ignore[operator]

    last = lines_of(monkeypatch, capsys, show)[-1]
    assert "standard deviations: 2 of 20, about 180 s more" in last
