"""A specification whose trade-off is known to be one, and its lenses."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign.exploration import Exploration, ExploredPoint, axes_of
from lensdesign.optimization import Specification, load_specification

OVER = "thickness,spread"


@pytest.fixture(scope="session")
def spec_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small field, which leaves something to trade."""
    text = (DESIGNS / "thinnest_singlet_spec.toml").read_text(encoding="utf-8")
    for old, new in (
        ("field_diameter_mm = 3.0", "field_diameter_mm = 2.4"),
        ("[optimize]\n", "[optimize]\nmax_evaluations = 2000\n"),
    ):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path_factory.mktemp("explored") / "spec.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def specification(spec_path: Path) -> Specification:
    return load_specification(spec_path)


@pytest.fixture(scope="session")
def explored(specification: Specification) -> list[ExploredPoint]:
    return Exploration(specification, axes_of(OVER, specification), lenses=4).run()
