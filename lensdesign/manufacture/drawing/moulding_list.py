"""List of a moulded element on its drawing: draft, gate and the results of the moulding checks."""

from __future__ import annotations

from collections.abc import Sequence

from lensdesign.analysis.moulding import MouldingCheck
from lensdesign.lens.solid import Element
from lensdesign.manufacture.drawing.primitives import Area, Item, Text, text_width_mm

TEXT_MM, LINE_MM = 2.4, 3.4

GATE_NAME = "G"
"""Name of the gate flat in the view."""


def moulding_lines(element: Element, checks: Sequence[MouldingCheck], width_mm: float) -> list[str]:
    """Return the lines of the list, wrapped to a width on paper; empty if there is nothing to state.

    Parameters
    ----------
    element
        The element.
    checks
        Its moulding checks.
    width_mm
        Width of the list.
    """
    paragraphs = _edge_texts(element)
    kinds = dict.fromkeys(check.check for check in checks)
    met = [kind for kind in kinds if all(check.met for check in checks if check.check == kind)]
    beyond = [
        f"{check.name} {check.value_text}" for check in checks if check.met is False and check.is_guideline
    ]
    missed = [f"{check.name} {check.value_text}" for check in checks if check.is_missed]
    unstated = [f"{check.name} (not stated)" for check in checks if check.value is None]
    unlimited = [f"{check.name} (no limit)" for check in checks if check.limit is None]
    for head, texts in (
        ("met", [kind.replace("_", " ") for kind in met]),
        ("not met", missed),
        ("beyond guidelines", beyond),
        ("open", [*unstated, *unlimited]),
    ):
        if texts:
            paragraphs.append(f"Moulding checks, {head}: {', '.join(texts)}")
    return [text for paragraph in paragraphs for text in _wrapped(paragraph, width_mm)]


def moulding_list(lines: Sequence[str], area: Area) -> list[Item]:
    """Draw the lines at the bottom of an area."""
    return [
        Text(area.left, area.bottom + (len(lines) - 1 - row) * LINE_MM + 0.8, text, TEXT_MM)
        for row, text in enumerate(lines)
    ]


def _edge_texts(element: Element) -> list[str]:
    """Return what the design states of draft and gate."""
    edge, texts = element.edge, list[str]()
    if edge.draft_deg is not None:
        name, side = ("R", 1) if edge.draft_deg > 0.0 else ("L", 0)
        diameter = 2.0 * element.edge_radii_mm[side]
        narrow = f", narrow end at {name}: Ø {diameter:.5g}" if any(element.draft_mm) else ""
        texts.append(f"Draft of the edge {abs(edge.draft_deg):g}°{narrow}")
    if edge.gate is not None:
        gate, outer_mm = edge.gate, element.outer_mm
        named = (("width", gate.width_mm), ("thickness", gate.thickness_mm))
        sizes = ", ".join(f"{name} {value:g}" for name, value in named if value is not None)
        texts.append(
            f"{GATE_NAME}: gate flat at −y, {outer_mm - gate.flat_depth_mm:.5g} from A, "
            f"{gate.flat_width_mm(outer_mm):.4g} wide" + (f"; gate {sizes}" if sizes else "")
        )
    return texts


def _wrapped(text: str, width_mm: float) -> list[str]:
    """Return a text as lines that fit a width."""
    lines, current = list[str](), ""
    for word in text.split(" "):
        longer = f"{current} {word}".strip()
        if current and text_width_mm(longer, TEXT_MM) > width_mm:
            lines.append(current)
            current = word
        else:
            current = longer
    return [*lines, current]
