"""Pictures of the documentation that are put together from several results.

    python -m benchmarks.docs_pictures figure-7 STORE PICTURE
    python -m benchmarks.docs_pictures whole-field FRAMES OBJECT PICTURE
    python -m benchmarks.docs_pictures fronts ONE TWO PICTURE
    python -m benchmarks.docs_pictures overview FRAMES OBJECT PICTURE
    python -m benchmarks.docs_pictures studio LIGHT DARK
    python -m benchmarks.docs_pictures bench FRAMES WRONG CALIBRATED PICTURE

STORE is that of designs/paper_figure_7.toml, FRAMES and OBJECT the folders of the whole field's
`wavesim image` and `wavesim reconstruct` in docs/reconstruction.md; ONE and TWO those of `lensdesign explore`
over track and yield in docs/as-built.md, of one element and of two. The overview is of the folders frames and
object of `make demo`. LIGHT and DARK are pictures of the workbench in a browser. FRAMES, WRONG and CALIBRATED
are the folders of docs/bench.md: frames of a bench that differs from its design, and what
`wavesim reconstruct` finds in them without and with a calibration.
"""

from __future__ import annotations

import csv
import math
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from PIL.Image import Image

DOTS_PER_INCH = 112
PAPER_YIELD = 51.1
"""Of the paper's lens in per cent, as `tolerancing predict designs/as_built_tolerances.toml` has it."""
CHART_MM, FINE = 0.07, 8
"""Side of what is shown of a chart, and the coarsest group in it."""


