"""Table of surfaces: type, radius, thickness, glass, semi-diameter, conic and aspheric terms."""

from __future__ import annotations

from typing import Any

import param

from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import COEFFICIENTS
from lensdesign.lens.shapes.registry import SHAPES
from studio.model.bench import Workbench
from studio.model.editing import with_shape, with_term
from studio.model.searches import range_of, variables_of
from studio.model.values import Value, glasses_like, values_of
from studio.panes.common import HERE, ScriptPart, bench_of, follow
from studio.panes.values import change_surfaces, surface_actions


class SurfaceTable(ScriptPart):
    """Rows of surfaces with editable cells."""

    columns = param.List(default=[], doc="Headings of the columns.")
    rows = param.List(default=[], doc="One mapping for each row, with a cell for each column.")
    shapes = param.List(default=[], doc="Names of the shapes of a surface.")
    refused = param.Dict(default={}, doc="Reason for the rejection of a value, by its key.")
    glasses = param.List(default=[], doc="Suggested names of glasses.")

    _esm = HERE / "table.js"
    _stylesheets = [HERE / "table.css"]  # noqa: RUF012 - as Panel has it


def surface_table(lens: Workbench | Lens) -> SurfaceTable:
    """Return the table of surfaces; beside each value that a search may change stand a flag and its range."""
    bench = bench_of(lens)
    refused: dict[str, str] = {}

    def on_message(message: dict[str, Any]) -> None:
        refused.clear()
        if "search" in message:
            pane.glasses = glasses_like(str(message["search"]), bench.lens)
        elif "varied" in message:
            _vary(bench, str(message["varied"]), bool(message["is_varied"]))
        elif "bounds" in message:
            name = str(message["bounds"])
            reason = _set_range(bench, name, [str(one) for one in message["texts"]])
            if reason:
                refused[name] = reason
            bench.notify()
        elif "shape" in message:
            index, shape = int(message["surface"]), str(message["shape"])
            bench.change(f"surface {index + 1} {shape}", lambda tables: with_shape(tables, index, shape))
        elif message.get("action") == "term":
            index = int(str(message["group"]).rpartition(" ")[2]) - 1
            bench.change(f"add a term to surface {index + 1}", lambda tables: with_term(tables, index))
        elif "action" in message:
            change_surfaces(bench, str(message["action"]), str(message["group"]))
        else:
            bench.edit(*(str(message[k]) for k in ("key", "kind", "text")))

    pane = SurfaceTable(on_message, sizing_mode="stretch_width", margin=0, shapes=list(SHAPES))

    def update() -> None:
        columns, rows = _table(bench)
        new = {"columns": columns, "rows": rows, "refused": dict(bench.refused) | refused}
        changed = {name: value for name, value in new.items() if getattr(pane, name) != value}
        if changed:
            pane.param.update(**changed)

    follow(bench, pane, update)
    return pane


def _vary(bench: Workbench, name: str, is_varied: bool) -> None:
    session = bench.session
    others = tuple(one for one in session.varied if one != name)
    session.varied = (*others, name) if is_varied else others
    bench.notify()


def _set_range(bench: Workbench, name: str, texts: list[str]) -> str:
    """Set the range of a variable from texts; return the reason if it is not allowed."""
    known = variables_of(bench.lens).get(name)
    if known is None:
        return f"{name}: the lens has no such value"
    if not any(text.strip() for text in texts):
        bench.session.ranges.pop(name, None)
        return ""
    try:
        numbers = tuple(float(text) for text in texts)
    except ValueError:
        return f"{name}: a range must be numbers; leave it empty for the default"
    if len(numbers) != len(range_of(known)):
        return f"{name}: a range must have {len(range_of(known))} numbers"
    if len(numbers) == 2 and not numbers[0] < numbers[1]:
        return f"{name}: the first number of a range must be less than the second"
    if len(numbers) == 1 and not numbers[0] > 0.0:
        return f"{name}: the smallest radius must be above 0"
    bench.session.ranges[name] = numbers
    return ""


