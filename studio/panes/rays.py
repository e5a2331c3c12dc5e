"""Panes of ray optics: layout, spread against field height, footprints with spots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lensdesign.analysis.report import CheckReport
from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.picture import Layout, field_heights_mm, layout_of
from studio.panes.common import Guarded, bench_of, follow_result
from studio.panes.themes import (
    COLORS,
    FIELDS,
    Theme,
    ThemedChart,
    chart,
    framed,
    hover,
    set_range,
    show,
    stepped,
)


def layout(lens: Workbench | Lens) -> Guarded:
    """Return the layout of the lens to scale, with rays of three fields."""
    from bokeh.models import ColumnDataSource

    bench = bench_of(lens)
    plot = chart("layout of the lens with rays", height=270, x="z (mm)", y="y (mm)", match_aspect=True)
    box = framed(plot)
    names = ("glass", "rays", "surfaces", "planes", "labels")
    sources = {name: ColumnDataSource({"xs": [], "ys": []}) for name in names}
    sources["rays"].data = {"xs": [], "ys": [], "color": []}
    sources["surfaces"].data = {"xs": [], "ys": [], "name": []}
    sources["labels"].data = {"x": [], "y": [], "text": []}
    glass = plot.patches("xs", "ys", source=sources["glass"], line_color=None, fill_alpha=0.75)
    plot.multi_line("xs", "ys", source=sources["rays"], line_color="color", line_width=0.8, line_alpha=0.85)
    outline = plot.multi_line("xs", "ys", source=sources["surfaces"], line_width=1.4)
    hover(plot, [outline], ("", "@name"), line_policy="interp")
    planes = plot.multi_line("xs", "ys", source=sources["planes"], line_width=2)
    labels = plot.text(
        "x",
        "y",
        "text",
        source=sources["labels"],
        text_font_size="11px",
        text_align="center",
        text_baseline="bottom",
    )
    plot.xgrid.visible = plot.ygrid.visible = False
    theme: Theme = "light"

    def dress(colors: dict[str, str], name: Theme) -> None:
        nonlocal theme
        theme = name
        glass.glyph.fill_color = colors["glass"]
        outline.glyph.line_color = colors["edge"]
        planes.glyph.line_color = colors["ink"]
        labels.glyph.text_color = colors["faint"]
        count = len(sources["rays"].data["color"])
        if count:
            sources["rays"].data["color"] = _colors(count, name)
            sources["rays"].data = dict(sources["rays"].data)

    def draw(found: Layout) -> None:
        _fill(sources, found, bench.analysis.lens, theme)
        _frame(box, found, bench.analysis.lens)

    pane = ThemedChart(plot, dress)
    follow_result(bench, pane, lambda: bench.analysis.layout, draw)
    return Guarded(bench, pane, "layout")


def spread(lens: Workbench | Lens) -> Guarded:
    """Return a chart of the largest angle behind the lens against field height, with the sensor's limit."""
    from bokeh.models import ColumnDataSource, Range1d, Span

    bench = bench_of(lens)
    plot = chart(
        "spread against field height",
        height=190,
        x="field height (mm)",
        y="spread (°)",
        x_range=Range1d(0, 1),
        y_range=Range1d(0, 1),
    )
    source = ColumnDataSource({"x": [], "y": []})
    line = plot.line("x", "y", source=source, line_width=2)
    dots = plot.scatter("x", "y", source=source, size=4)
    hover(plot, [dots], ("field height", "@x{0.000} mm"), ("spread", "@y{0.0000}°"))
    limit = Span(dimension="width", line_dash="dashed", line_width=1.2)
    plot.add_layout(limit)
    colors: dict[str, str] = {}

    def paint() -> None:
        report = bench.analysis.check
        if report is not None:
            over = report.max_spread_deg > report.spread_limit_deg * (1.0 + 1e-6)
            line.glyph.line_color = dots.glyph.fill_color = colors["bad" if over else "accent"]
            dots.glyph.line_color = None
            limit.line_color = colors["bad" if over else "faint"]

    def dress(of_theme: dict[str, str], _: Theme) -> None:
        colors.update(of_theme)
        paint()

    def draw(report: CheckReport) -> None:
        source.data = {"x": list(report.spread_heights_mm), "y": list(report.spread_per_field_deg)}
        limit.location = report.spread_limit_deg
        set_range(plot.y_range, 0.0, stepped(1.15 * max(report.spread_limit_deg, report.max_spread_deg)))
        set_range(plot.x_range, 0.0, stepped(1.02 * report.spread_heights_mm[-1]))
        paint()

    pane = ThemedChart(plot, dress)
    follow_result(bench, pane, lambda: bench.analysis.check, draw)
    return Guarded(bench, pane, "check")


