"""The section of the whole chain: what varies, against what the reconstruction keeps."""

from __future__ import annotations

from tolerancing.merits.reconstruction.merit import Reconstruction
from tolerancing.report.blocks import Block, FigureBlock, Heading, Paragraph
from tolerancing.report.data import ReportData
from tolerancing.report.figures.reconstruction import reconstruction_panel

MOST_PANELS = 12
"""Perturbations that are drawn; all stand in trials.csv."""


def reconstruction_section(data: ReportData) -> list[Block]:
    """Correlation and contrast of the whole chain against each perturbation; nothing without such merits."""
    merits = [merit for merit in data.study.merits if isinstance(merit, Reconstruction)]
    if not merits or not len(data.results):
        return []
    perturbations = data.study.perturbations[:MOST_PANELS]
    text = (
        "What the reconstruction keeps of the object after the whole chain: frames of the perturbed lens, "
        "and retrieval through the reconstruction's own model. In the trials all perturbations vary "
        "together; dashed lines join medians of the trials. Squares: one parameter by itself, where the "
        "study sweeps it. Dotted red: the limits."
    )
    return [
        Heading("Reconstruction: correlation and contrast"),
        Paragraph(text, soft=True),
        FigureBlock(tuple(reconstruction_panel(data, merits, one) for one in perturbations)),
    ]
