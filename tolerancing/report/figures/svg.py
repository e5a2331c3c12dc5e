"""Conversion of figures to SVG elements of a page.

Colours become CSS variables, so that they follow the light or dark theme. Points get the number of their
trial, which the page shows as a tooltip.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from xml.etree import ElementTree

from lensdesign.plots import style
from tolerancing.report.blocks import Panel, plain

SVG, XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"

COLORS = {
    style.INK: "ink",
    style.TICKS: "soft",
    style.FAINT: "edge",
    style.GRID: "grid",
    style.PAPER: "paper",
    style.BLUE: "blue",
    style.ORANGE: "orange",
    style.GREEN: "green",
    style.RED: "red",
    style.GREY: "soft",
    style.VIOLET: "violet",
    style.OCHRE: "ochre",
    # Colours of the lens layout.
    "#cfe3f1": "glass",
    "#333333": "ink",
    "#8a8a8a": "soft",
    "#000000": "ink",
    # Colours of field heights, the same in all figures.
    "#d55e00": "field-1",
    "#009e73": "field-2",
    "#0072b2": "field-3",
}
"""Names of the page's colours by the colours of the figures."""

_COLOR = re.compile(r"#[0-9a-fA-F]{6}\b")
_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_FONTS = re.compile(r"'DejaVu Sans'(?:, [^;\"]*)?")
_REFERENCE = re.compile(r"url\(#([^)]+)\)|^#(.+)$")


def svg_text(panel: Panel, prefix: str) -> str:
    """Return a panel as an ``svg`` element.

    Parameters
    ----------
    panel
        The figure. Markers of the collections named in `points` become circles with ``data-trial``.
    prefix
        Prefix of all ids; each figure of a page needs another one.
    """
    root = _drawn(panel)
    names = {f"{{{SVG}}}{name}" for name in ("metadata", "style")}
    for parent in list(root.iter()):
        for child in [c for c in parent if c.tag in names]:
            parent.remove(child)
    for gid, trials in panel.points.items():
        _number_points(root, gid, trials)
    _rename(root, prefix)
    for element in root.iter():
        _restyle(element)
    width, height = panel.figure.get_size_inches()
    root.attrib.pop("version", None)
    pixels_per_inch = 96.0
    root.set("width", f"{width * pixels_per_inch:.0f}")
    root.set("height", f"{height * pixels_per_inch:.0f}")
    # Smallest scale of a figure; on a narrower page it scrolls.
    smallest_scale = 0.72
    root.set("style", f"min-width:{smallest_scale * min(width, 9.0) * pixels_per_inch:.0f}px")
    root.set("role", "img")
    root.set("aria-label", plain(panel.alt))
    # Inside HTML an svg element needs no declaration of its namespace.
    return ElementTree.tostring(root, encoding="unicode").replace(f' xmlns="{SVG}"', "", 1)


def _drawn(panel: Panel) -> ElementTree.Element:
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.StringIO()
    facecolor = panel.figure.get_facecolor()
    with style.styled({"svg.fonttype": "none"}):
        panel.figure.patch.set_alpha(0.0)
        FigureCanvasSVG(panel.figure).print_svg(buffer, metadata={"Date": None})
        panel.figure.set_layout_engine("none")  # Keeps this layout for the PDF.
        panel.figure.patch.set_alpha(None)
        panel.figure.set_facecolor(facecolor)
    ElementTree.register_namespace("", SVG)
    ElementTree.register_namespace("xlink", XLINK)
    return ElementTree.fromstring(buffer.getvalue())


def _number_points(root: ElementTree.Element, gid: str, numbers: Sequence[int]) -> None:
    """Replace the markers of a collection by circles with the numbers of their trials."""
    group = next(e for e in root.iter(f"{{{SVG}}}g") if e.get("id") == gid)
    centres = [
        (u.get("x", "0"), u.get("y", "0")) for u in group.iter(f"{{{SVG}}}use") if u.get("x") is not None
    ] or _path_centres(group)
    if len(centres) != len(numbers):  # Some markers lie outside of the figure, and it is unknown which.
        return
    clip = next((e.get("clip-path") for e in group.iter() if e.get("clip-path")), None)
    for child in list(group):
        group.remove(child)
    if clip:
        group.set("clip-path", clip)
    group.set("class", "bad" if gid.endswith("bad") else "good")
    for (x, y), number in zip(centres, numbers, strict=True):
        ElementTree.SubElement(
            group,
            f"{{{SVG}}}circle",
            {"cx": f"{float(x):.1f}", "cy": f"{float(y):.1f}", "r": "1.5", "data-trial": str(number)},
        )


def _path_centres(group: ElementTree.Element) -> list[tuple[str, str]]:
    """Return the centres of markers that are drawn as single paths, as matplotlib does for few markers."""
    centres = []
    for path in group.iter(f"{{{SVG}}}path"):
        numbers = [float(v) for v in re.findall(r"-?\d+(?:\.\d+)?", path.get("d", ""))]
        x, y = numbers[0::2], numbers[1::2]
        centres.append((f"{0.5 * (min(x) + max(x))}", f"{0.5 * (min(y) + max(y))}"))
    return centres


def _rename(root: ElementTree.Element, prefix: str) -> None:
    """Add a prefix to ids that are referenced, and remove the others."""
    used: set[str] = set()
    for element in root.iter():
        for value in element.attrib.values():
            used.update(a or b for a, b in _REFERENCE.findall(value))
    for element in root.iter():
        for name, value in list(element.attrib.items()):
            if name == "id":
                if value in used:
                    element.set(name, prefix + value)
                else:
                    del element.attrib[name]
            elif name == f"{{{XLINK}}}href":
                del element.attrib[name]
                element.set("href", f"#{prefix}{value[1:]}" if value.startswith("#") else value)
            elif "url(#" in value:
                element.set(name, value.replace("url(#", f"url(#{prefix}"))


def _restyle(element: ElementTree.Element) -> None:
    """Use the page's colours, fewer digits, and common fallback fonts."""
    css = element.get("style")
    if css:
        css = _COLOR.sub(_variable, css)
        element.set("style", _FONTS.sub("'DejaVu Sans', Verdana, sans-serif", css).replace("; ", ";"))
    for name in ("d", "points", "x", "y", "transform"):
        value = element.get(name)
        if value is not None:
            element.set(name, " ".join(_NUMBER.sub(_rounded, value).split()))
    if element.text is not None and not element.text.strip():
        element.text = None
    if element.tail is not None and not element.tail.strip():
        element.tail = None


def _variable(match: re.Match[str]) -> str:
    name = COLORS.get(match[0].lower())
    return match[0] if name is None else f"var(--{name})"


def _rounded(match: re.Match[str]) -> str:
    return f"{float(match[0]):.2f}".rstrip("0").rstrip(".")
