"""The registry of merits: a new merit is one class and one line here."""

from __future__ import annotations

from typing import Any

from lensdesign.files import validate
from tolerancing.chain_merit import ReconstructedContrast
from tolerancing.line_pair_merit import LinePairContrast
from tolerancing.merit import Merit
from tolerancing.pupil_merits import (
    ImageShift,
    ModulationTransfer,
    RmsWaves,
    SmallestResolvedLine,
    Strehl,
)
from tolerancing.python_merit import PythonMerit
from tolerancing.ray_merits import FootprintRadius, LargestSpread, Throughput
from tolerancing.registry import pick

MERITS: dict[str, type[Merit]] = {
    "largest_spread_deg": LargestSpread,
    "footprint_radius_mm": FootprintRadius,
    "throughput": Throughput,
    "strehl": Strehl,
    "rms_waves": RmsWaves,
    "line_pair_contrast": LinePairContrast,
    "mtf": ModulationTransfer,
    "smallest_resolved_line_um": SmallestResolvedLine,
    "image_shift_um": ImageShift,
    "reconstructed_contrast": ReconstructedContrast,
    "python": PythonMerit,
}
"""Merits by the kind that a study file gives."""


def merit_from_table(table: dict[str, Any], source: str) -> Merit:
    """Read one ``[[merit]]`` table.

    Raises
    ------
    DesignError
        For each fault: which key and value, and what is allowed.
    """
    return validate(pick(MERITS, table, "kind", source), table, source)
