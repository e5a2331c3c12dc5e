"""Common parts of panes: their workbench, updates after changes, jobs, messages and escaped text."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
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


class Guarded(pn.Column):
    """Contents of a pane, which are greyed under the reason if they do not belong to the present lens.

    Parameters
    ----------
    bench
        Workbench of the pane.
    contents
        What the pane shows.
    names
        Names of the results that it shows, see :data:`studio.model.analysis.RESULTS`.
    """

    def __init__(self, bench: Workbench, contents: Any, *names: str) -> None:
        self.note = pn.pane.HTML("", visible=False, margin=0, sizing_mode="stretch_width", styles=_OVER)
        self.contents = pn.Column(contents, sizing_mode="stretch_width", margin=0)
        self.names = names
        super().__init__(
            self.note, self.contents, sizing_mode="stretch_width", margin=0, styles={"position": "relative"}
        )
        self.reason = ""
        follow(bench, self, lambda: self.show(bench.analysis.reasons))

    def show(self, reasons: Mapping[str, str]) -> None:
        """Grey the contents if there is a reason for one of their results."""
        reason = next((reasons[name] for name in self.names if name in reasons), "")
        if reason == self.reason:
            return
        self.reason = reason
        self.note.param.update(
            object=f'<div class="stale" role="status"><b>Not of this lens</b> {text(reason)}</div>',
            visible=bool(reason),
        )
        self.contents.styles = _GREY if reason else {}


_OVER = {"position": "absolute", "z-index": "3", "inset": "0 0 auto"}
_GREY = {"opacity": "0.3", "filter": "grayscale(1)"}


def message_pane() -> pn.pane.HTML:
    """Return an empty pane for messages."""
    return pn.pane.HTML("", sizing_mode="stretch_width", margin=0)


def message(markup: str, is_bad: bool = False) -> str:
    """Return the markup of a message; that of a failure is marked."""
    kind = ' class="miss"' if is_bad else ""
    return f'<div class="text-block"><p{kind}>{markup}</p></div>'


def bind(bench: Workbench, widget: Any, read: Callable[[], Any], write: Callable[[Any], None]) -> None:
    """Keep the value of a widget equal to a setting of the workbench, on all pages."""

    def on_value(event: Any) -> None:
        if event.new != read():
            write(event.new)
            bench.notify()

    def update() -> None:
        if widget.value != (value := read()):
            widget.value = value

    widget.param.watch(on_value, "value")
    follow(bench, widget, update)


def explanation(title: str, *sentences: str) -> str:
    """Return the markup that a tab without results shows: what it is for, and an example."""
    body = "".join(f"<p>{text(sentence)}</p>" for sentence in sentences)
    return f'<div class="text-block empty"><h3>{text(title)}</h3>{body}</div>'


class JobPane:
    """Buttons that start and stop a job of a pane, and a message about it.

    Parameters
    ----------
    bench
        Workbench of the pane.
    job
        Function that returns the last job of the workbench; None before the first.
    run, cancel
        Labels of the buttons.

    A handler of a button changes the workbench alone and notifies it. The page is updated afterwards, when
    its document is locked.
    """

    def __init__(
        self, bench: Workbench, job: Callable[[], Job | None], run: str, cancel: str = "Stop"
    ) -> None:
        self.bench = bench
        self._job = job
        self.run = pn.widgets.Button(name=run, button_type="primary", align="end")
        self.cancel = pn.widgets.Button(name=cancel, disabled=True, align="end")
        self.message = message_pane()
        self.cancel.on_click(self._cancel)

    @property
    def job(self) -> Job | None:
        """Last job."""
        return self._job()

    @property
    def is_running(self) -> bool:
        """True while the job runs."""
        return self.job is not None and self.job.state == "running"

    def _cancel(self, _: object) -> None:
        if self.job is not None:
            self.job.cancel()

    def enable_buttons(self) -> None:
        """Enable the button that is of use now."""
        if self.run.disabled is not self.is_running:
            self.run.disabled, self.cancel.disabled = self.is_running, not self.is_running

    def show_message(self, markup: str) -> None:
        """Replace the message, unless it is shown already."""
        if self.message.object != markup:
            self.message.object = markup

    def show_error(self, error: Exception) -> None:
        """Show why a job cannot start."""
        self.message.object = message(text(error), is_bad=True)
