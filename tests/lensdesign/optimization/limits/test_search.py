"""Limits of specifications that cannot be met: found from fresh starts, alike with every seed, and true."""

from __future__ import annotations

from typing import Any

import pytest
from small_searches import singlet_from_plate

from lensdesign.common import deadlines
from lensdesign.common.deadlines import deadline
from lensdesign.optimization.limits.limited_quantities import FIELD
from lensdesign.optimization.limits.search import LimitsInterrupted, find_limits
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification_check import check_against


def singlet(field_mm: float, aperture: float, **sensor: Any) -> Specification:
    own = {"pixel_pitch_um": 3.2, "pixels": [5472, 3648]}
    return singlet_from_plate(field_mm, aperture, "N-BK7", sensor=own | sensor)


def test_a_limit_far_below_what_is_asked_is_found() -> None:
    """A search from the nearest lens alone finds none here; the limit is two thirds of what is asked."""
    asked = singlet(4.0, 0.3)
    (one,) = find_limits(asked, seed=1, quantities=(FIELD,), most=1.0)
    assert one.reached == pytest.approx(2.718, rel=3e-3)
    assert one.ended
    assert one.starts >= 12
    assert not one.cut
    assert one.lens is not None
    assert check_against(one.lens, FIELD.changed(asked, one.reached)).feasible
    assert one.confidence.startswith(f"{one.starts} independent starts")


def test_a_deadline_leaves_a_limit_that_is_not_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time is counted in traces, so that the search ends at the same place on every machine."""
    time = counted(monkeypatch)
    with deadline(2000.0):
        (found,) = find_limits(singlet(4.0, 0.3), quantities=(FIELD,), most=1.0)
    assert found.cut == "max_seconds"
    assert found.confidence.startswith("not confirmed")
    assert time[0] < 1.1 * 2000.0


def test_an_interrupt_leaves_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    counted(monkeypatch, stop_at=1000)
    with pytest.raises(LimitsInterrupted) as stop:
        find_limits(singlet(4.0, 0.3), quantities=(FIELD,), most=1.0)
    (found,) = stop.value.limits
    assert found.cut == "interrupt"
    assert found.reached is not None
    assert found.reached < 2.73


def counted(monkeypatch: pytest.MonkeyPatch, stop_at: int | None = None) -> list[float]:
    """Have each trace of rays take a second; raise an interrupt at one of them."""
    time, trace = [0.0], DesignProblem._traces

    def counting(self: DesignProblem, *arguments: Any) -> Any:
        time[0] += 1.0
        if time[0] == stop_at:
            raise KeyboardInterrupt
        return trace(self, *arguments)

    monkeypatch.setattr(DesignProblem, "_traces", counting)
    monkeypatch.setattr(deadlines, "clock", lambda: time[0])
    return time
