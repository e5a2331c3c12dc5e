"""Sections about the result of a study and about its lens."""

from __future__ import annotations

import numpy as np

from lensdesign.errors import TransferLensError
from lensdesign.lens.surface import Surface
from tolerancing.report.blocks import (
    Block,
    Cell,
    Facts,
    FigureBlock,
    Heading,
    Headline,
    Panel,
    Paragraph,
    Table,
    Warning,
    counted,
    joined,
    number_text,
    percent_text,
    span_text,
    table,
)
from tolerancing.report.data import ReportData
from tolerancing.statistics.summary import MeritSummary, Summary


def summary_section(data: ReportData) -> list[Block]:
    """Return the result: the yield, all merits, and the most harmful perturbations."""
    summary = data.summary
    blocks: list[Block] = [Heading("Summary")]
    if not summary.complete:
        blocks.append(Warning(unfinished_text(summary)))
    blocks.append(_headline(summary))
    blocks += [_merits(summary), *_disagreement(summary), *_offenders(data)]
    return blocks


def unfinished_text(summary: Summary) -> str:
    """Describe how much of a run is finished."""
    return (
        f"This run is not finished: the store holds {summary.trials:,} of {summary.record.planned_trials:,} "
        f"trials and {summary.steps:,} of {summary.planned_steps:,} steps of sweeps, grids, slice counts and "
        "sensitivities."
    )


def verdict(summary: Summary) -> tuple[str, bool]:
    """Return the verdict on a study as text, and whether it is a fail.

    *Pass*: every trial and the nominal lens keep every limit. *Fail*: the nominal lens misses a limit, or
    fewer than half of the trials keep them all. *Pass in part*: anything between.
    """
    missed = [m for m in summary.merits if m.nominal is not None and not m.merit.passed(m.nominal)]
    if missed:
        return "Fail: the nominal lens misses " + joined([m.merit.column for m in missed]), True
    if summary.good is None:
        return "No trials yet", False
    if summary.good.passed == summary.good.total:
        return "Pass: every trial keeps every limit", False
    if summary.good.fraction < 0.5:
        return "Fail: most trials miss a limit", True
    return "Pass in part: the nominal lens and most trials keep every limit", False


def _headline(summary: Summary) -> Headline:
    verdict_text, failed = verdict(summary)
    good = summary.good
    if good is None:
        return Headline("–", verdict_text, "The store holds no trials.", failed)
    lost = (
        f"{summary.failed:,} could not be scored and count as bad."
        if summary.failed
        else "All trials could be scored."
    )
    text = (
        f"Yield: {good.passed:,} of {good.total:,} trials keep every limit; 95 % confidence interval "
        f"{percent_text(good.low)} to {percent_text(good.high)}. {lost}"
    )
    return Headline(percent_text(good.fraction), verdict_text, text, failed)


def merit_verdict(row: MeritSummary) -> Cell:
    """Return the verdict on one merit as a table cell."""
    if row.nominal is not None and not row.merit.passed(row.nominal):
        return Cell("fail: nominal lens misses", failed=True)
    if row.good is None:
        return Cell("–")
    missed = row.good.total - row.good.passed
    if not missed:
        return Cell("pass")
    if row.good.fraction < 0.5:
        return Cell("fail: most trials miss", failed=True)
    return Cell(f"in part: {counted(missed, 'trial misses', 'trials miss')}")


def _merits(summary: Summary) -> Table:
    rows: list[list[Cell | str]] = []
    for row in summary.merits:
        good, merit = row.good, row.merit
        numbers = [row.nominal, *(row.percentiles.get(p) for p in (50, 5, 95))]
        cells = [Cell(number_text(v), failed=v is not None and not bool(merit.passed(v))) for v in numbers]
        rows.append(
            [
                merit.column,
                merit_verdict(row),
                merit.limit_text,
                *cells,
                percent_text(good.fraction) if good else "–",
                Cell(span_text(good.low, good.high), bar=(good.fraction, good.low, good.high))
                if good
                else "–",
            ]
        )
    headings = ["<Merit", "<Verdict", "<Limit", "Nominal", "Median", "5 %", "95 %", "Yield", "<95 % interval"]
    caption = (
        "Numbers in red miss the limit. 5 % and 95 % are percentiles of the trials that have a score. A "
        "merit passes if the nominal lens and every trial keep its limit, and fails if the nominal lens or "
        "most trials miss it."
    )
    return table(headings, rows, caption)


def _disagreement(summary: Summary) -> list[Block]:
    """Return a sentence on the merits that reject most and fewest trials, if more than chance parts them."""
    rows = [(row.merit.column, row.good) for row in summary.merits if row.good is not None]
    if len(rows) < 2:
        return []
    (strict, fewest), (mild, most) = (end(rows, key=lambda row: row[1].fraction) for end in (min, max))
    if fewest.high >= most.low:
        return []
    return [
        Paragraph(
            f"The merits disagree about these lenses: {percent_text(most.fraction)} of the trials meet "
            f"{mild}, but only {percent_text(fewest.fraction)} meet {strict}, which decides the yield. "
            "Either that limit is tighter than the lens needs, or the other merit does not see the errors "
            "that matter."
        )
    ]


