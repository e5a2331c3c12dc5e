"""Sections 1 and 2 of a report: what came out, and the lens that it is about."""

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

OFFENDERS = 3


def summary_section(data: ReportData) -> list[Block]:
    """The result: yield, merit by merit, and what does most harm."""
    summary = data.summary
    blocks: list[Block] = [Heading("Summary")]
    if not summary.complete:
        blocks.append(Warning(unfinished_text(summary)))
    blocks.append(_headline(summary))
    blocks += [_merits(summary), *_offenders(data)]
    return blocks


def unfinished_text(summary: Summary) -> str:
    """How far a run is."""
    return (
        f"This run is not finished: the store holds {summary.trials:,} of {summary.record.planned_trials:,} "
        f"trials and {summary.steps:,} of {summary.planned_steps:,} steps of sweeps, grids, slice counts and "
        "sensitivities."
    )


def verdict(summary: Summary) -> tuple[str, bool]:
    """Pass or fail in a word, and whether it is a fail.

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
    if summary.good.share < 0.5:
        return "Fail: most trials miss a limit", True
    return "Pass in part: the nominal lens and most trials keep every limit", False


def _headline(summary: Summary) -> Headline:
    words, failed = verdict(summary)
    good = summary.good
    if good is None:
        return Headline("–", words, "The store holds no trials.", failed)
    lost = (
        f"{summary.failed:,} could not be scored and count as bad."
        if summary.failed
        else "All trials could be scored."
    )
    text = (
        f"Yield: {good.passed:,} of {good.total:,} trials keep every limit; 95 % confidence interval "
        f"{percent_text(good.low)} to {percent_text(good.high)}. {lost}"
    )
    return Headline(percent_text(good.share), words, text, failed)


def merit_verdict(row: MeritSummary) -> Cell:
    """Pass or fail of one merit, in words."""
    if row.nominal is not None and not row.merit.passed(row.nominal):
        return Cell("fail: nominal lens misses", failed=True)
    if row.good is None:
        return Cell("–")
    missed = row.good.total - row.good.passed
    if not missed:
        return Cell("pass")
    if row.good.share < 0.5:
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
                percent_text(good.share) if good else "–",
                Cell(span_text(good.low, good.high), bar=(good.share, good.low, good.high)) if good else "–",
            ]
        )
    headings = ["<Merit", "<Verdict", "<Limit", "Nominal", "Median", "5 %", "95 %", "Yield", "<95 % interval"]
    caption = (
        "Numbers in red miss the limit. 5 % and 95 % are percentiles of the trials that have a score. A "
        "merit passes if the nominal lens and every trial keep its limit, and fails if the nominal lens or "
        "most trials miss it."
    )
    return table(headings, rows, caption)


def _offenders(data: ReportData) -> list[Block]:
    """The perturbations that do most harm: by their share of the merits' variance."""
    shares, study = data.variance_shares, data.study
    if shares is None or not np.any(shares):
        return []
    bad = np.array([1.0 - m.good.share if m.good else 0.0 for m in data.summary.merits])
    weights = bad / bad.sum() if bad.sum() > 0.0 else np.full(len(bad), 1.0 / len(bad))
    together = weights @ shares
    order = np.argsort(-together, kind="stable")[:OFFENDERS]
    rows = []
    for k in order:
        if together[k] > 0.0:
            strongest = int(np.argmax(weights * shares[:, k]))
            rows.append(
                [
                    study.perturbations[k].column,
                    Cell(percent_text(together[k]), bar=(float(together[k]),) * 3),
                    f"{percent_text(shares[strongest, k])} of that of {study.merits[strongest].column}",
                ]
            )
    source = (
        "from the sensitivities (section 4)"
        if data.sensitivity is not None
        else "by squared rank correlations over the trials, as not all sensitivities are there"
    )
    weighing = "merits weigh as many trials as miss them" if bad.sum() > 0.0 else "all merits weigh the same"
    caption = f"Share of the merits' variance, {source}; {weighing}."
    return [Heading("Worst offenders", 3), table(["<Perturbation", "<Share", "<Most"], rows, caption)]


def lens_section(data: ReportData) -> list[Block]:
    """The lens: what it is for, how it matches, what it looks like."""
    from lensdesign.analysis.matching import match

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
                _beside_the_conic(s),
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


def _beside_the_conic(surface: Surface) -> str:
    """What a surface's shape has beside radius and conic constant, by the names of design files."""
    said = []
    for key, value in surface.shape_keys.items():
        held = value if isinstance(value, tuple) else (value,)
        if key not in ("radius_mm", "conic") and held:
            said.append(f"{key} {' '.join('plane' if v is None else f'{v:.4g}' for v in held)}")
    return ", ".join([surface.kind, *said]) if said else "–"
