"""The registry of merits: a new merit is one class and one line here."""

from __future__ import annotations

from typing import Any

from lensdesign.common.toml_files import pick, validate
from tolerancing.merits.base import Merit
from tolerancing.merits.ghosts import GhostFraction
from tolerancing.merits.line_pairs import LinePairContrast
from tolerancing.merits.pupil import (
    ImageShift,
    ModulationTransfer,
    RmsWaves,
    SmallestResolvedLine,
    Strehl,
)
from tolerancing.merits.python import PythonMerit
from tolerancing.merits.rays import (
    FootprintRadius,
    LargestSpread,
    ScatteredFraction,
    Throughput,
    Transmittance,
)
from tolerancing.merits.reconstructed_contrast import ReconstructedContrast
from tolerancing.merits.reconstruction.merit import Reconstruction
from tolerancing.merits.reconstruction_loss import ReconstructionLoss

MERITS: dict[str, type[Merit]] = {
    "largest_spread_deg": LargestSpread,
    "footprint_radius_mm": FootprintRadius,
    "throughput": Throughput,
    "transmittance": Transmittance,
    "scattered_fraction": ScatteredFraction,
    "ghost_fraction": GhostFraction,
    "strehl": Strehl,
    "rms_waves": RmsWaves,
    "line_pair_contrast": LinePairContrast,
    "mtf": ModulationTransfer,
    "smallest_resolved_line_um": SmallestResolvedLine,
    "image_shift_um": ImageShift,
    "reconstruction_loss": ReconstructionLoss,
    "reconstructed_contrast": ReconstructedContrast,
    "reconstruction": Reconstruction,
    "python": PythonMerit,
}
"""Merits by their kind in a study file."""


def merit_from_table(table: dict[str, Any], source: str) -> Merit:
    """Read one ``[[merit]]`` table.

    Parameters
    ----------
    table
        Keys and values of the table.
    source
        File and table, for error messages.

    Raises
    ------
    DesignError
        If a key or value is not allowed. The message lists every fault.

    Examples
    --------
    >>> merit_from_table({"kind": "strehl", "at_least": 0.8}, "study.toml").column
    'strehl'
    """
    return validate(pick(MERITS, table, "kind", source), table, source)
