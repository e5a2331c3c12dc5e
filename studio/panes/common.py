"""What panes share: a workbench of whatever is given, updates in the page's own turn, text as text."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

from lensdesign.common.text import visible
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench

HERE = Path(__file__).parent


def asset(name: str) -> str:
    """The text of a file of this room."""
    return (HERE / name).read_text(encoding="utf-8")


def bench_of(given: Workbench | Lens) -> Workbench:
    """A workbench; of a lens, one of its own, which begins at once."""
    if isinstance(given, Workbench):
        return given
    bench = Workbench(given)
    bench.ask()
    return bench


def follow(bench: Workbench, owner: Any, update: Callable[[], None]) -> None:
    """Call `update` after changes of a bench, in the turn of the page that is being built; the newest only.

    Parameters
    ----------
    bench
        Whose changes.
    owner
        What is updated; when it is gone, so is what was set up here.
    update
        What to do. It is called at once, too.
    """
    from bokeh.io import curdoc

    document = curdoc()
    served = document.session_context is not None
    pending = [False]
    alive = weakref.ref(owner)

    def turn() -> None:
        pending[0] = False
        if served:
            document.hold("combine")
        try:
            update()
        finally:
            if served:
                document.unhold()

    def heard() -> None:
        if alive() is None:
            end()
        elif not served:
            update()
        elif not pending[0]:
            pending[0] = True
            document.add_next_tick_callback(turn)

    end = bench.listen(heard)
    if served:
        document.on_session_destroyed(lambda _: end())
    update()


def text(value: object) -> str:
    """A value as text in markup, whatever it holds."""
    return escape(visible(str(value)))


def number(value: float, unit: str = "", digits: int = 4) -> str:
    """A number as the tables of the commands have it."""
    shown = f"{value:.4e}" if abs(value) >= 1e5 else f"{value:.{digits}f}"
    return f"{shown} {unit}".rstrip()


@cache
def component(name: str) -> str:
    """Source of a component of the page."""
    return asset(f"{name}.js")
