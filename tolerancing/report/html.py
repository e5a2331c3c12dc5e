"""Rendering of a report as one self-contained HTML page."""

from __future__ import annotations

import json
import re

from lensdesign.common.notebook import page_template
from tolerancing.report.blocks import FigureBlock, Heading, Report, plain
from tolerancing.report.figures.svg import svg_text


def html_page(report: Report) -> str:
    """Return the report as HTML text."""
    from markupsafe import Markup

    sections = [b for b in report.blocks if isinstance(b, Heading) and b.level == 2]
    names = {id(section): f"section-{number}" for number, section in enumerate(sections, start=1)}
    figures: dict[int, list[Markup]] = {}
    for number, block in enumerate(report.blocks):
        if isinstance(block, FigureBlock):
            figures[number] = [
                Markup(svg_text(panel, f"f{number}p{k}-")) for k, panel in enumerate(block.panels)
            ]
    template = page_template(
        "tolerancing.report",
        "report.html.j2",
        finalize=lambda value: plain(value) if type(value) is str else value,
    )
    return template.render(
        report=report,
        sections=[(names[id(section)], section.text) for section in sections],
        names=names,
        identity=id,
        figures=figures,
        kind=lambda block: type(block).__name__,
        trials=Markup(safe_json({str(trial): plain(text) for trial, text in report.trials.items()})),
        percent=lambda fraction: f"{100.0 * fraction:.2f}",
    )


def safe_json(value: object) -> str:
    """Return JSON that is safe inside a ``script`` element for any text in it."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"))
    return re.sub("[<>&\u2028\u2029]", lambda match: f"\\u{ord(match[0]):04x}", text)
