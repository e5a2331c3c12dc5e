"""Processes of a run: deaf to stops while they start, copies of a server in commands."""

import json
import signal
import subprocess
import sys

import pytest

from lensdesign.common.processes import Processes, follow_parent

ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="processes are started anew elsewhere")

COPIES = """
import json, os, signal, sys
from lensdesign.common.processes import Processes, follow_parent, start_ahead
start_ahead("tolerancing.run.forkserver_preload")
light = not {"numpy", "pydantic"} & set(sys.modules)
with Processes(2, follow_parent) as two:
    parents = {two.submit(os.getppid).result() for _ in range(4)}
    blocked = two.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
    loaded = two.submit(eval, "sorted(__import__('sys').modules)").result()
ends = []
for _ in range(5):
    with Processes(1, follow_parent) as one:
        one.submit(os._exit, 3).exception()
        ends.append(one.end())
print(json.dumps([light, os.getpid() in parents, len(parents), sorted(blocked), loaded, ends]))
"""


def test_processes_do_not_hear_of_stops_while_they_start():
    with Processes(1, follow_parent) as one:
        blocked = one.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
    assert {signal.SIGINT, signal.SIGHUP} <= blocked
    assert not {signal.SIGINT, signal.SIGHUP} & signal.pthread_sigmask(signal.SIG_BLOCK, [])


@ON_LINUX
def test_processes_of_a_command_are_copies_of_a_server_that_has_all_imported():
    done = subprocess.run([sys.executable, "-c", COPIES], capture_output=True, text=True, check=True)
    light, own, parents, blocked, loaded, ends = json.loads(done.stdout)
    assert done.stderr == ""
    assert light, "what is started ahead waits for no import"
    assert (own, parents) == (False, 1)
    assert {signal.SIGINT, signal.SIGHUP} <= set(blocked)
    assert {"numba", "scipy.special", "tolerancing.study.evaluate"} <= set(loaded)
    assert set(ends) == {"status 3"}


@ON_LINUX
def test_the_server_ends_with_a_command_that_is_killed_while_it_imports():
    psutil = pytest.importorskip("psutil")
    code = """
import os, sys, time
from lensdesign.common.processes import start_ahead
start_ahead("tolerancing.run.forkserver_preload")
print(flush=True)
time.sleep(60.0)
"""
    command = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    command.stdout.readline()
    servers = psutil.Process(command.pid).children(recursive=True)
    command.kill()
    command.communicate()
    assert len(servers) == 2  # with the tracker of what they share
    _, alive = psutil.wait_procs(servers, timeout=300.0)
    assert [process for process in alive if process.status() != psutil.STATUS_ZOMBIE] == []
