"""Processes of a run: deaf to stops while they start."""

import signal

from tolerancing.run.processes import Processes, follow_parent


def test_processes_do_not_hear_of_stops_while_they_start():
    with Processes(1, follow_parent) as one:
        blocked = one.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
    assert {signal.SIGINT, signal.SIGHUP} <= blocked
    assert not {signal.SIGINT, signal.SIGHUP} & signal.pthread_sigmask(signal.SIG_BLOCK, [])
