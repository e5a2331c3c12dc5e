"""Pane that compares designs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import panel as pn

from lensdesign.analysis.comparison import compare_designs
from lensdesign.errors import TransferLensError
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.panes.common import bench_of, follow, message, message_pane, text


def comparison(names: Sequence[str], lenses: Sequence[Lens]) -> str:
    """Return the markup of a table of designs; differences are marked."""
    heads = "".join(f"<th>{text(name)}</th>" for name in names)
    rows = []
    for line in compare_designs(lenses):
        cells = "".join(
            f'<td class="{"miss-value" if met is False else ""}">{text(value)}</td>'
            for value, met in zip(line.values, line.met, strict=True)
        )
        rows.append(
            f'<tr class="{"differs" if line.differs else "same"}"><td>{text(line.name)}</td>{cells}</tr>'
        )
    body = f"<tr><th></th>{heads}</tr>{''.join(rows)}"
    return f'<div class="text-block"><table class="compared">{body}</table></div>'


def compare(lens: Workbench | Lens) -> pn.Column:
    """Return a pane that compares values and properties of the lens with those of other designs."""
    bench = bench_of(lens)
    others: dict[str, Lens] = {}
    name = pn.widgets.TextInput(name="design file to compare", placeholder="designs/feasible_singlet.toml")
    add = pn.widgets.Button(name="Add", align="end")
    clear = pn.widgets.Button(name="Clear", align="end")
    note = message_pane()
    table = message_pane()
    form = pn.Row(name, add, clear, sizing_mode="stretch_width", margin=(6, 6, 0, 6))
    pane = pn.Column(form, note, table, sizing_mode="stretch_width", margin=0)
    last_state: list[Any] = [None]

    def update() -> None:
        state = (bench.analysis.lens, bench.analysis.settled, tuple(others))
        if not bench.analysis.settled or state == last_state[0]:
            return
        last_state[0] = state
        table.object = comparison(["this lens", *others], [bench.analysis.lens, *others.values()])

    def add_design(_: object) -> None:
        note.object = ""
        path = Path(name.value.strip())
        try:
            if len(others) + 1 >= 3:  # at most three designs are compared
                others.pop(next(iter(others)))
            others[path.name] = load_design(path)
        except TransferLensError as error:
            note.object = message(text(error), is_bad=True)
        update()

    def clear_designs(_: object) -> None:
        others.clear()
        update()

    add.on_click(add_design)
    clear.on_click(clear_designs)
    follow(bench, pane, update)
    return pane
