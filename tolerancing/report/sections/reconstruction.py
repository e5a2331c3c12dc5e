"""Section about reconstruction merits: correlation and contrast against each perturbation."""

from __future__ import annotations

from tolerancing.merits.reconstruction.merit import Reconstruction
from tolerancing.report.blocks import Block, FigureBlock, Heading, Paragraph
from tolerancing.report.data import ReportData
from tolerancing.report.figures.reconstruction import reconstruction_panel


def reconstruction_section(data: ReportData) -> list[Block]:
    """Return figures of correlation and contrast against each perturbation; empty without such merits."""
    merits = [merit for merit in data.study.merits if isinstance(merit, Reconstruction)]
    if not merits or not len(data.results):
        return []
    perturbations = data.study.perturbations[:12]  # trials.csv holds all of them.
    text = (
        "Agreement of the reconstructed object with the true object after the whole chain: frames are "
        "computed with the perturbed lens, and reconstructed with the reconstruction's own model. In the "
        "trials all perturbations vary together; dashed lines connect medians of the trials. Squares: one "
        "parameter alone, if the study sweeps it. Dotted red lines: limits."
    )
    return [
        Heading("Reconstruction: correlation and contrast"),
        Paragraph(text, soft=True),
        FigureBlock(tuple(reconstruction_panel(data, merits, one) for one in perturbations)),
    ]