def _offenders(data: ReportData) -> list[Block]:
    """Return the three most harmful perturbations, by their fraction of the merits' variance."""
    fractions, study = data.variance_fractions, data.study
    if fractions is None or not np.any(fractions):
        return []
    bad = np.array([1.0 - m.good.fraction if m.good else 0.0 for m in data.summary.merits])
    weights = bad / bad.sum() if bad.sum() > 0.0 else np.full(len(bad), 1.0 / len(bad))
    together = weights @ fractions
    order = np.argsort(-together, kind="stable")[:3]
    rows = []
    for k in order:
        if together[k] > 0.0:
            strongest = int(np.argmax(weights * fractions[:, k]))
            rows.append(
                [
                    study.perturbations[k].column,
                    Cell(percent_text(together[k]), bar=(float(together[k]),) * 3),
                    f"{percent_text(fractions[strongest, k])} of that of {study.merits[strongest].column}",
                ]
            )
    source = (
        "from the sensitivities (section 4)"
        if data.sensitivity is not None
        else "from squared rank correlations over the trials, because some sensitivities are missing"
    )
    weighting = (
        "each merit has the weight of the trials that miss its limit"
        if bad.sum() > 0.0
        else "all merits have the same weight"
    )
    caption = f"Fraction of the merits' variance, {source}; {weighting}."
    return [Heading("Worst offenders", 3), table(["<Perturbation", "<Fraction", "<Most"], rows, caption)]


def lens_section(data: ReportData) -> list[Block]:
    """Return the lens: its specification, its space-bandwidth products, its layout and its surfaces."""
    from lensdesign.analysis.space_bandwidth import match

    lens, light = data.lens, data.lens.wavelengths_um
    found = match(lens, light[0])
    width, height = lens.sensor.size_mm
    planes = ", ".join(f"{d:g}" for d in lens.sensor.plane_distances_mm)
    facts = (
        ("Lens", lens.title or data.study.design),
        ("Field", f"⌀ {lens.object.field_diameter_mm:g} mm"),
        ("Numerical aperture", f"{lens.object.numerical_aperture:g}"),
        ("Working distance", f"{lens.object.working_distance_mm:g} mm"),
        ("Wavelengths", ", ".join(f"{w:g}" for w in light) + " µm"),
        ("Sensor", f"{' × '.join(map(str, lens.sensor.pixels))} pixels of {lens.sensor.pixel_pitch_um:g} µm"),
        ("Sensor size", f"{width:.2f} × {height:.2f} mm"),
        ("Planes", f"{planes} mm behind the exit vertex"),
        ("SBP of the object", f"{found.sbp_object:.4g}"),
        ("SBP of the sensor", f"{found.sbp_sensor:.4g} ({found.sbp_ratio:.2f} times the object's)"),
        ("Spread-angle limit", f"{found.spread_limit_deg:.3f}°"),
        ("Resolution", f"{found.resolution_um:.3f} µm"),
    )  # fmt: skip
    note = (
        "Space-bandwidth products (SBP, Eq. 1), spread-angle limit (Eq. 2), resolution and indices at "
        f"{light[0]:g} µm."
    )
    return [
        Heading("System and layout"),
        Facts(facts),
        Paragraph(note, soft=True),
        *_layout(data),
        _surfaces(data),
    ]


def _layout(data: ReportData) -> list[Block]:
    from lensdesign.plots.plots import layout_figure

    try:
        figure = layout_figure(data.lens)
    except TransferLensError as error:
        return [Warning(f"The layout cannot be drawn: {error}")]
    return [
        FigureBlock((Panel(figure, "Meridional section of the lens with rays, object and sensor planes"),))
    ]


def _surfaces(data: ReportData) -> Table:
    rows, indices = [], data.lens.indices(data.lens.wavelengths_um[0])
    for number, s in enumerate(data.lens.surfaces, start=1):
        material = "air" if s.material is None else str(s.material)
        rows.append(
            [
                f"{number}{' (stop)' if s.stop else ''}",
                "plane" if s.radius_mm is None else number_text(s.radius_mm),
                number_text(s.conic),
                _shape_text(s),
                number_text(s.thickness_mm),
                material,
                f"{indices[number]:.6f}",
                number_text(s.semi_diameter_mm),
            ]
        )
    headings = [
        "<Surface", "Radius (mm)", "Conic", "Shape", "Thickness (mm)", "<Material behind",
        "Index", "Semi-diameter (mm)",
    ]  # fmt: skip
    return table(headings, rows)


def _shape_text(surface: Surface) -> str:
    """Describe a surface's shape beyond radius and conic constant, by the keys of design files."""
    terms = []
    for key, value in surface.shape_keys.items():
        values = value if isinstance(value, tuple) else (value,)
        if key not in ("radius_mm", "conic") and values:
            terms.append(f"{key} {' '.join('plane' if v is None else f'{v:.4g}' for v in values)}")
    return ", ".join([surface.kind, *terms]) if terms else "–"
