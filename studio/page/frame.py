"""Page of a workbench, composed of panes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import panel as pn
import param
from bokeh.io import curdoc

from lensdesign.common.text import visible
from lensdesign.errors import TransferLensError
from studio import panes
from studio.model.bench import Workbench
from studio.model.files import remember, typed_path
from studio.panes.common import follow, text
from studio.panes.files import PICKER_SCRIPT, PICKER_STYLE, PickerPart
from studio.panes.rays import field_heights
from studio.panes.tabs import Tabs
from studio.panes.themes import FIELDS, apply_theme

HERE = Path(__file__).parent
DESIGNS = "designs"
"""Name of the list of recent design files."""

PARTS = (HERE / "parts.css").read_text(encoding="utf-8")


class Bar(PickerPart):
    """The top bar."""

    title = param.String(default="", doc="Title of the design.")
    file = param.String(default="", doc="File of the design.")
    is_saved = param.Boolean(default=True, doc="Whether the file holds the present design.")
    can_undo = param.Boolean(default=False, doc="Whether a step can be undone.")
    can_redo = param.Boolean(default=False, doc="Whether a step can be redone.")
    undo = param.String(default="", doc="Description of the step to undo.")
    message = param.String(default="", doc="Result of the last action.")
    is_bad = param.Boolean(default=False, doc="Whether the last action failed.")

    is_analysed = param.Boolean(default=True, doc="Whether the figures are of the present lens.")
    opened = param.Integer(default=0, doc="Number of the opened design; a page of another one is reloaded.")

    _esm = PICKER_SCRIPT + (HERE / "bar.js").read_text(encoding="utf-8")
    _stylesheets = [(HERE / "bar.css").read_text(encoding="utf-8"), PICKER_STYLE]  # noqa: RUF012 - as Panel has it


def page(bench: Workbench) -> pn.Template:
    """Return the whole page for one tab of a browser."""
    # A session that begins with a connection instead of a page would load style sheets from another server.
    curdoc().template_variables.setdefault("dist_url", "static/extensions/panel/")
    template, main = pn.Template((HERE / "page.html").read_text(encoding="utf-8")), _main(bench)
    template.add_variable("page_css", (HERE / "page.css").read_text(encoding="utf-8"))
    template.add_panel("bar", _bar(bench, main))
    template.add_panel("deviations", panes.deviations(bench))
    template.add_panel("side", _side(bench))
    template.add_panel("main", main)
    template.add_panel("summary", _summary(bench))
    return template


def _bar(bench: Workbench, main: pn.Column) -> Bar:
    """Return the bar of a page, which applies its theme to the main part."""

    def received(message: dict[str, Any]) -> None:
        if message.get("theme") in ("light", "dark"):
            apply_theme(main, message["theme"])
            return
        action = message.get("action")
        bar.param.update(message="", is_bad=False)
        if action == "undo":
            bench.undo()
        elif action == "redo":
            bench.redo()
        elif action in ("save", "open"):
            try:
                path = typed_path(str(message.get("file") or bench.document.path))
                if action == "open":
                    bench.open(path)
                else:
                    bench.save(None if path == bench.document.path else path)
                    bar.message = f"saved {bench.document.path}"
                remember(DESIGNS, bench.document.path)
            except TransferLensError as error:
                bar.param.update(message=str(error), is_bad=True)

    bar = Bar(DESIGNS, received, sizing_mode="stretch_width")

    def update() -> None:
        editing = bench.editing
        bar.param.update(
            title=visible(bench.lens.title),
            file=str(bench.document.path),
            is_saved=bench.is_saved,
            can_undo=bool(editing.undo_steps),
            can_redo=bool(editing.redo_steps),
            undo=visible(editing.now.description),
            opened=bench.opened_designs,
            is_analysed=bench.is_analysed,
        )

    follow(bench, bar, update)
    return bar


def _side(bench: Workbench) -> Tabs:
    return Tabs("Values", ("Lens", panes.surfaces(bench)), ("What if", panes.what_if(bench)))


def _summary(bench: Workbench) -> pn.Column:
    return _styled(pn.Column(panes.findings(bench), _head("As built"), panes.as_built(bench)))


def _main(bench: Workbench) -> pn.Column:
    return _styled(
        pn.Column(
            _card(_legend(bench), panes.layout(bench)),
            Tabs(
                "Tasks",
                ("Live", _live(bench)),
                ("Surfaces", _card(panes.surface_table(bench))),
                ("Optimize", _card(panes.optimize(bench))),
                ("Explore", _card(panes.explore(bench))),
                ("Tolerances", _card(panes.tolerances(bench))),
                ("Compare", _card(panes.compare(bench))),
                ("Export", _card(panes.export(bench))),
                ("Reconstructions", _card(panes.result_folder_pane(bench))),
            ),
        )
    )


def _live(bench: Workbench) -> pn.Column:
    planes = min(2, len(bench.lens.sensor.plane_distances_mm))

    def row(*cards: pn.Column) -> pn.Row:
        return pn.Row(*cards, sizing_mode="stretch_width", margin=0, styles={"gap": "1px"})

    return pn.Column(
        row(
            _card(_head("Spread", "against field, and the sensor's limit"), panes.spread(bench)),
            *(
                _card(_head(f"Spots on H{k + 1}", "and the footprint"), panes.footprint(bench, k))
                for k in range(planes)
            ),
        ),
        row(*(_card(_head("Wavefront", f"field {k + 1}"), panes.wavefront(bench, k)) for k in range(3))),
        row(*(_card(_head("PSF", f"field {k + 1}"), panes.point_spread(bench, k)) for k in range(3))),
        row(
            _card(_head("MTF", "dashed: without aberrations"), panes.modulation(bench)),
            _card(_head("Contrast", "of lines"), panes.contrast(bench)),
        ),
        row(_card(_head("Patch", "of a chart, reconstructed"), panes.patch(bench))),
        _card(
            pn.pane.HTML(
                '<div class="text-block hint">Draw a box in a chart to enlarge it; a double click shows '
                "everything. Values appear under the pointer.</div>",
                margin=0,
            )
        ),
        sizing_mode="stretch_width",
        styles={"gap": "1px"},
    )


def _legend(bench: Workbench) -> pn.pane.HTML:
    pane = pn.pane.HTML("", sizing_mode="stretch_width", margin=0, stylesheets=[PARTS])

    def update() -> None:
        names = "".join(
            f'<i style="color:var(--field-{k}, {color})">●</i><small style="padding:0">{text(name)}</small>'
            for k, (name, color) in enumerate(
                zip(field_heights(bench.lens), FIELDS["light"], strict=True), start=1
            )
        )
        pane.object = (
            f'<div class="head">Layout <small>to scale; rays from field heights</small>{names}</div>'
        )

    follow(bench, pane, update)
    return pane


def _head(title: str, more: str = "") -> pn.pane.HTML:
    small = f"<small>{text(more)}</small>" if more else ""
    return pn.pane.HTML(
        f'<div class="head">{title}{small}</div>', sizing_mode="stretch_width", margin=0, stylesheets=[PARTS]
    )


def _card(*parts: Any) -> pn.Column:
    return _styled(
        pn.Column(
            *parts, sizing_mode="stretch_width", styles={"background": "var(--paper, #fff)", "min-width": "0"}
        )
    )


def _styled(column: pn.Column) -> pn.Column:
    """Apply the page's style sheet to the texts and widgets of a column."""
    column.sizing_mode = "stretch_width"
    column.styles = {"gap": "1px", **column.styles}
    for child in column.select(lambda child: isinstance(child, pn.pane.HTML | pn.widgets.Widget)):
        child.stylesheets = [PARTS]
    return column


def notebook_view(bench: Workbench) -> pn.Row:
    """Return the panes of the page side by side."""
    side, main, summary = _side(bench), _main(bench), _summary(bench)
    side.width = summary.width = 330
    side.sizing_mode = summary.sizing_mode = "fixed"
    return pn.Row(side, main, summary, sizing_mode="stretch_width")
