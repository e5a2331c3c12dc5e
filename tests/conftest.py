"""What all tests share."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from places import DESIGNS, GOLDEN

from lensdesign import Lens, load_design

# The first example compiles kernels, which takes longer than any deadline for a single one.
settings.register_profile(
    "transferlens", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("transferlens")


@pytest.fixture(scope="session")
def paper_design() -> Path:
    """The paper's lens, as a file."""
    return DESIGNS / "paper_singlet.toml"


@pytest.fixture(scope="session")
def paper_lens(paper_design: Path) -> Lens:
    """The paper's lens."""
    return load_design(paper_design)


@pytest.fixture(scope="session")
def golden() -> Path:
    """Folder of the golden data."""
    return GOLDEN
