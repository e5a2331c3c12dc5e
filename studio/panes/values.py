"""Panes with sliders: all values of the lens, and its deviations from the design."""

from __future__ import annotations

from typing import Any

import panel as pn
import param

from lensdesign.common.text import unit_symbol
from lensdesign.errors import InputError, TransferLensError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.editing import with_stop, with_surface_after, without_surface
from studio.model.files import remember, typed_path
from studio.model.values import Value, glasses_like, parsed, values_of
from studio.model.whatif import DeviationRange, WhatIf, deviations_of, read_what_if
from studio.panes.common import HERE, ScriptPart, bench_of, follow, message, message_pane, text
from studio.panes.files import FileChoice


class ValueTable(ScriptPart):
    """Rows of values with sliders."""

    rows = param.List(default=[], doc="One mapping for each row.")
    refused = param.Dict(default={}, doc="Reason for the rejection of a value, by its key.")
    glasses = param.List(default=[], doc="Suggested names of glasses.")

    _esm = HERE / "values.js"
    _stylesheets = [HERE / "values.css"]  # noqa: RUF012 - as Panel has it


def surfaces(lens: Workbench | Lens) -> ValueTable:
    """Return the editable table of surfaces, object, sensor and wavelengths."""
    bench = bench_of(lens)

    def on_message(sent: dict[str, Any]) -> None:
        if "search" in sent:
            pane.glasses = glasses_like(str(sent["search"]), bench.lens)
        elif "action" in sent:
            change_surfaces(bench, str(sent["action"]), str(sent["group"]))
        else:
            bench.edit(*(str(sent[k]) for k in ("key", "kind", "text", "gesture")))

    pane = ValueTable(on_message, sizing_mode="stretch_width", margin=0)

    def update() -> None:
        found = values_of(bench.editing.now.tables, bench.opened, bench.lens)
        rows = [_row(bench.lens, value) for value in found]
        pane.param.update(
            **{
                name: new
                for name, new in (("rows", rows), ("refused", dict(bench.refused)))
                if getattr(pane, name) != new
            }
        )

    follow(bench, pane, update)
    return pane


def what_if(lens: Workbench | Lens) -> pn.Column:
    """Return sliders for deviations (decenter, tilt, temperature, radii), which can be saved and loaded."""
    bench = bench_of(lens)
    note = message_pane()
    files = FileChoice(
        STATES,
        lambda action, path: note.param.update(object=_transferred(bench, action, path)),
        (
            ("load", "Load…", "open", "Load the deviations of a mounted lens (JSON)"),
            ("save", "Save…", "save", "Save the deviations for wavesim image --state (JSON)"),
        ),
        suffixes=[".json"],
        suggestion=str(bench.document.path.with_name(f"{bench.document.path.stem}_state.json")),
        margin=(8, 12, 4, 12),
    )

    def on_message(sent: dict[str, Any]) -> None:
        if sent.get("action") == "reset":
            bench.set_what_if(WhatIf())
        elif "key" in sent:
            key = str(sent["key"])
            try:
                value = parsed("number", str(sent["text"])) or 0.0
                changed = bench.what_if.with_value(key, value)
                changed.state(bench.lens)
            except InputError as error:
                pane.refused = {key: str(error)}
                return
            pane.refused = {}
            bench.set_what_if(changed)

    pane = ValueTable(on_message, sizing_mode="stretch_width", margin=0)

    def update() -> None:
        rows: list[dict[str, Any]] = []
        for deviation in deviations_of(bench.lens, bench.what_if):
            value = bench.what_if.values.get(deviation.key, 0.0)
            largest = max(deviation.largest, abs(value))
            rows.append(
                {
                    "key": deviation.key,
                    "group": _group_of(deviation),
                    "label": deviation.label,
                    "unit": unit_symbol(deviation.unit),
                    "text": f"{value:.6g}",
                    "number": value,
                    "low": -largest,
                    "high": largest,
                    "step": deviation.step,
                    "kind": "number",
                    "note": "",
                    "actions": [["reset", "reset", "Set all deviations to 0"]]
                    if deviation.target == "lens"
                    else [],
                }
            )
        order = list(dict.fromkeys(row["group"] for row in rows))
        rows.sort(key=lambda row: order.index(row["group"]))
        if pane.rows != rows:
            pane.rows = rows

    follow(bench, pane, update)
    return pn.Column(files, note, pane, sizing_mode="stretch_width", margin=0)


STATES = "states"
"""Name of the list of recent files with deviations."""


def _transferred(bench: Workbench, action: str, name: str) -> str:
    """Load or save the deviations, and return the markup of a message."""
    try:
        path = typed_path(name)
        if action == "load":
            bench.set_what_if(read_what_if(path, bench.lens))
            done = f"loaded {path}"
        elif path.exists():
            raise InputError(f"{path}: exists already; give another name")
        else:
            bench.what_if.write(bench.lens, path)
            done = f"saved {path}; use it with wavesim image --state"
    except TransferLensError as error:
        return message(text(error), is_bad=True)
    remember(STATES, path)
    return message(text(done))


def _group_of(deviation: DeviationRange) -> str:
    if deviation.parameter in ("radius_percent", "temperature_c"):
        return "radii and heat"
    return deviation.target


def change_surfaces(bench: Workbench, action: str, group: str) -> None:
    """Apply an action of :func:`surface_actions` to a group such as "surface 1"."""
    index = int(group.rpartition(" ")[2]) - 1
    change = {"add": with_surface_after, "remove": without_surface, "stop": with_stop}[action]
    first = f"surface.{index}.radius_mm"
    bench.change(f"{action} {group}", lambda tables: change(tables, index), first)


def surface_actions(lens: Lens, index: int) -> list[list[str]]:
    """Return action, label and hint of the buttons of a surface (index from 0)."""
    name = f"surface {index + 1}"
    actions = [] if index == lens.stop_index else [["stop", "stop", f"Make {name} the stop"]]
    actions.append(["add", "+", f"Add a surface behind {name}"])
    if len(lens.surfaces) > 1:
        actions.append(["remove", "−", f"Remove {name}"])
    return actions


def _row(lens: Lens, value: Value) -> dict[str, Any]:
    note, actions = "", list[list[str]]()
    if value.group.startswith("surface "):
        index = int(value.group.split()[1]) - 1
        shape = lens.surfaces[index].shape_class.NAME
        note = "stop" if index == lens.stop_index else ""
        note = " · ".join(part for part in (note, "" if shape == "conic" else shape) if part)
        actions = surface_actions(lens, index)
    return {
        "key": value.key,
        "group": value.group,
        "label": value.label,
        "unit": unit_symbol(value.unit),
        "text": value.text,
        "number": value.number,
        "low": value.low,
        "high": value.high,
        "step": value.step,
        "kind": value.kind,
        "note": note,
        "actions": actions,
    }
