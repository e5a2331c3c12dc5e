"""Searches that are stopped, by their user or by a time limit, keep their best lens."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from places import DESIGNS, ROOT
from stopping import heeding

from lensdesign.common import deadlines
from lensdesign.files.design import load_design
from lensdesign.optimization import SearchInterrupted, check_against, load_specification, optimize
from lensdesign.optimization.problem import DesignProblem

SPEC = DESIGNS / "thinnest_singlet_spec.toml"

STOPPED = """
import os, sys
from lensdesign.optimization.problem import DesignProblem

trace, count = DesignProblem._traces, [0]


def counting(self, *arguments):
    count[0] += 1
    if count[0] == {number}:
        os.kill(os.getpid(), {signal})
    return trace(self, *arguments)


DesignProblem._traces = counting
sys.argv = ["lensdesign", *{arguments}]
from lensdesign.cli.commands import main

main()
"""


def stopped(number: int, sent: signal.Signals, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command that sends itself a signal at one of its traces."""
    code = STOPPED.format(number=number, signal=int(sent), arguments=[*map(str, arguments)])
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        preexec_fn=heeding,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )


@pytest.mark.parametrize(
    ("number", "sent", "status"),
    [(40, signal.SIGTERM, 143), (150, signal.SIGINT, 130), (400, signal.SIGTERM, 143)],
)
def test_an_interrupted_search_writes_its_best_lens(
    tmp_path: Path, number: int, sent: signal.Signals, status: int
) -> None:
    out = tmp_path / "best.toml"
    out.write_text("mine")
    ended = stopped(number, sent, "optimize", SPEC, "-o", out)
    assert ended.returncode == status, ended.stderr
    assert "Traceback" not in ended.stderr
    assert list(tmp_path.iterdir()) == [out]
    assert f"interrupted; {out} holds the best lens so far" in ended.stderr
    lens, asked = load_design(out), load_specification(SPEC)
    feasible = check_against(lens, asked).feasible
    assert ("which meets the specification" in ended.stderr) is feasible
    assert f"{lens.exit_vertex_z_mm:.6g} mm" in ended.stdout
    assert "an interrupt ended the search of N-BK7" in ended.stdout
    assert ended.stdout.endswith(f"wrote {out}\n")


@pytest.mark.parametrize(
    ("before", "sent", "status"), [(None, signal.SIGTERM, 143), ("mine", signal.SIGINT, 130)]
)
def test_an_interrupt_before_the_first_lens_writes_nothing(
    tmp_path: Path, before: str | None, sent: signal.Signals, status: int
) -> None:
    out = tmp_path / "best.toml"
    if before is not None:
        out.write_text(before)
    ended = stopped(1, sent, "optimize", SPEC, "-o", out)
    assert (ended.returncode, ended.stdout) == (status, ""), ended.stderr
    assert ended.stderr.splitlines()[-1] == "interrupted before a first lens was found"
    assert "Traceback" not in ended.stderr
    assert [path.read_text() for path in tmp_path.iterdir()] == ([] if before is None else [before])


@pytest.mark.parametrize("number", [3, 12])
def test_the_best_lens_is_no_worse_than_the_best_reported(
    monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    asked, lines, seen = load_specification(SPEC), [], [0]

    def improved(line: str) -> None:
        lines.append(line)
        seen[0] += 1

    trace = DesignProblem._traces

    def interrupted(self: DesignProblem, *arguments: Any) -> Any:
        if seen[0] >= number:
            seen[0] = -10_000
            raise KeyboardInterrupt
        return trace(self, *arguments)

    monkeypatch.setattr(DesignProblem, "_traces", interrupted)
    time = iter(range(10**9))
    monkeypatch.setattr(deadlines, "clock", lambda: float(next(time)))
    with pytest.raises(SearchInterrupted) as stop:
        optimize(asked, improved)
    found = stop.value.result
    met = [line.split(": ")[1] for line in lines if ", feasible," in line]
    reported = min((float(words.split(" ")[0]) for words in met), default=math.inf) * asked.exit_vertex_z_mm
    if found.feasible:
        assert found.lens.exit_vertex_z_mm == pytest.approx(reported, rel=2e-2)
    else:
        assert found.violations
    assert found.unfinished


@pytest.mark.parametrize("limit", [300.0, 3000.0])
def test_a_time_limit_is_kept_within_a_tenth(monkeypatch: pytest.MonkeyPatch, limit: float) -> None:
    """Time is counted in traces, and the check of the result takes a twentieth of it."""
    time, trace = [0.0], DesignProblem._traces

    def counting(self: DesignProblem, *arguments: Any) -> Any:
        time[0] += 1.0
        return trace(self, *arguments)

    monkeypatch.setattr(DesignProblem, "_traces", counting)
    monkeypatch.setattr(deadlines, "clock", lambda: time[0])
    asked = load_specification(SPEC)
    limits = asked.constraints.replaced(max_lens_thickness_mm=7.0)  # which cannot be met
    settings = asked.optimize.replaced(max_seconds=limit)
    found = optimize(asked.replaced(constraints=limits, optimize=settings))
    assert time[0] <= 1.1 * limit
    assert not found.feasible
    assert found.unfinished or any(one.cut for one in found.reach.limits)


def test_trials_that_do_not_fit_are_left_out_and_count_as_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = load_specification(DESIGNS / "as_built_spec.toml")
    limits = asked.constraints.replaced(min_yield=0.1)
    asked = asked.replaced(constraints=limits, optimize=asked.optimize.replaced(max_seconds=30.0, starts=1))
    time = [0.0]
    monkeypatch.setattr(deadlines, "clock", lambda: time[0])
    trials, made = type(asked.as_built).trials, []

    def slow(self: Any, lenses: Any, count: int, *more: Any) -> Any:
        time[0] += 0.1 * count * len(lenses)
        made.append(count)
        return trials(self, lenses, count, *more)

    def ended(self: DesignProblem, *arguments: Any) -> Any:
        time[0] += 0.1
        return trace(self, *arguments)

    trace = DesignProblem._traces
    monkeypatch.setattr(type(asked.as_built), "trials", slow)
    monkeypatch.setattr(DesignProblem, "_traces", ended)
    found = optimize(asked)
    assert max(made) == 20
    assert time[0] <= 33.0
    assert found.as_built is None
    assert not found.feasible
    assert any("before the trials" in sentence for sentence in found.unfinished)
    assert any(v.startswith("yield: not checked") for v in found.violations)
    assert math.isfinite(found.goal_value)
