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
from lensdesign.common import interrupts
from lensdesign.common.console import make_app, run_app
from lensdesign.common.atomic_files import atomic_path

app = make_app("a test", {})
{times}


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
            print("within", flush=True)
            time.sleep(600)
        finally:
            print("unwinding", flush=True)
            sys.stdin.read()
"""
SWALLOW = """
        ctypes.CFUNCTYPE(None)(lambda: (print("within", flush=True), time.sleep(600)))()
        time.sleep(600)
"""


def started(
    folder: Path, work: str, repeat_seconds: float = 600.0, grace_seconds: float = 600.0
) -> subprocess.Popen[str]:
    """A command at its work; later signals and slow ends are judged by the times that a test needs."""
    times = f"interrupts.REPEAT_SECONDS, interrupts.GRACE_SECONDS = {repeat_seconds}, {grace_seconds}"
    child = subprocess.Popen(
        [sys.executable, "-c", COMMAND.replace("{work}", work.strip()).replace("{times}", times), "write"],
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heeding,
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    return child


def said(child: subprocess.Popen[str]) -> str:
    """The next line of a command."""
    assert child.stdout is not None
    return child.stdout.readline()


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
    child = started(tmp_path, UNWIND_SLOWLY)
    assert said(child) == "within\n"
    child.send_signal(signal.SIGINT)
    assert said(child) == "unwinding\n"
    for _ in range(3):
        child.send_signal(signal.SIGINT)
        time.sleep(0.02)  # signals that wait together would count as one
    assert child.communicate(timeout=600) == ("", "interrupted\n")
    assert child.returncode == 130
    assert not list(tmp_path.iterdir())


def test_a_later_signal_ends_what_does_not_unwind(tmp_path: Path) -> None:
    child = started(tmp_path, UNWIND_SLOWLY, repeat_seconds=0.0)
    assert said(child) == "within\n"
    child.send_signal(signal.SIGHUP)
    assert said(child) == "unwinding\n"
    child.send_signal(signal.SIGTERM)
    assert child.wait(timeout=600) == 129
    assert child.communicate()[1] == "interrupted; ended without an orderly stop\n"
    assert not list(tmp_path.iterdir())


def test_what_does_not_unwind_in_time_is_ended(tmp_path: Path) -> None:
    child = started(tmp_path, UNWIND_SLOWLY, grace_seconds=0.2)
    assert said(child) == "within\n"
    child.send_signal(signal.SIGTERM)
    assert child.wait(timeout=600) == 143
    assert child.communicate()[1] == "interrupted; ended without an orderly stop\n"
    assert not list(tmp_path.iterdir())


def test_an_interrupt_that_a_callback_swallows_comes_again(tmp_path: Path) -> None:
    child = started(tmp_path, SWALLOW)
    assert said(child) == "within\n"
    child.send_signal(signal.SIGINT)
    out, err = child.communicate(timeout=600)
    assert (child.returncode, out, err) == (130, "", "interrupted\n")
    assert not list(tmp_path.iterdir())


def test_other_faults_without_a_place_go_to_the_hook_that_was_there(monkeypatch: pytest.MonkeyPatch) -> None:
    class Faulty:
        def __del__(self) -> None:
            raise ValueError("at the end")

    calls: list[str] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda fault: calls.append(str(fault.exc_value)))
    before = sys.unraisablehook
    with stoppable():
        Faulty()
    assert calls == ["at the end"]
    assert sys.unraisablehook is before


def test_what_nohup_has_a_command_ignore_it_ignores(tmp_path: Path) -> None:
    ignoring = "signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    command = COMMAND.replace("{work}", "sys.stdin.read()").replace("{times}", "")
    code = f"import signal; {ignoring}\n{command}"
    child = subprocess.Popen(
        [sys.executable, "-c", code, "write"],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert said(child) == "ready\n"
    child.send_signal(signal.SIGHUP)
    child.communicate(timeout=600)
    assert child.returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out.txt"]


STRING = "import signal; signal.raise_signal({})"
DESCRIPTOR = (
    "import signal\nclass Named:\n  def __set_name__(self, *_): signal.raise_signal({})\n"
    "class Own: a = Named()"
)

LIBRARY = (
    "import signal\ntry: signal.raise_signal({})\n"
    "except BaseException: raise ImportError('a part of the library is missing')"
)

COMPILED_LIBRARY = (
    "import signal\ntry: signal.raise_signal({})\n"
    "except BaseException: pass\n"
    "raise ValueError('a part of the library cannot be built: KeyboardInterrupt')"
)


@pytest.mark.parametrize("code", [STRING, DESCRIPTOR, LIBRARY, COMPILED_LIBRARY])
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


def test_an_error_of_the_orderly_stop_is_told(tmp_path: Path) -> None:
    (tmp_path / "stopped.py").write_text(
        "import signal\n"
        "from lensdesign.common.interrupts import stoppable\n"
        "from lensdesign.errors import InputError\n"
        "with stoppable():\n"
        "    try: signal.raise_signal(signal.SIGINT)\n"
        "    except KeyboardInterrupt: pass\n"
        "    raise InputError('the best so far cannot be written')\n"
    )
    command = [sys.executable, "-m", "stopped"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, preexec_fn=heeding)
    assert "the best so far cannot be written" in ended.stderr


def test_another_error_stays_what_it_is(tmp_path: Path) -> None:
    (tmp_path / "failing.py").write_text(
        "from lensdesign.common.interrupts import stoppable\nwith stoppable():\n    raise ValueError('one')\n"
    )
    command = [sys.executable, "-m", "failing"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, preexec_fn=heeding)
    assert ended.returncode == 1
    assert ended.stderr.endswith("ValueError: one\n")
