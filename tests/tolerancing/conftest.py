"""Small studies of a singlet."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tests_studies import DESIGN, FULL_STUDY, RAY_STUDY


@pytest.fixture
def write_study(tmp_path: Path) -> Callable[..., Path]:
    """Write a study and its design to a folder of the test's own; returns the study's path."""

    def write(text: str = RAY_STUDY, design: str = DESIGN) -> Path:
        (tmp_path / "design.toml").write_text(design, encoding="utf-8")
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def ray_study() -> str:
    """Text of a study of rays alone: two perturbations, one merit."""
    return RAY_STUDY


@pytest.fixture
def full_study() -> str:
    """Text of a study with a merit of rays, one of the pupil, and a sweep with a picture."""
    return FULL_STUDY
