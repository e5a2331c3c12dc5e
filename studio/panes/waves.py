"""Panes of wave optics: wavefronts, contrast of lines, and a reconstructed patch of a chart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import panel as pn

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.paths import FIELD_FRACTIONS
from studio.model.bench import Workbench
from studio.model.pupils import PatchPicture, PupilAnalysis
from studio.panes.common import bench_of, follow_result, message_pane
from studio.panes.themes import FIELDS, WAVES, Theme, ThemedChart, between, chart, framed


def wavefront(lens: Workbench | Lens, field: int = 0) -> pn.Column:
    """Return a pane with the path difference over the pupil at one of three fields, and its quality."""
    from bokeh.models import ColumnDataSource, LinearColorMapper

    bench = bench_of(lens)
    plot = chart(height=150, match_aspect=True)
    framed(plot)
    plot.axis.visible = False
    plot.grid.visible = False
    source = ColumnDataSource({"image": []})
    mapper = LinearColorMapper(palette=between(WAVES["light"]), low=-1, high=1, nan_color="rgba(0,0,0,0)")
    plot.image("image", x=-1, y=-1, dw=2, dh=2, source=source, color_mapper=mapper)

    def dress(_: dict[str, str], theme: Theme) -> None:
        mapper.palette = between(WAVES[theme])

    words = message_pane()
    pane = pn.Column(ThemedChart(plot, dress), words, sizing_mode="stretch_width", margin=0)

    def result() -> PupilAnalysis | None:
        return bench.analysis.pupils[field] if field < len(bench.analysis.pupils) else None

    shown: Array | None = None

    def draw(found: PupilAnalysis) -> None:
        nonlocal shown
        if shown is not None and np.array_equal(shown, found.waves, equal_nan=True):
            return
        shown = found.waves
        # Smallest range (±) of the colours in waves, so that noise does not look like an aberration.
        min_waves = 0.05
        largest = max(min_waves, float(np.nanmax(np.abs(found.waves))))
        mapper.update(low=-largest, high=largest)
        source.data = {"image": [found.waves.astype(np.float32)]}
        words.object = (
            f'<div class="figure"><b>{found.field_mm:.3g} mm</b> <span>Strehl {found.strehl:.3f}</span> '
            f"<span>{found.rms_waves:.4f} λ rms</span> <span>± {largest:.2g} λ</span></div>"
        )

    follow_result(bench, pane, result, draw)
    return pane


def contrast(lens: Workbench | Lens) -> ThemedChart:
    """Return a chart of contrast against line width at three fields."""
    from bokeh.models import ColumnDataSource, Range1d

    bench = bench_of(lens)
    plot = chart(
        height=190,
        x="line width (µm)",
        y="contrast",
        x_range=Range1d(0, 1),
        y_range=Range1d(-0.05, 1.05),
    )
    sources = [ColumnDataSource({"x": [], "y": []}) for _ in range(3)]
    lines = [plot.line("x", "y", source=s, line_width=1.8) for s in sources]
    dots = [plot.scatter("x", "y", source=s, size=4.5, line_color=None) for s in sources]

    def dress(_: dict[str, str], theme: Theme) -> None:
        for line, dot, color in zip(lines, dots, FIELDS[theme], strict=True):
            line.glyph.line_color = dot.glyph.fill_color = color

    def draw(pupils: Sequence[PupilAnalysis]) -> None:
        for source, found in zip(sources, pupils, strict=False):
            source.data = {"x": list(found.widths_um), "y": list(found.contrast)}
        widths = pupils[0].widths_um
        plot.x_range.update(start=0.9 * widths[0], end=1.03 * widths[-1])

    pane = ThemedChart(plot, dress)
    follow_result(bench, pane, lambda: bench.analysis.pupils or None, draw)
    return pane


def patch(lens: Workbench | Lens) -> pn.Column:
    """Return a pane that compares reconstructed bars of a chart: actual lens and lens as designed."""
    from bokeh.models import ColumnDataSource, LinearColorMapper

    bench = bench_of(lens)
    mapper = LinearColorMapper(palette="Greys256", low=0, high=1)
    sources, charts = [], []
    for title in ("as designed", "as it is"):
        plot = chart(height=180, match_aspect=True)
        framed(plot)
        plot.axis.visible = plot.grid.visible = False
        source = ColumnDataSource({"image": []})
        plot.image("image", x=-1, y=-1, dw=2, dh=2, source=source, color_mapper=mapper)
        sources.append(source)
        charts.append(
            pn.Column(
                ThemedChart(plot),
                pn.pane.HTML(f'<div class="figure">{title}</div>', sizing_mode="stretch_width", margin=0),
                sizing_mode="stretch_width",
                margin=0,
            )
        )
    fields = {
        f"{fraction:g} of the half field" if fraction else "on the axis": fraction
        for fraction in FIELD_FRACTIONS
    }
    chosen = pn.widgets.Select(options=fields, value=bench.patch_fraction, margin=(0, 8), width=160)
    chosen.param.watch(lambda event: bench.set_patch(event.new), "value")
    shown = pn.Row(*charts, sizing_mode="stretch_width", margin=0)
    pane = pn.Column(chosen, shown, sizing_mode="stretch_width", margin=0)

    def draw(found: PatchPicture) -> None:
        for source, values in zip(sources, (found.nominal, found.actual), strict=True):
            source.data = {"image": [values.astype(np.float32)]}
        mapper.update(low=0.0, high=float(np.quantile(found.nominal, 0.995)))

    follow_result(bench, pane, lambda: bench.analysis.patch, draw)
    return pane
