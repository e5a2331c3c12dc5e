"""Pane that compares designs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import panel as pn

from lensdesign.analysis.comparison import compare_designs
from lensdesign.errors import TransferLensError
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.files import remember, typed_path
from studio.panes.common import bench_of, explanation, follow, message, message_pane, text
from studio.panes.files import FileChoice


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
    others = bench.session.compared
    name = FileChoice(
        "designs",
        label="design file to compare",
        placeholder="designs/feasible_singlet.toml",
        suffixes=[".toml"],
        sizing_mode="stretch_width",
    )
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
        explained = "" if others else _EMPTY
        table.object = explained + comparison(["this lens", *others], [bench.analysis.lens, *others.values()])

    def add_design(_: object) -> None:
        note.object = ""
        try:
            path = typed_path(name.value)
            if len(others) + 1 >= 3:  # at most three designs are compared
                others.pop(next(iter(others)))
            others[path.name] = load_design(path)
            remember("designs", path)
        except TransferLensError as error:
            note.object = message(text(error), is_bad=True)
        bench.notify()

    def clear_designs(_: object) -> None:
        others.clear()
        bench.notify()

    add.on_click(add_design)
    clear.on_click(clear_designs)
    follow(bench, pane, update)
    return pane


_EMPTY = explanation(
    "Compare this lens with others",
    "Add one or two design files. The table then has a column for each of them, and marks the values "
    "that differ and the constraints that are not met.",
    "Example: add the file as it was opened, and edit the lens here: the marked rows are the changes.",
)
