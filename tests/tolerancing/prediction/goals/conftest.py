"""A specification with a tolerance study, on the best lens of a designer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from lensdesign import load_design
from lensdesign.lens.lens import Lens
from lensdesign.optimization import load_specification
from lensdesign.optimization.specification.specification import Specification

FOLDER = Path(__file__).parents[3] / "golden" / "designer_b"


@pytest.fixture(scope="session")
def best_lens() -> Lens:
    return load_design(FOLDER / "best.toml")


@pytest.fixture
def specified(tmp_path: Path) -> Callable[..., Specification]:
    """Reads the designer's specification with more tables in its study, and other lines."""

    def make(more: str = "", limit: float = 0.0714, **changes: str) -> Specification:
        study = (FOLDER / "study_best.toml").read_text(encoding="utf-8")
        study = study.replace("at_most = 0.0714", f"at_most = {limit:g}")
        (tmp_path / "study.toml").write_text(study + more, encoding="utf-8")
        (tmp_path / "best.toml").write_bytes((FOLDER / "best.toml").read_bytes())
        text = (FOLDER / "spec_y.toml").read_text(encoding="utf-8")
        for old, new in changes.items():
            assert old in text, old
            text = text.replace(old, new)
        (tmp_path / "spec.toml").write_text(text, encoding="utf-8")
        return load_specification(tmp_path / "spec.toml")

    return make
