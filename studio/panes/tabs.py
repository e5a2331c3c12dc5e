"""Tabs of the page, of which one is shown."""

from __future__ import annotations

from typing import Any

import panel as pn
import param

from studio.panes.common import HERE, ScriptPart


class TabBar(ScriptPart):
    """Names of tabs, one of which is active."""

    names = param.List(default=[], doc="Names of the tabs.")
    active = param.Integer(default=0, doc="Index of the active tab.")
    label = param.String(default="", doc="Label for screen readers.")

    _esm = HERE / "tabs.js"
    _stylesheets = [HERE / "tabs.css"]  # noqa: RUF012 - as Panel has it


class Tabs(pn.Column):
    """Views under a bar of tabs.

    Parameters
    ----------
    label
        Label of the bar for screen readers.
    views
        Name and contents of each tab.
    """

    def __init__(self, label: str, *views: tuple[str, Any]) -> None:
        self.views = tuple(view for _, view in views)
        self.bar = TabBar(
            lambda _: None,
            names=[name for name, _ in views],
            label=label,
            sizing_mode="stretch_width",
            margin=0,
        )
        self.shown = pn.Column(self.views[0], sizing_mode="stretch_width", margin=0)
        super().__init__(self.bar, self.shown, sizing_mode="stretch_width", margin=0)
        self.bar.param.watch(lambda event: self.shown.__setitem__(0, self.views[event.new]), "active")
