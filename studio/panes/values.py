"""Panes with sliders: all values of the lens, and its deviations from the design."""

from __future__ import annotations

from typing import Any

import param

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.editing import with_stop, with_surface_after, without_surface
from studio.model.values import Value, glasses_like, parsed, values_of
from studio.model.whatif import DeviationRange, WhatIf, amounts_of
from studio.panes.common import HERE, ScriptPart, bench_of, follow


class Values(ScriptPart):
    """Rows of values with sliders."""

    rows = param.List(default=[], doc="One mapping a row.")
    refused = param.Dict(default={}, doc="Reason for the rejection of a value, by its key.")
    glasses = param.List(default=[], doc="Suggested names of glasses.")

    _esm = HERE / "values.js"
    _stylesheets = [HERE / "values.css"]  # noqa: RUF012 - as Panel has it


def surfaces(lens: Workbench | Lens) -> Values:
    """Return the editable table of surfaces, object, sensor and wavelengths."""
    bench = bench_of(lens)

    def received(message: dict[str, Any]) -> None:
        if "search" in message:
            pane.glasses = glasses_like(str(message["search"]), bench.lens)
        elif "action" in message:
            _act(bench, str(message["action"]), str(message["group"]))
        else:
            bench.edit(*(str(message[k]) for k in ("key", "kind", "text", "gesture")))

    pane = Values(received, sizing_mode="stretch_width", margin=0)

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


def what_if(lens: Workbench | Lens) -> Values:
    """Return sliders for deviations: decenter and tilt of the lens or an element, temperature, radii."""
    bench = bench_of(lens)

    def received(message: dict[str, Any]) -> None:
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

    pane = Values(received, sizing_mode="stretch_width", margin=0)

    def update() -> None:
        rows: list[dict[str, Any]] = []
        for amount in amounts_of(bench.lens, bench.what_if):
            value = bench.what_if.values.get(amount.key, 0.0)
            most = max(amount.most, abs(value))
            rows.append(
                {
                    "key": amount.key,
                    "group": _group_of(amount),
                    "label": amount.label,
                    "unit": amount.unit,
                    "text": f"{value:.6g}",
                    "number": value,
                    "low": -most,
                    "high": most,
                    "step": amount.step,
                    "kind": "number",
                    "note": "",
                    "actions": [["reset", "reset", "Set all deviations to 0"]]
                    if amount.target == "lens"
                    else [],
                }
            )
        order = list(dict.fromkeys(row["group"] for row in rows))
        rows.sort(key=lambda row: order.index(row["group"]))
        if pane.rows != rows:
            pane.rows = rows

    follow(bench, pane, update)
    return pane


def _group_of(amount: DeviationRange) -> str:
    if amount.parameter in ("radius_percent", "temperature_c"):
        return "radii and heat"
    return amount.target


def _act(bench: Workbench, action: str, group: str) -> None:
    number = int(group.rpartition(" ")[2]) - 1
    change = {"add": with_surface_after, "remove": without_surface, "stop": with_stop}[action]
    first = f"surface.{number}.radius_mm"
    bench.change(f"{action} {group}", lambda tables: change(tables, number), first)


def _row(lens: Lens, value: Value) -> dict[str, Any]:
    note, actions = "", []
    if value.group.startswith("surface "):
        number = int(value.group.split()[1]) - 1
        shape = lens.surfaces[number].shape_class.NAME
        note = "stop" if number == lens.stop_index else ""
        note = " · ".join(part for part in (note, "" if shape == "conic" else shape) if part)
        if number != lens.stop_index:
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
