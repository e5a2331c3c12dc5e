"""Section about sweeps, grids and slice counts, and pictures of line pairs in single trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lensdesign.common.text import number_with_unit
from lensdesign.errors import TransferLensError
from tolerancing.merits.line_pairs import LinePairContrast
from tolerancing.merits.pupil import PupilMerit
from tolerancing.report.blocks import (
    Block,
    Cell,
    FigureBlock,
    Heading,
    Paragraph,
    Table,
    Warning,
    cut,
    joined,
    number_text,
    table,
)
from tolerancing.report.data import ReportData
from tolerancing.report.figures.series import (
    PLATE_COLUMNS,
    grid_panels,
    plate_panel,
    slice_panels,
    sweep_panels,
)
from tolerancing.study.evaluate import pupil_context, sample_perturbations
from tolerancing.study.results import Picture, StepResults
from tolerancing.study.series import LinePairSection, line_pair_picture
from tolerancing.study.slice_counts import SliceCounts
from tolerancing.study.sweep import ParameterGrid, Sweep


def series_section(data: ReportData) -> list[Block]:
    """Return all sweeps, grids and slice counts, with pictures as in the paper's Fig. 7."""
    study = data.study
    sections = [
        *(_sweep(data, sweep) for sweep in study.sweeps),
        *(_grid(data, grid) for grid in study.grids),
        *(_slices(data, counts) for counts in study.slice_counts),
    ]
    if not sections:
        return [Heading("Sweeps, grids and slice counts"), Paragraph("The study has none.")]
    return [
        Heading("Sweeps, grids and slice counts (as in the paper's Fig. 7)"),
        *(block for section in sections for block in section),
    ]


def _sweep(data: ReportData, sweep: Sweep) -> list[Block]:
    from tolerancing.report.figures.style import series_label

    steps = data.steps_of(sweep.label)
    blocks: list[Block] = [Heading(f"Sweep {sweep.label}: {series_label(sweep)}", 3)]
    if not steps:
        return [*blocks, Paragraph("No step is finished.")]
    blocks.append(Paragraph(f"{line_pair_text(sweep)}{_differences(data, sweep, steps)}", soft=True))
    blocks.append(FigureBlock(tuple(sweep_panels(data.study, sweep, steps)), columns=2))
    columns = [m.label for m in sweep.scored(data.study.all_merits)]
    blocks += _steps_table([sweep.parameter], columns, steps)
    return [
        *blocks,
        *_plates(steps, lambda s: number_with_unit(f"{s.coordinates[sweep.parameter]:g}", sweep.unit)),
    ]


def line_pair_text(section: LinePairSection) -> str:
    """Describe the line pairs of a sweep or grid."""
    if not section.line_widths_um:
        return "Everything else is nominal."
    x, y = section.field_mm
    axis = section.orientation
    orientation = "the worse of both orientations" if axis == "worse" else f"bars repeated along {axis}"
    return (
        f"Everything else is nominal. Line pairs at ({x:g}, {y:g}) mm in the object, {orientation}; with and "
        "without refocusing. Their contrast is that of the registered reconstruction pupil: the field behind "
        "the lens is taken as known."
    )


def _differences(data: ReportData, section: LinePairSection, steps: Sequence[StepResults]) -> str:
    """Describe how much contrasts of line pairs differ from the study's merits of the same line widths."""
    sentences = []
    for merit in data.study.all_merits:
        width = getattr(merit, "evaluated_width_um", getattr(merit, "line_width_um", None))
        if merit.label not in section.merits or width not in section.line_widths_um or merit.unit:
            continue
        pairs = next(p for p in section.line_pairs() if p.line_width_um == width and p.refocus)
        found = [abs(s.scores.get(pairs.label, np.nan) - s.scores.get(merit.label, np.nan)) for s in steps]
        known = [one for one in found if np.isfinite(one)]
        if known:
            sentences.append(f" They differ from {merit.label} by up to {max(known):.2g}.")
    return "".join(sentences)


def _grid(data: ReportData, grid: ParameterGrid) -> list[Block]:
    steps = data.steps_of(grid.label)
    blocks: list[Block] = [Heading(f"Grid {grid.label}: {grid.x.column} and {grid.y.column}", 3)]
    if not steps:
        return [*blocks, Paragraph("No step is finished.")]
    differences = _differences(data, grid, steps)
    blocks.append(Paragraph(f"{line_pair_text(grid)}{differences} Red: the limit.", soft=True))
    blocks.append(FigureBlock(tuple(grid_panels(data.study, grid, steps)), columns=2))
    columns = [m.label for m in grid.scored(data.study.all_merits)]
    return [*blocks, *_steps_table([grid.x.column, grid.y.column], columns, steps)]


def _slices(data: ReportData, series: SliceCounts) -> list[Block]:
    steps = data.steps_of(series.label)
    blocks: list[Block] = [Heading(f"Slice counts {series.label} (Fig. 7a)", 3)]
    if not steps:
        return [*blocks, Paragraph("No step is finished.")]
    note = (
        f"Lines at a field height of {series.field_height_mm:g} mm are propagated to the exit plane by the "
        "eikonal engine and back by annular slices, refocused and registered. Dashed: back-propagated by the "
        "eikonal engine itself. Vertical compensation is that of the paper; oblique compensation follows the "
        "slope of the light."
    )
    blocks.append(Paragraph(note, soft=True))
    blocks.append(FigureBlock(tuple(slice_panels(series, steps)), columns=2))
    columns = list(dict.fromkeys(label for s in steps for label in s.scores))
    blocks += _steps_table(["compensation", "slices"], columns, steps)
    return [
        *blocks,
        *_plates(steps, lambda s: f"{s.coordinates['compensation']}, {s.coordinates['slices']:g} slices"),
    ]