def _table(bench: Workbench) -> tuple[list[str], list[dict[str, Any]]]:
    lens, session = bench.lens, bench.session
    values = {value.key: value for value in values_of(bench.editing.now.tables, bench.opened, lens)}
    variables = variables_of(lens)
    keys = {key for surface in lens.surfaces for key in surface.shape_class.KEYS}
    across = [key for key in ("radius_x_mm", "conic_x") if key in keys]
    counts = {key: max(len(getattr(surface, key)) for surface in lens.surfaces) for key in COEFFICIENTS}

    def cell(key: str, label: str, name: str = "") -> dict[str, Any] | None:
        value = values.get(key)
        if value is None:
            return None
        variable = variables.get(name)
        return _cell(value, label) | (
            {}
            if variable is None
            else {
                "variable": name,
                "varied": name in session.varied,
                "range": [f"{one:.6g}" for one in session.ranges.get(name, range_of(variable))],
                "single": "smallest_radius_mm" in variable,
            }
        )

    columns = ["radius (mm)", "thickness (mm)", "glass", "semi-diam. (mm)", "conic"]
    columns += [{"radius_x_mm": "radius x (mm)", "conic_x": "conic x"}[key] for key in across]
    columns += ["norm. radius (mm)"] if "normalization_radius_mm" in keys else []
    for key, count in counts.items():
        shapes = dict.fromkeys(s.shape_class for s in lens.surfaces if key in s.shape_class.KEYS)
        for term in COEFFICIENTS[key][:count]:
            label = " or ".join(dict.fromkeys(shape.coefficient_label(term) for shape in shapes))
            columns.append(
                f"{'odd ' if key == 'odd_asphere' else ''}{label}{' (mm)' if key == 'q_mm' else ''}"
            )
    rows: list[dict[str, Any]] = [
        _row(
            "object",
            [
                None,
                cell("object.working_distance_mm", "working distance, mm", "working_distance_mm"),
                None,
                _text(f"{lens.half_field_mm:.6g}"),
            ],
            len(columns),
        )
    ]
    last = len(lens.surfaces) - 1
    for i, surface in enumerate(lens.surfaces):
        at, name = f"surface.{i}", f"surface {i + 1}"
        cells = [
            cell(f"{at}.radius_mm", f"{name} radius, mm", f"{name} radius_mm"),
            cell("sensor.plane_distances_mm.0", "distance of plane H1, mm")
            if i == last
            else cell(f"{at}.thickness_mm", f"{name} thickness, mm", f"{name} thickness_mm"),
            None if i == last else cell(f"{at}.material", f"{name} glass"),
            cell(f"{at}.semi_diameter_mm", f"{name} semi-diameter, mm"),
            cell(f"{at}.conic", f"{name} conic", f"{name} conic"),
        ]
        cells += [
            cell(f"{at}.{key}", f"{name} {label}", f"{name} {key}")
            for key, label in (("radius_x_mm", "radius x, mm"), ("conic_x", "conic x"))
            if key in across
        ]
        if "normalization_radius_mm" in keys:
            cells.append(cell(f"{at}.normalization_radius_mm", f"{name} normalization radius, mm"))
        actions = surface_actions(lens, i)
        shape = surface.shape_class
        for key, count in counts.items():
            own = getattr(surface, key)
            cells += [
                cell(f"{at}.{key}.{k}", f"{name} {shape.coefficient_label(term)}", f"{name} {term}")
                for k, term in zip(range(len(own)), COEFFICIENTS[key], strict=False)
            ]
            cells += [None] * (count - len(own))
            if key in shape.KEYS and len(own) < len(COEFFICIENTS[key]):
                label = shape.coefficient_label(COEFFICIENTS[key][len(own)])
                actions.append(["term", f"+ {label}", f"Add a term to {name}"])
        row = _row(name, cells, len(columns))
        row |= {
            "shape": shape.NAME,
            "surface": i,
            "note": "stop" if i == lens.stop_index else "",
            "actions": actions,
        }
        rows.append(row)
    half = _text(f"{0.5 * min(lens.sensor.size_mm):.6g}")
    distances = lens.sensor.plane_distances_mm
    for k, distance in enumerate(distances):
        gap = f"{distances[k + 1] - distance:.6g}" if k + 1 < len(distances) else ""
        rows.append(_row(f"sensor H{k + 1}", [None, _text(gap), None, half], len(columns)))
    return columns, rows


def _row(name: str, cells: list[dict[str, Any] | None], count: int) -> dict[str, Any]:
    return {
        "name": name,
        "shape": "",
        "surface": -1,
        "note": "",
        "actions": [],
        "cells": cells + [None] * (count - len(cells)),
    }


def _text(words: str) -> dict[str, Any]:
    return {"text": words}


def _cell(value: Value, label: str) -> dict[str, Any]:
    return {"key": value.key, "kind": value.kind, "text": value.text, "label": label}