def footprint(lens: Workbench | Lens, plane: int = 0) -> Guarded:
    """Return a chart of the spots of three fields in one sensor plane, and the footprint of all light."""
    from bokeh.models import ColumnDataSource

    bench = bench_of(lens)
    plot = chart(f"spots on sensor plane H{plane + 1}", height=190, x="x (mm)", y="y (mm)", match_aspect=True)
    box = framed(plot)
    spots, sensor, reach = (ColumnDataSource({"x": [], "y": []}) for _ in range(3))
    spots.data = {"x": [], "y": [], "color": [], "field": []}
    dots = plot.scatter("x", "y", source=spots, size=2, color="color", line_color=None, alpha=0.9)
    hover(plot, [dots], ("field", "@field"), ("x, y", "@x{0.000}, @y{0.000} mm"), point_policy="follow_mouse")
    frame = plot.line("x", "y", source=sensor, line_width=1.4)
    circle = plot.line("x", "y", source=reach, line_width=1.2, line_dash="dashed")
    theme: Theme = "light"

    def result() -> CheckReport | None:
        """Return the check of the lens; None if there are no spots in this plane."""
        found = bench.analysis.layout
        return bench.analysis.check if found is not None and plane < len(found.spots) else None

    def dress(_: dict[str, str], name: Theme) -> None:
        nonlocal theme
        theme = name
        report = result()
        if report is not None:
            draw(report)

    def draw(report: CheckReport) -> None:
        assert bench.analysis.layout is not None
        points = bench.analysis.layout.spots[plane]
        xy = np.concatenate(points)
        spots.data = {
            "x": xy[:, 0],
            "y": xy[:, 1],
            "color": np.repeat(FIELDS[theme], [len(p) for p in points]).tolist(),
            "field": np.repeat(field_heights(bench.analysis.lens), [len(p) for p in points]).tolist(),
        }
        half_x, half_y = (0.5 * side for side in bench.analysis.lens.sensor.size_mm)
        sensor.data = {
            "x": [half_x * s for s in (-1, 1, 1, -1, -1)],
            "y": [half_y * s for s in (-1, -1, 1, 1, -1)],
        }
        radius, angle = report.footprint_radius_mm[plane], np.linspace(0.0, 2.0 * np.pi, 97)
        reach.data = {"x": (radius * np.cos(angle)).tolist(), "y": (radius * np.sin(angle)).tolist()}
        # Size of a chart relative to its contents.
        margin_factor = 1.06
        largest = margin_factor * max(half_y, radius)
        wide = margin_factor * max(half_x, radius)
        show(box, (-wide, wide), (-largest, largest))
        name = f"footprint radius at {report.plane_distances_mm[plane]:g} mm"
        met = all(c.met for c in report.constraints if c.name == name)
        frame.glyph.line_color = COLORS[theme]["ink"]
        circle.glyph.line_color = COLORS[theme]["accent" if met else "bad"]

    pane = ThemedChart(plot, dress)
    follow_result(bench, pane, result, draw)
    return Guarded(bench, pane, "check", "layout")


def _colors(count: int, theme: Theme) -> list[str]:
    return [color for color in FIELDS[theme] for _ in range(count // 3)]


def _fill(sources: dict[str, Any], found: Layout, lens: Lens, theme: Theme) -> None:
    lines = [ray for field in found.rays for ray in field]
    sources["glass"].data = _corners(found.glass)
    sources["surfaces"].data = _corners(found.surfaces) | {
        "name": [f"surface {k + 1}" for k in range(len(found.surfaces))]
    }
    sources["rays"].data = _corners(lines) | {"color": _colors(len(lines), theme)}
    half = 0.5 * lens.sensor.size_mm[1]
    positions = [(lens.object_z_mm, lens.half_field_mm), *((z, half) for z in lens.sensor_z_mm)]
    sources["planes"].data = {"xs": [[z, z] for z, _ in positions], "ys": [[-h, h] for _, h in positions]}
    sources["labels"].data = {
        "x": [z for z, _ in positions],
        "y": [1.02 * max(h, 0.35 * half) + 0.15 for _, h in positions],
        "text": ["object", *(f"H{k + 1}" for k in range(len(lens.sensor_z_mm)))],
    }


def _corners(lines: Sequence[Array]) -> dict[str, list[Any]]:
    """Return corners of lines as plain numbers, because Bokeh sends each array as a separate message."""
    return {"xs": [line[:, 0].tolist() for line in lines], "ys": [line[:, 1].tolist() for line in lines]}


def _frame(box: Any, found: Layout, lens: Lens) -> None:
    """Show the whole lens; the range changes in steps, so that it is steady while a slider moves."""
    high = max(0.5 * lens.sensor.size_mm[1], *(float(np.abs(s[:, 1]).max()) for s in found.surfaces))
    high = stepped(1.22 * high)
    left, right = lens.object_z_mm, lens.sensor_z_mm[-1]
    margin = 0.04 * stepped(right - left)
    show(box, (left - margin, right + margin), (-high, high))


def field_heights(lens: Lens) -> list[str]:
    """Return the field heights of the pictures as texts."""
    return [f"{height:.3g} mm" for height in field_heights_mm(lens)]


def layouts_over_each_other(height: int = 210) -> tuple[ThemedChart, Any]:
    """Return a chart of two lenses, and the function that draws them: a start, and a lens found from it."""
    from bokeh.models import ColumnDataSource

    plot = chart(
        "layout of the found lens over the start", height=height, x="z (mm)", y="y (mm)", match_aspect=True
    )
    box = framed(plot)
    start, found, rays = (ColumnDataSource({"xs": [], "ys": []}) for _ in range(3))
    glass = plot.patches("xs", "ys", source=found, line_color=None, fill_alpha=0.6, legend_label="found")
    light = plot.multi_line("xs", "ys", source=rays, line_width=0.8, line_alpha=0.7)
    dashed = plot.multi_line(
        "xs", "ys", source=start, line_width=1.4, line_dash="dashed", legend_label="start"
    )
    plot.xgrid.visible = plot.ygrid.visible = False

    def dress(colors: dict[str, str], _: Theme) -> None:
        glass.glyph.fill_color = colors["glass"]
        light.glyph.line_color = colors["accent"]
        dashed.glyph.line_color = colors["ink"]

    def draw(lenses: tuple[Lens, Lens]) -> None:
        before, after = (layout_of(lens) for lens in lenses)
        start.data = _corners([np.concatenate([outline, outline[:1]]) for outline in before.glass])
        found.data = _corners(after.glass)
        rays.data = _corners([ray for field in after.rays for ray in field])
        _frame(box, after, lenses[1])

    return ThemedChart(plot, dress, margin=(5, 10)), draw
