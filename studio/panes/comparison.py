"""Designs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import panel as pn

from lensdesign.errors import TransferLensError
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.compared import compared
from studio.panes.common import bench_of, follow, text

MOST_DESIGNS = 3


def comparison(names: Sequence[str], lenses: Sequence[Lens]) -> str:
    """Markup of a table of designs; what differs is marked."""
    heads = "".join(f"<th>{text(name)}</th>" for name in names)
    rows = []
    for line in compared(lenses):
        cells = "".join(
            f'<td class="{"miss-value" if met is False else ""}">{text(value)}</td>'
            for value, met in zip(line.values, line.met, strict=True)
        )
        rows.append(
            f'<tr class="{"differs" if line.differs else "same"}"><td>{text(line.name)}</td>{cells}</tr>'
        )
    return f'<div class="told"><table class="compared"><tr><th></th>{heads}</tr>{"".join(rows)}</table></div>'


def compare(lens: Workbench | Lens) -> pn.Column:
    """The lens beside one or two other designs, values and figures; differences are marked."""
    bench = bench_of(lens)
    others: dict[str, Lens] = {}
    name = pn.widgets.TextInput(
        name="design file to put beside it", placeholder="designs/feasible_singlet.toml"
    )
    add = pn.widgets.Button(name="Add", align="end")
    clear = pn.widgets.Button(name="Clear", align="end")
    said = pn.pane.HTML("", sizing_mode="stretch_width", margin=0)
    table = pn.pane.HTML("", sizing_mode="stretch_width", margin=0)
    form = pn.Row(name, add, clear, sizing_mode="stretch_width", margin=(6, 6, 0, 6))
    pane = pn.Column(form, said, table, sizing_mode="stretch_width", margin=0)
    seen: list[Any] = [None]

    def update() -> None:
        state = (bench.figures.lens, bench.figures.settled, tuple(others))
        if not bench.figures.settled or state == seen[0]:
            return
        seen[0] = state
        table.object = comparison(["this lens", *others], [bench.figures.lens, *others.values()])

    def put(_: object) -> None:
        said.object = ""
        path = Path(name.value.strip())
        try:
            if len(others) + 1 >= MOST_DESIGNS:
                others.pop(next(iter(others)))
            others[path.name] = load_design(path)
        except TransferLensError as error:
            said.object = f'<div class="told"><p class="miss">{text(error)}</p></div>'
        update()

    def drop(_: object) -> None:
        others.clear()
        update()

    add.on_click(put)
    clear.on_click(drop)
    follow(bench, pane, update)
    return pane
