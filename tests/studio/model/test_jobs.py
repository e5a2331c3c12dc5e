"""Work in a process of its own: lines, result, failure, and being stopped."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from lensdesign.errors import InputError
from studio.model.jobs import Job


def doubled(value: int, report: Callable[[str], None]) -> int:
    report("one")
    report("two")
    return 2 * value


def refused(report: Callable[[str], None]) -> None:
    raise InputError("not like this")


def lost(report: Callable[[str], None]) -> None:
    os._exit(3)


def endless(report: Callable[[str], None]) -> None:
    report("begun")
    time.sleep(600.0)


def large(report: Callable[[str], None]) -> bytes:
    report("begun")
    return bytes(10_000_000)


def wait(until: Callable[[], bool]) -> None:
    end = time.monotonic() + 120.0
    while not until():
        assert time.monotonic() < end
        time.sleep(0.01)


def gone(process: Path) -> bool:
    """Whether a process of /proc has ended."""
    try:
        return ") Z " in (process / "stat").read_text()
    except OSError:
        return True


def test_lines_come_before_the_result() -> None:
    calls: list[int] = []
    job = Job(doubled, (21,), lambda: calls.append(1))
    wait(lambda: job.state != "running")
    assert (job.state, job.result, job.lines) == ("done", 42, ["one", "two"])
    assert len(calls) == 3


@pytest.mark.parametrize(("work", "said"), [(refused, "not like this"), (lost, "ended before its work")])
def test_what_fails_says_so(work: Callable[..., None], said: str) -> None:
    job = Job(work, (), lambda: None)
    wait(lambda: job.state != "running")
    assert job.state == "failed"
    assert said in job.result


def test_what_is_killed_within_a_message_has_failed() -> None:
    """The result is larger than what a pipe holds, and nobody reads it before the process is killed."""

    def kill() -> None:
        if job.state == "running":
            time.sleep(0.5)
            job._process.kill()
            job._process.join()

    job = Job(large, (), lambda: kill())
    wait(lambda: job.state != "running")
    assert job.state == "failed"
    assert "ended before its work" in job.result


def test_what_is_cancelled_ends() -> None:
    job = Job(endless, (), lambda: None)
    wait(lambda: job.progress == "begun")
    job.cancel()
    assert job.state == "cancelled"
    wait(lambda: not job._process.is_alive())
    assert job.state == "cancelled"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc on this system")
def test_what_a_killed_parent_began_ends() -> None:
    here = Path(__file__)
    code = (
        f"import sys, time; sys.path.insert(0, {str(here.parent)!r}); from {here.stem} import Job, endless\n"
        "job = Job(endless, (), lambda: print(job._process.pid, flush=True))\n"
        "time.sleep(600.0)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        process = Path("/proc") / parent.stdout.readline().strip()
        assert process.exists()
        parent.kill()
    wait(lambda: gone(process))
