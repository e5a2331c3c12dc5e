"""Panes of wave optics: wavefronts, contrast of lines, and a reconstructed patch of a chart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import panel as pn

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.paths import FIELD_FRACTIONS
from studio.model.bench import Workbench
from studio.model.pupils import PSF_DECADES, PatchPicture, PupilAnalysis
from studio.panes.common import Guarded, bench_of, follow_result, message_pane
from studio.panes.themes import (
    FIELDS,
    INTENSITY,
    WAVES,
    Theme,
    ThemedChart,
    between,
    chart,
    color_bar,
    framed,
    hover,
    set_range,
    show,
    stepped,
)


def wavefront(lens: Workbench | Lens, field: int = 0) -> Guarded:
    """Return a pane with the path difference over the pupil at one of three fields, and its quality."""
    from bokeh.models import ColumnDataSource, LinearColorMapper

    bench = bench_of(lens)
    plot = chart(f"wavefront of field {field + 1}", height=150, match_aspect=True)
    framed(plot)
    plot.axis.visible = False
    plot.grid.visible = False
    source = ColumnDataSource({"image": []})
    mapper = LinearColorMapper(palette=between(WAVES["light"]), low=-1, high=1, nan_color="rgba(0,0,0,0)")
    image = plot.image("image", x=-1, y=-1, dw=2, dh=2, source=source, color_mapper=mapper)
    color_bar(plot, mapper, "λ")
    hover(plot, [image], ("path difference", "@image{0.0000} λ"))

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
            f"<span>{found.rms_waves:.4f} λ rms</span></div>"
        )

    follow_result(bench, pane, result, draw)
    return Guarded(bench, pane, "pupils")


def point_spread(lens: Workbench | Lens, field: int = 0) -> Guarded:
    """Return a pane with the point spread function at one of three fields, over four decades."""
    from bokeh.models import ColumnDataSource, LinearColorMapper

    bench = bench_of(lens)
    plot = chart(f"point spread of field {field + 1}", height=150, match_aspect=True)
    box = framed(plot)
    plot.axis.visible = False
    plot.grid.visible = False
    source = ColumnDataSource({"image": [], "start": [], "side": []})
    mapper = LinearColorMapper(palette=between(INTENSITY["light"]), low=-PSF_DECADES, high=0.0)
    image = plot.image(
        "image", x="start", y="start", dw="side", dh="side", source=source, color_mapper=mapper
    )
    color_bar(plot, mapper, "log10")
    hover(plot, [image], ("x, y", "$x{0.00}, $y{0.00} µm"), ("log10 of the intensity", "@image{0.00}"))

    def dress(_: dict[str, str], theme: Theme) -> None:
        mapper.palette = between(INTENSITY[theme])

    words = message_pane()
    pane = pn.Column(ThemedChart(plot, dress), words, sizing_mode="stretch_width", margin=0)

    def result() -> PupilAnalysis | None:
        return bench.analysis.pupils[field] if field < len(bench.analysis.pupils) else None

    shown: Array | None = None

    def draw(found: PupilAnalysis) -> None:
        nonlocal shown
        if shown is not None and np.array_equal(shown, found.psf_decades):
            return
        shown = found.psf_decades
        half = found.psf_half_um
        source.data = {
            "image": [found.psf_decades.astype(np.float32)],
            "start": [-half],
            "side": [2.0 * half],
        }
        show(box, (-half, half), (-half, half))
        new = (
            f'<div class="figure"><b>{found.field_mm:.3g} mm</b> <span>peak {found.strehl:.3f}</span> '
            f"<span>{2.0 * half:.3g} µm wide</span></div>"
        )
        if words.object != new:
            words.object = new

    follow_result(bench, pane, result, draw)
    return Guarded(bench, pane, "pupils")


def modulation(lens: Workbench | Lens) -> Guarded:
    """Return a chart of the modulation transfer at three fields, and of a lens without aberrations."""
    from bokeh.models import ColumnDataSource, Range1d

    bench = bench_of(lens)
    plot = chart(
        "modulation transfer",
        height=190,
        x="spatial frequency at the object (lp/mm)",
        y="modulation",
        x_range=Range1d(0, 1),
        y_range=Range1d(-0.02, 1.05),
    )
    sources = [ColumnDataSource({"x": [], "y": []}) for _ in range(4)]
    perfect = plot.line("x", "y", source=sources[3], line_width=1.2, line_dash="dashed")
    lines = [plot.line("x", "y", source=s, line_width=1.8) for s in sources[:3]]
    hover(plot, lines, ("frequency", "$x{0} lp/mm"), ("modulation", "$y{0.000}"))

    def dress(colors: dict[str, str], theme: Theme) -> None:
        perfect.glyph.line_color = colors["faint"]
        for line, color in zip(lines, FIELDS[theme], strict=True):
            line.glyph.line_color = color

    def draw(pupils: Sequence[PupilAnalysis]) -> None:
        for source, found in zip(sources, pupils, strict=False):
            source.data = {"x": found.frequencies_lp_per_mm.tolist(), "y": found.mtf.tolist()}
        first = pupils[0]
        sources[3].data = {"x": first.frequencies_lp_per_mm.tolist(), "y": first.perfect_mtf.tolist()}
        set_range(plot.x_range, 0.0, stepped(max(float(p.frequencies_lp_per_mm[-1]) for p in pupils)))

    pane = ThemedChart(plot, dress)
    follow_result(bench, pane, lambda: bench.analysis.pupils or None, draw)
    return Guarded(bench, pane, "pupils")


def contrast(lens: Workbench | Lens) -> Guarded:
    """Return a chart of contrast against line width at three fields."""
    from bokeh.models import ColumnDataSource, Range1d

    bench = bench_of(lens)
    plot = chart(
        "contrast of lines",
        height=190,
        x="line width (µm)",
        y="contrast",
        x_range=Range1d(0, 1),
        y_range=Range1d(-0.05, 1.05),
    )
    sources = [ColumnDataSource({"x": [], "y": []}) for _ in range(3)]
    lines = [plot.line("x", "y", source=s, line_width=1.8) for s in sources]
    dots = [plot.scatter("x", "y", source=s, size=4.5, line_color=None) for s in sources]
    hover(plot, dots, ("line width", "@x{0.000} µm"), ("contrast", "@y{0.000}"))

    def dress(_: dict[str, str], theme: Theme) -> None:
        for line, dot, color in zip(lines, dots, FIELDS[theme], strict=True):
            line.glyph.line_color = dot.glyph.fill_color = color

    def draw(pupils: Sequence[PupilAnalysis]) -> None:
        for source, found in zip(sources, pupils, strict=False):
            source.data = {"x": list(found.widths_um), "y": list(found.contrast)}
        widths = pupils[0].widths_um
        set_range(plot.x_range, 0.9 * widths[0], 1.03 * widths[-1])

    pane = ThemedChart(plot, dress)
    follow_result(bench, pane, lambda: bench.analysis.pupils or None, draw)
    return Guarded(bench, pane, "pupils")


def patch(lens: Workbench | Lens) -> Guarded:
    """Return a pane that compares reconstructed bars of a chart: actual lens and lens as designed."""
    from bokeh.models import ColumnDataSource, LinearColorMapper

    bench = bench_of(lens)
    mapper = LinearColorMapper(palette="Greys256", low=0, high=1)
    sources, charts, boxes = [], [], []
    for title in ("as designed", "as it is"):
        plot = chart(f"reconstructed patch, {title}", height=180, match_aspect=True)
        plot.axis.visible = plot.grid.visible = False
        source = ColumnDataSource({"image": [], "start": [], "side": []})
        image = plot.image(
            "image", x="start", y="start", dw="side", dh="side", source=source, color_mapper=mapper
        )
        color_bar(plot, mapper, "")
        hover(plot, [image], ("x, y", "$x{0.0}, $y{0.0} µm"), ("intensity", "@image{0.000}"))
        boxes.append(framed(plot))
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
    chosen = pn.widgets.Select(
        name="field height of the patch", options=fields, value=bench.patch_fraction, margin=(0, 8), width=160
    )
    chosen.param.watch(lambda event: bench.set_patch(event.new), "value")
    shown = pn.Row(*charts, sizing_mode="stretch_width", margin=0)
    pane = pn.Column(chosen, shown, sizing_mode="stretch_width", margin=0)

    def draw(found: PatchPicture) -> None:
        side = found.side_um
        for source, box, values in zip(sources, boxes, (found.nominal, found.actual), strict=True):
            source.data = {"image": [values.astype(np.float32)], "start": [-0.5 * side], "side": [side]}
            show(box, (-0.5 * side, 0.5 * side), (-0.5 * side, 0.5 * side))
        mapper.update(low=0.0, high=float(np.quantile(found.nominal, 0.995)))

    follow_result(bench, pane, lambda: bench.analysis.patch, draw)
    return Guarded(bench, pane, "patch")