def figure_7(store: Path, picture: Path) -> None:
    """Curves and plates of slices, and below them those of decenter and tilt side by side."""
    from PIL import Image

    from tolerancing import open_store
    from tolerancing.report.blocks import FigureBlock
    from tolerancing.report.report import report_data
    from tolerancing.report.sections.series import series_section

    with open_store(store) as opened:
        blocks = [block for block in series_section(report_data(opened)) if isinstance(block, FigureBlock)]
    drawn = [[_drawn(panel.figure) for panel in block.panels] for block in blocks]
    decenter, decenter_plate, tilt, tilt_plate, _, slices, slices_plate, *_ = drawn
    rows = [slices, slices_plate, [decenter[0], tilt[0]], [*decenter_plate, *tilt_plate]]
    width = max(sum(part.width for part in row) for row in rows)
    scaled = [[_of_width(part, width // len(row)) for part in row] for row in rows]
    heights = [max(part.height for part in row) for row in scaled]
    page = Image.new("RGB", (width, sum(heights)), "white")
    for top, row in zip(np.cumsum([0, *heights[:-1]]), scaled, strict=True):
        for number, part in enumerate(row):
            page.paste(part, (number * (width // len(row)), int(top)))
    page.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(picture, optimize=True)


def _drawn(figure: Any, dots_per_inch: int = DOTS_PER_INCH) -> Image:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure.set_dpi(dots_per_inch)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


def _of_width(picture: Image, width: int) -> Image:
    return picture.resize((width, round(picture.height * width / picture.width)))


def _amplitudes(frames: Path, found: Path) -> tuple[Any, Any, float]:
    """Return the found and the true amplitude, and the pitch of their samples in um."""
    with np.load(found / "reconstruction.npz") as one, np.load(frames / "object.npz") as other:
        return np.abs(one["values"]), np.abs(other["values"]), float(one["pitch_um"])


def whole_field(frames: Path, found: Path, picture: Path, at_mm: tuple[float, float] = (0.0, 1.3)) -> None:
    """The finest groups in the middle and off the axis, as they were found, and as they are."""
    from matplotlib.figure import Figure

    from lensdesign import load_design
    from wavesim.plots.panels import AS_SAMPLED, scale_bar
    from wavesim.targets.patch import object_patch, usaf_charts_of
    from wavesim.targets.usaf import chart_outline

    result, true, pitch_um = _amplitudes(frames, found)
    side_mm = 1e-3 * pitch_um * len(result)
    lens = load_design("designs/paper_singlet.toml")
    charts = usaf_charts_of(object_patch(lens, side_mm, object_pitch_um=pitch_um), [at_mm])
    figure = Figure(figsize=(12.0, 4.4), layout="constrained")
    off = f"{math.hypot(*at_mm):g} mm off the axis"
    for axes, title, values, chart in zip(
        figure.subplots(1, 3),
        ("found in the middle", f"found {off}", "the true chart"),
        (result, result, true),
        (charts[0], charts[1], charts[1]),
        strict=True,
    ):
        around = chart_outline([one for one in chart if one.group >= FINE])
        middle = (0.5 * (around.low_mm + around.high_mm), 0.5 * (around.left_mm + around.right_mm))
        half = round(0.5e3 * CHART_MM / pitch_um)
        row, column = (round(0.5 * (len(values) - 1) + 1e3 * at / pitch_um) for at in middle)
        shown = values[row - half : row + half, column - half : column + half]
        axes.imshow(shown, cmap="gray", vmin=0.0, vmax=1.0, **AS_SAMPLED)
        axes.set_title(title)
        scale_bar(axes, shown.shape, pitch_um)
    figure.savefig(picture, dpi=100)


def fronts(one: Path, two: Path, picture: Path) -> None:
    """Yields against track: lenses of one element and of two, glass by glass."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 4.4), layout="constrained")
    axes = figure.subplots()
    for folder, marker, words in ((one, "o", "one"), (two, "s", "two")):
        with (folder / "front.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        for glasses in dict.fromkeys(row["glasses"] for row in rows):
            own = [row for row in rows if row["glasses"] == glasses]
            at = np.array([[float(row["track_mm"]), 100.0 * float(row["yield"])] for row in own])
            axes.plot(*at.T, marker, ms=5.0, label=f"{words}: {glasses}")
    axes.plot(45.2, PAPER_YIELD, "k*", ms=9.0, label="the paper's lens")
    axes.axhline(95.0, color="0.6", lw=0.8)
    axes.set_xlabel("track (mm)")
    axes.set_ylabel("good lenses, predicted (%)")
    axes.grid(color="0.9", lw=0.6)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    figure.savefig(picture, dpi=DOTS_PER_INCH)


def overview(frames: Path, found: Path, picture: Path) -> None:
    """The object, the frame on its first plane, and the reconstruction side by side."""
    from matplotlib.figure import Figure

    from wavesim import read_frames
    from wavesim.plots.panels import AS_SAMPLED, scale_bar

    result, true, pitch_um = _amplitudes(frames, found)
    offsets = np.arange(len(true)) - 0.5 * (len(true) - 1)
    inside = np.hypot(offsets[:, None], offsets) < 0.5 * len(true)
    frame = read_frames([frames / "frame_1.tif"])[0]
    light = np.clip(frame.counts - frame.settings.offset_counts, 0.0, None)
    # The middle of the frame, where nearly all light falls; square roots of counts show faint light.
    half = len(light) // 5
    recorded = np.sqrt(light[tuple(slice(count // 2 - half, count // 2 + half) for count in light.shape)])
    figure = Figure(figsize=(12.0, 4.4))
    for axes, title, values, brightest, sample_um in zip(
        figure.subplots(1, 3),
        ("object", "first frame on the sensor: no image", "reconstruction from two frames"),
        (np.where(inside, true, 0.0), recorded, np.where(inside, result, 0.0)),
        (1.0, float(recorded.max()), 1.0),
        (pitch_um, frame.settings.pixel_pitch_um, pitch_um),
        strict=True,
    ):
        axes.imshow(values, cmap="gray", vmin=0.0, vmax=brightest, **AS_SAMPLED)
        axes.set_title(title)
        scale_bar(axes, values.shape, sample_um)
    figure.savefig(picture, dpi=90, bbox_inches="tight")


def studio(light: Path, dark: Path) -> None:
    """The workbench with the paper's lens, decentered and tilted, on light and on dark ground."""
    from playwright.sync_api import sync_playwright

    from benchmarks.workbench import served

    with served() as address, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for scheme, picture in (("light", light), ("dark", dark)):
            page = browser.new_page(viewport={"width": 1440, "height": 1500}, color_scheme=scheme)
            page.goto(address)
            page.get_by_role("tab", name="What if", exact=True).click()
            for label, amount in (("lens decenter y, mm", "0.03"), ("lens tilt x, °", "0.1")):
                box = page.get_by_label(label, exact=True)
                box.fill(amount)
                box.press("Enter")
            page.locator(".text-block[data-state=settled] .constraint").first.wait_for(timeout=120_000)
            # The pictures of wavefronts and patch follow the figures, first coarsely.
            page.wait_for_timeout(5_000)
            page.wait_for_function("!('pending' in document.documentElement.dataset)", timeout=120_000)
            page.wait_for_timeout(20_000)
            page.screenshot(path=picture)
            page.close()
        browser.close()


def bench(frames: Path, wrong: Path, calibrated: Path, picture: Path) -> None:
    """The object, a frame, and the reconstructions without and with a calibration."""
    from matplotlib.figure import Figure

    from wavesim import read_frames
    from wavesim.plots.panels import AS_SAMPLED, scale_bar

    uncorrected, true, pitch_um = _amplitudes(frames, wrong)
    corrected, _, _ = _amplitudes(frames, calibrated)
    frame = read_frames([frames / "frame_1.tif"])[0]
    recorded = np.sqrt(np.clip(frame.counts - frame.settings.offset_counts, 0.0, None))
    figure = Figure(figsize=(12.0, 3.4), layout="constrained")
    for axes, title, values, brightest, sample_um in zip(
        figure.subplots(1, 4),
        ("object", "first frame", "found without a calibration", "found with a calibration"),
        (true, recorded, uncorrected, corrected),
        (1.0, float(recorded.max()), 1.0, 1.0),
        (pitch_um, frame.settings.pixel_pitch_um, pitch_um, pitch_um),
        strict=True,
    ):
        axes.imshow(values, cmap="gray", vmin=0.0, vmax=brightest, **AS_SAMPLED)
        axes.set_title(title)
        scale_bar(axes, values.shape, sample_um)
    _drawn(figure, 90).quantize(64).save(picture, optimize=True)


def main(arguments: list[str]) -> None:
    """Draw what is asked for."""
    pictures = {
        "figure-7": (figure_7, 2),
        "whole-field": (whole_field, 3),
        "fronts": (fronts, 3),
        "overview": (overview, 3),
        "studio": (studio, 2),
        "bench": (bench, 4),
    }
    name, *paths = arguments or [""]
    if name not in pictures or len(paths) != pictures[name][1]:
        raise SystemExit(__doc__)
    pictures[name][0](*map(Path, paths))


if __name__ == "__main__":
    main(sys.argv[1:])
