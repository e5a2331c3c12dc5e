"""What panes share: a workbench of whatever is given, updates in the page's own turn, text as text."""

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
    """A part of the page with its own script, whose messages a function receives."""

    def __init__(self, received: Callable[[dict[str, Any]], None], **params: Any) -> None:
        super().__init__(**params)
        self._received = received

    def _handle_msg(self, data: Any) -> None:
        if isinstance(data, dict):
            self._received(data)


def bench_of(given: Workbench | Lens) -> Workbench:
    """A workbench; of a lens, one of its own, which begins at once."""
    if isinstance(given, Workbench):
        return given
    bench = Workbench(given)
    bench.ask()
    return bench


def follow(bench: Workbench, owner: Any, update: Callable[[], None]) -> None:
    """Call `update` at once, and after changes of a bench in the turn of the page that is being built.

    All that a page has to update after a change is done in one turn, and sent as one message; changes that
    come before that turn are not queued.

    Parameters
    ----------
    bench
        Whose changes.
    owner
        What is updated; when it is gone, so is what was set up here.
    update
        What to do.
    """
    document = curdoc()
    alive = weakref.ref(owner)
    if document.session_context is None:

        def heard() -> None:
            if alive() is None:
                end()
            else:
                update()

        end = bench.listen(heard)
    else:
        turns = _TURNS.get(document)
        if turns is None:
            turns = _TURNS[document] = _Turns(document, bench)
        turns.updates.append(update)
    update()


class _Turns:
    """What a page does after a change of its bench."""

    def __init__(self, document: Any, bench: Workbench) -> None:
        self.updates: list[Callable[[], None]] = []
        self.document = weakref.ref(document)
        self.pending = False
        self.loop = IOLoop.current()
        end = bench.listen(lambda: self.loop.add_callback(self.ask))
        document.on_session_destroyed(lambda _: end())

    def ask(self) -> None:
        """In the server's thread: Bokeh loses what another asks for while the page holds its messages."""
        document = self.document()
        if document is not None and not self.pending:
            self.pending = True
            document.add_next_tick_callback(self.turn)

    def turn(self) -> None:
        self.pending = False
        with hold(self.document()):
            for update in self.updates:
                update()


_TURNS: weakref.WeakKeyDictionary[Any, _Turns] = weakref.WeakKeyDictionary()


def text(value: object) -> str:
    """A value as text in markup, whatever it holds."""
    return escape(visible(str(value)))


def number(value: float, unit: str = "", digits: int = 4) -> str:
    """A number as the tables of the commands have it."""
    shown = f"{value:.4e}" if abs(value) >= 1e5 else f"{value:.{digits}f}"
    return f"{shown} {unit}".rstrip()
