"""Panes with sliders: all values of the lens, and its deviations from the design."""

from __future__ import annotations

from typing import Any

import param

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.editing import with_stop, with_surface_after, without_surface
from studio.model.values import Value, glasses_like, parsed, values_of
from studio.model.whatif import DeviationRange, WhatIf, deviations_of
from studio.panes.common import HERE, ScriptPart, bench_of, follow


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

    def on_message(message: dict[str, Any]) -> None:
        if "search" in message:
            pane.glasses = glasses_like(str(message["search"]), bench.lens)
        elif "action" in message:
            _change_surfaces(bench, str(message["action"]), str(message["group"]))
        else:
            bench.edit(*(str(message[k]) for k in ("key", "kind", "text", "gesture")))

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


def what_if(lens: Workbench | Lens) -> ValueTable:
    """Return sliders for deviations: decenter and tilt of the lens or an element, temperature, radii."""
    bench = bench_of(lens)

    def on_message(message: dict[str, Any]) -> None:
        if message.get("action") == "reset":
            bench.set_what_if(WhatIf())
        elif "key" in message:
            key = str(message["key"])
            try:
                value = parsed("number", str(message["text"])) or 0.0
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
                    "unit": deviation.unit,
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
    return pane


def _group_of(deviation: DeviationRange) -> str:
    if deviation.parameter in ("radius_percent", "temperature_c"):
        return "radii and heat"
    return deviation.target


def _change_surfaces(bench: Workbench, action: str, group: str) -> None:
    index = int(group.rpartition(" ")[2]) - 1
    change = {"add": with_surface_after, "remove": without_surface, "stop": with_stop}[action]
    first = f"surface.{index}.radius_mm"
    bench.change(f"{action} {group}", lambda tables: change(tables, index), first)


def _row(lens: Lens, value: Value) -> dict[str, Any]:
    note, actions = "", []
    if value.group.startswith("surface "):
        index = int(value.group.split()[1]) - 1
        shape = lens.surfaces[index].shape_class.NAME
        note = "stop" if index == lens.stop_index else ""
        note = " · ".join(part for part in (note, "" if shape == "conic" else shape) if part)
        if index != lens.stop_index:
            actions.append(["stop", "stop", f"Make {value.group} the stop"])
        actions.append(["add", "+", f"Add a surface behind {value.group}"])
        if len(lens.surfaces) > 1:
            actions.append(["remove", "−", f"Remove {value.group}"])
    return {
        "key": value.key,
        "group": value.group,
        "label": value.label,
        "unit": value.unit.replace("um", "µm"),
        "text": value.text,
        "number": value.number,
        "low": value.low,
        "high": value.high,
        "step": value.step,
        "kind": value.kind,
        "note": note,
        "actions": actions,
    }
