"""Signals that end a command: all alike, once, and leaving nothing unfinished."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from stopping import heeding

from lensdesign.common.interrupts import stoppable

COMMAND = """
import ctypes, sys, time
from lensdesign.common.console import make_app, run_app
from lensdesign.errors import atomic_path

app = make_app("a test")


@app.command()
def write() -> None:
    with atomic_path("out.txt") as path:
        path.write_text("half")
        print("ready", flush=True)
        {work}


@app.command()
def other() -> None:
    pass


run_app(app)
"""
WAIT = "time.sleep(600)"
UNWIND_SLOWLY = """
        try:
            time.sleep(600)
        finally:
            time.sleep({seconds})
"""
SWALLOW = """
        ctypes.CFUNCTYPE(None)(lambda: time.sleep(0.5))()
        time.sleep(600)
"""


def started(folder: Path, work: str) -> subprocess.Popen[str]:
    """A command at its work."""
    child = subprocess.Popen(
        [sys.executable, "-c", COMMAND.replace("{work}", work.strip()), "write"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heeding,
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    time.sleep(0.1)
    return child


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_all_signals_end_alike(tmp_path: Path, number: signal.Signals, status: int) -> None:
    child = started(tmp_path, WAIT)
    child.send_signal(number)
    assert child.communicate(timeout=600) == ("", "interrupted\n")
    assert child.returncode == status
    assert not list(tmp_path.iterdir())


def test_a_key_pressed_twice_does_not_disturb_unwinding(tmp_path: Path) -> None:
    child = started(tmp_path, UNWIND_SLOWLY.replace("{seconds}", "0.3"))
    for _ in range(3):
        child.send_signal(signal.SIGINT)
        time.sleep(0.02)
    assert child.communicate(timeout=600) == ("", "interrupted\n")
    assert child.returncode == 130
    assert not list(tmp_path.iterdir())


def test_a_later_signal_ends_what_does_not_unwind(tmp_path: Path) -> None:
    child = started(tmp_path, UNWIND_SLOWLY.replace("{seconds}", "600"))
    child.send_signal(signal.SIGHUP)
    time.sleep(1.3)
    child.send_signal(signal.SIGTERM)
    assert "before all had come to its end" in child.communicate(timeout=600)[1]
    assert child.returncode == 129
    assert not list(tmp_path.iterdir())


def test_an_interrupt_that_a_callback_swallows_comes_again(tmp_path: Path) -> None:
    child = started(tmp_path, SWALLOW)
    child.send_signal(signal.SIGINT)
    out, err = child.communicate(timeout=600)
    assert (child.returncode, out, err) == (130, "", "interrupted\n")
    assert not list(tmp_path.iterdir())


def test_other_faults_without_a_place_go_to_the_hook_that_was_there(monkeypatch: pytest.MonkeyPatch) -> None:
    class Faulty:
        def __del__(self) -> None:
            raise ValueError("at the end")

    told: list[str] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda fault: told.append(str(fault.exc_value)))
    before = sys.unraisablehook
    with stoppable():
        Faulty()
    assert told == ["at the end"]
    assert sys.unraisablehook is before


def test_what_nohup_has_a_command_ignore_it_ignores(tmp_path: Path) -> None:
    ignoring = "signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    code = f"import signal; {ignoring}\n" + COMMAND.replace("{work}", "time.sleep(0.5)")
    child = subprocess.Popen(
        [sys.executable, "-c", code, "write"], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    child.stdout.readline()
    child.send_signal(signal.SIGHUP)
    child.communicate(timeout=600)
    assert child.returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out.txt"]


STRING = "import signal; signal.raise_signal({})"
DESCRIPTOR = (
    "import signal\nclass Named:\n  def __set_name__(self, *_): signal.raise_signal({})\n"
    "class Own: a = Named()"
)


@pytest.mark.parametrize("code", [STRING, DESCRIPTOR])
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGHUP, 129)])
def test_what_python_makes_of_an_interrupt(
    tmp_path: Path, code: str, number: signal.Signals, status: int
) -> None:
    """It remembers a string of code that was left, and makes an error of what comes while a class is made."""
    (tmp_path / "stopped.py").write_text(
        "from lensdesign.common.interrupts import stoppable\n"
        f"with stoppable():\n    exec({code.format(int(number))!r})\n"
    )
    command = [sys.executable, "-m", "stopped"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, preexec_fn=heeding)
    assert (ended.returncode, ended.stdout, ended.stderr) == (status, "", "interrupted\n")


def test_another_error_stays_what_it_is(tmp_path: Path) -> None:
    (tmp_path / "failing.py").write_text(
        "from lensdesign.common.interrupts import stoppable\nwith stoppable():\n    raise ValueError('one')\n"
    )
    command = [sys.executable, "-m", "failing"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, preexec_fn=heeding)
    assert ended.returncode == 1
    assert ended.stderr.endswith("ValueError: one\n")
