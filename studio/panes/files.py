"""Boxes and buttons that choose files of this machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import param

from studio.model.files import listing, recent
from studio.panes.common import HERE, ScriptPart

PICKER_SCRIPT = (HERE / "picker.js").read_text(encoding="utf-8")
PICKER_STYLE = (HERE / "picker.css").read_text(encoding="utf-8")


class PickerPart(ScriptPart):
    """A component with the dialog for files; `kind` names the list of recent files."""

    listing = param.Dict(default={}, doc="Folder that the dialog shows, see `studio.model.files.listing`.")
    recent = param.List(default=[], doc="Paths that were chosen last.")

    def __init__(self, kind: str, received: Callable[[dict[str, Any]], None], **params: Any) -> None:
        super().__init__(received, **params)
        self._kind = kind
        self.recent = recent(kind)

    def _handle_msg(self, data: Any) -> None:
        if isinstance(data, dict) and "list" in data:
            suffixes = [str(one) for one in data.get("suffixes") or ()]
            # Another page, or a command, may have chosen files since.
            self.param.update(recent=recent(self._kind), listing=listing(str(data["list"]), suffixes))
        else:
            super()._handle_msg(data)


class FileChoice(PickerPart):
    """A box for a path with a button that opens the dialog, and buttons for actions on a chosen file.

    Parameters
    ----------
    kind
        Name of the list of recent files.
    on_action
        Called with the action and the chosen path.
    """

    label = param.String(default="", doc="Label of the box; empty: buttons only.")
    value = param.String(default="", doc="Path in the box.")
    placeholder = param.String(default="", doc="Example in an empty box.")
    mode = param.Selector(default="open", objects=["open", "save", "folder"], doc="Purpose of the path.")
    suffixes = param.List(default=[], doc="Suffixes of files that are shown.")
    suggestion = param.String(default="", doc="Path that is suggested for saving.")
    actions = param.List(default=[], doc="Action, text, mode and hint of each button.")

    _esm = PICKER_SCRIPT + (HERE / "files.js").read_text(encoding="utf-8")
    _stylesheets = [(HERE / "files.css").read_text(encoding="utf-8"), PICKER_STYLE]  # noqa: RUF012 - as Panel has it

    def __init__(
        self,
        kind: str,
        on_action: Callable[[str, str], None] | None = None,
        actions: Sequence[Sequence[str]] = (),
        **params: Any,
    ) -> None:
        def received(message: dict[str, Any]) -> None:
            if on_action is not None and "action" in message and message.get("path"):
                on_action(str(message["action"]), str(message["path"]))

        params = {"margin": (5, 10)} | params
        super().__init__(kind, received, actions=[list(one) for one in actions], **params)
