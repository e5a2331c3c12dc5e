"""What panes share."""

from __future__ import annotations

import asyncio
import threading
import urllib.request
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from queue import Queue
from typing import Any

import panel
import pytest
from bokeh.document import Document
from panel.io.server import get_server
from places import DESIGNS

from lensdesign import load_design
from studio.model.bench import Workbench
from studio.panes.common import follow

ROUNDS, THREADS, SECONDS = 25, 4, 30.0


@pytest.fixture
def bench() -> Iterator[Workbench]:
    bench = Workbench(load_design(DESIGNS / "paper_singlet.toml"))
    yield bench
    bench.close()


@contextmanager
def served(page: Callable[[], object]) -> Iterator[str]:
    """The address of a server in a thread of its own."""
    started: Queue[Any] = Queue()

    def run() -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        server = get_server(page, port=0, show=False, start=False)
        started.put(server)
        server.start()
        server.io_loop.start()
        server.stop()

    thread = threading.Thread(target=run)
    thread.start()
    server = started.get(timeout=SECONDS)
    try:
        yield f"http://localhost:{server.port}/"
    finally:
        server.io_loop.add_callback(server.io_loop.stop)
        thread.join(SECONDS)


def test_a_page_is_touched_in_its_own_thread_and_sees_the_last_change(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown, rounds = 0, 0
    caught_up = threading.Event()
    pages: set[int] = set()
    asked: set[int] = set()
    add = Document.add_next_tick_callback

    def recorded(document: Document, callback: object) -> object:
        asked.add(threading.get_ident())
        return add(document, callback)

    monkeypatch.setattr(Document, "add_next_tick_callback", recorded)

    def page() -> panel.pane.Markdown:
        pages.add(threading.get_ident())
        pane = panel.pane.Markdown("")

        def update() -> None:
            pane.object = str(shown)
            if shown == rounds * THREADS:
                caught_up.set()

        follow(bench, pane, update)
        return pane

    with served(page) as address:
        urllib.request.urlopen(address, timeout=SECONDS).read()
        asked.clear()
        with ThreadPoolExecutor(THREADS) as threads:
            for rounds in range(1, ROUNDS + 1):
                caught_up.clear()
                list(threads.map(lambda _: bench.notify(), range(THREADS)))
                shown = rounds * THREADS
                bench.notify()
                assert caught_up.wait(SECONDS)
    assert asked == pages
