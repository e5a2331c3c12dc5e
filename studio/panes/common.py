"""Common parts of panes: their workbench, updates after changes, and escaped text."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

from bokeh.io import curdoc
from panel.custom import JSComponent
from panel.io.document import hold
from tornado.ioloop import IOLoop

from lensdesign.common.text import visible
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench

HERE = Path(__file__).parent


class ScriptPart(JSComponent):
    """A component of the page with its own script, whose messages a function receives."""

    def __init__(self, received: Callable[[dict[str, Any]], None], **params: Any) -> None:
        super().__init__(**params)
        self._received = received

    def _handle_msg(self, data: Any) -> None:
        if isinstance(data, dict):
            self._received(data)


def bench_of(lens: Workbench | Lens) -> Workbench:
    """Return a workbench; a lens gets a new one, which starts to compute at once."""
    if isinstance(lens, Workbench):
        return lens
    bench = Workbench(lens)
    bench.request_update()
    return bench


def follow(bench: Workbench, owner: Any, update: Callable[[], None]) -> None:
    """Call `update` at once, and after each change of a workbench.

    All updates of a page after a change run in one callback of its document and are sent as one message.
    Changes before this callback are not queued.

    Parameters
    ----------
    bench
        Workbench to follow.
    owner
        Object that is updated; when it is deleted, the listener is removed.
    update
        Function that updates the owner.
    """
    document = curdoc()
    alive = weakref.ref(owner)
    if document.session_context is None:

        def on_change() -> None:
            if alive() is None:
                end()
            else:
                update()

        end = bench.listen(on_change)
    else:
        page_updates = _PAGE_UPDATES.get(document)
        if page_updates is None:
            page_updates = _PAGE_UPDATES[document] = _PageUpdates(document, bench)
        page_updates.updates.append(update)
    update()


class _PageUpdates:
    """Updates of one page after a change of its workbench."""

    def __init__(self, document: Any, bench: Workbench) -> None:
        self.updates: list[Callable[[], None]] = []
        self.document = weakref.ref(document)
        self.pending = False
        self.loop = IOLoop.current()
        end = bench.listen(lambda: self.loop.add_callback(self.schedule))
        document.on_session_destroyed(lambda _: end())

    def schedule(self) -> None:
        """Schedule the updates; must run in the server's thread, because Bokeh loses requests of others."""
        document = self.document()
        if document is not None and not self.pending:
            self.pending = True
            document.add_next_tick_callback(self.run_updates)

    def run_updates(self) -> None:
        self.pending = False
        with hold(self.document()):
            for update in self.updates:
                update()


_PAGE_UPDATES: weakref.WeakKeyDictionary[Any, _PageUpdates] = weakref.WeakKeyDictionary()


def text(value: object) -> str:
    """Return a value as escaped text for markup."""
    return escape(visible(str(value)))
