"""Common parts of panes: their workbench, updates after changes, jobs, messages and escaped text."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import panel as pn
from bokeh.io import curdoc
from panel.custom import JSComponent
from panel.io.document import hold
from tornado.ioloop import IOLoop

from lensdesign.common.text import visible
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.jobs import Job

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


def follow_result(
    bench: Workbench, owner: Any, result: Callable[[], Any], draw: Callable[[Any], None]
) -> None:
    """Follow a workbench with a function that draws a result, which is called when the result has changed.

    Parameters
    ----------
    bench, owner
        See :func:`follow`.
    result
        Function that returns the present result; None: nothing to draw yet.
    draw
        Function that draws a result.
    """
    last: Any = None

    def update() -> None:
        nonlocal last
        found = result()
        if found is not None and found is not last:
            last = found
            draw(found)

    follow(bench, owner, update)


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


def message_pane() -> pn.pane.HTML:
    """Return an empty pane for messages."""
    return pn.pane.HTML("", sizing_mode="stretch_width", margin=0)


def message(markup: str, is_bad: bool = False) -> str:
    """Return the markup of a message; that of a failure is marked."""
    kind = ' class="miss"' if is_bad else ""
    return f'<div class="text-block"><p{kind}>{markup}</p></div>'


class JobPane:
    """Buttons that start and stop a job of a pane, and a message about it.

    Parameters
    ----------
    bench
        Workbench of the pane.
    run, cancel
        Labels of the buttons.
    """

    def __init__(self, bench: Workbench, run: str, cancel: str = "Stop") -> None:
        self.bench = bench
        self.job: Job | None = None
        self.run = pn.widgets.Button(name=run, button_type="primary", align="end")
        self.cancel = pn.widgets.Button(name=cancel, disabled=True, align="end")
        self.message = message_pane()
        self.cancel.on_click(lambda _: self.job and self.job.cancel())

    @property
    def is_running(self) -> bool:
        """True while the job runs."""
        return self.job is not None and self.job.state == "running"

    def enable_buttons(self) -> None:
        """Enable the button that is of use now."""
        if self.run.disabled is not self.is_running:
            self.run.disabled, self.cancel.disabled = self.is_running, not self.is_running

    def show_error(self, error: Exception) -> None:
        """Show why a job cannot start."""
        self.message.object = message(text(error), is_bad=True)