def _steps_table(
    coordinates: Sequence[str], labels: Sequence[str], steps: Sequence[StepResults]
) -> list[Table]:
    # Most steps in a table; steps.csv holds all of them.
    most_rows = 200
    rows: list[list[str]] = [
        _coordinate_cells(step, coordinates) + [number_text(step.scores.get(label)) for label in labels]
        for step in steps[:most_rows]
    ]
    more = len(steps) - most_rows
    caption = f"steps.csv holds {more} more steps." if more > 0 else ""
    scored = table([*(f"<{c}" for c in coordinates), *labels], rows, caption)
    failed: list[list[Cell | str]] = []
    for step in [step for step in steps if step.message][:20]:
        cause = Cell(cut(step.message, 240), failed=True)
        failed.append([*_coordinate_cells(step, coordinates), cause])
    if not failed:
        return [scored]
    return [scored, table([*(f"<{c}" for c in coordinates), "<Not scored, because"], failed)]


def _coordinate_cells(step: StepResults, coordinates: Sequence[str]) -> list[str]:
    values = [step.coordinates.get(name, "–") for name in coordinates]
    return [value if isinstance(value, str) else number_text(float(value)) for value in values]


def _plates(steps: Sequence[StepResults], title: Callable[[StepResults], str]) -> list[Block]:
    """Return plates of pictures, with line widths along one side and steps along the other."""
    pictured = [s for s in steps if s.pictures]
    kinds = sorted({(p.line_width_um, not p.refocused) for s in pictured for p in s.pictures})
    names = [f"{width:g} µm, {'not refocused' if plain else 'refocused'}" for width, plain in kinds]
    blocks: list[Block] = []
    for first in range(0, len(pictured), PLATE_COLUMNS):
        shown = pictured[first : first + PLATE_COLUMNS]
        found = [[_contrast_and_picture(step, width, not plain) for step in shown] for width, plain in kinds]
        titles = [title(step) for step in shown]
        rows, columns = names, titles
        if len(names) > len(titles):  # The plate gets the smaller number of rows.
            rows, columns, found = titles, names, [list(line) for line in zip(*found, strict=True)]
        plate = {
            row: [(f"{c}: {number}", picture) for c, (number, picture) in zip(columns, line, strict=True)]
            for row, line in zip(rows, found, strict=True)
        }
        panel = plate_panel(plate, f"Pictures of line pairs, {titles[0]} to {titles[-1]}")
        blocks.append(FigureBlock((panel,), caption=_plate_caption(pictured)))
    return blocks


def _plate_caption(pictured: Sequence[StepResults]) -> str:
    widths = {2.0 * picture.half_width_um for step in pictured for picture in step.pictures}
    sizes = joined([f"{width:.3g} µm" for width in sorted(widths)])
    return f"Line pairs with their contrast; pictures are {sizes} wide."


def _contrast_and_picture(step: StepResults, width_um: float, refocused: bool) -> tuple[str, Picture | None]:
    """Return the contrast of one line width in a step, and its picture."""
    picture = next(
        (p for p in step.pictures if (p.line_width_um, p.refocused) == (width_um, refocused)), None
    )
    name = f"contrast_{width_um:g}um".replace(".", "p")
    contrast = step.scores.get(f"{name}_refocused" if refocused else name, step.scores.get(name, np.nan))
    return (f"{contrast:.2f}" if np.isfinite(contrast) else "–"), picture


def trial_pictures(data: ReportData, rows: list[int]) -> list[Block]:
    """Return pictures of line pairs in single trials, given by row indices, which are computed again."""
    merit = next((m for m in data.study.merits if isinstance(m, LinePairContrast)), None) or next(
        (m for m in data.study.all_merits if isinstance(m, PupilMerit)), None
    )
    if merit is None or not rows:
        return []
    lens = data.lens
    wavelength = merit.wavelength_um or lens.wavelengths_um[0]
    width = (
        merit.line_width_um
        if isinstance(merit, LinePairContrast)
        else 1.5 * 0.5 * wavelength / lens.object.numerical_aperture  # 1.5 resolution limits
    )
    numbers = [int(data.trial_numbers[row]) for row in rows]
    try:
        shown = _drawn(data, merit, numbers, width)
    except TransferLensError as error:
        return [Warning(f"The worst trials cannot be drawn: {error}")]
    kinds = ["worst", "second worst", "third worst"][: len(rows)] + ["median"] * (len(rows) > 3)
    titled: list[tuple[str, Picture | None]] = [
        (f"{kind}: trial {number}\ncontrast {contrast:.2f}", picture)
        for kind, number, (contrast, picture) in zip(kinds, numbers, shown, strict=True)
    ]
    text = (
        f"{width:.4g} µm lines at ({merit.points[0][0]:g}, {merit.points[0][1]:g}) mm, "
        f"{'refocused' if merit.refocus else 'not refocused'}, along the worse axis, by the reconstruction "
        "pupil. The trials are computed again from their numbers."
    )
    panel = plate_panel({"": titled}, f"Line pairs of trials {', '.join(map(str, numbers))}")
    return [Heading("Line pairs of these trials", 3), Paragraph(text, soft=True), FigureBlock((panel,))]


def _drawn(
    data: ReportData, merit: PupilMerit, trials: Sequence[int], width_um: float
) -> list[tuple[float, Picture]]:
    """Return contrast and picture of each trial along its worse axis."""
    context = pupil_context(data.lens, data.study)
    batch = sample_perturbations(data.study, trials)
    pupils = context.pupils(batch, merit.points[0], merit.wavelength_um, merit.refocus, True)
    orientation = merit.orientation if isinstance(merit, LinePairContrast) else "worse"
    return [line_pair_picture(pupil, width_um, orientation, merit.refocus) for pupil in pupils]
