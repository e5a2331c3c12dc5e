"""A study that judges the wavefront, for predictions and searches."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign import Lens

JUDGED = """
[[merit]]
name = "wavefront"
kind = "rms_waves"
field_points_mm = [[0.0, 0.0], [0.0, 1.0], [0.0, 1.4]]
at_most = 0.12
"""


@pytest.fixture(scope="module")
def wavefront_study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's lens and its tolerances, good where the wavefront is within 0.12 waves."""
    folder = tmp_path_factory.mktemp("wavefronts")
    whole = (DESIGNS / "paper_tolerances.toml").read_text(encoding="utf-8")
    path = folder / "study.toml"
    path.write_text(whole[: whole.index("# What a good system does")] + JUDGED, encoding="utf-8")
    (folder / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    return path


@pytest.fixture(scope="session")
def lens(paper_lens: Lens) -> Lens:
    """The lens whose predictions are tried."""
    return paper_lens
