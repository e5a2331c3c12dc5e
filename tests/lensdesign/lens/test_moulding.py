"""Limits of moulding: families of materials, sources, and settings in a design file."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import pytest
from places import DESIGNS, ROOT

from lensdesign.errors import DesignError
from lensdesign.files.design import load_design, save_design
from lensdesign.lens.lens import Lens
from lensdesign.lens.moulding import LIMITS, Moulding, plastic_family
from lensdesign.optimization.specification.specification import load_specification


@pytest.mark.parametrize(
    ("material", "family"),
    [
        ("PMMA", "PMMA"),
        ("acrylic", "PMMA"),
        ("house.agf:PMMA_2", "PMMA"),
        ("POLYCARB@40C", "PC"),
        ("PC", "PC"),
        ("POLYSTYR", "PS"),
        ("E48R", "cyclic olefin"),
        ("TOPAS5013", "cyclic olefin"),
        ("APEL5514ML", "cyclic olefin"),
        ("NAS-21", "other plastic"),
        ("N-BK7", None),
        ("PSK3", None),
        ("SILICA", None),
        (1.49, None),
        (None, None),
    ],
)
def test_families_of_materials(material: str | float | None, family: str | None) -> None:
    assert plastic_family(material) == family


def test_every_limit_has_a_source_that_can_be_found() -> None:
    for key, families in LIMITS.items():
        assert key in Moulding.model_fields
        for limit in families.values():
            assert math.isfinite(limit.value)
            assert limit.sources
            for source in limit.sources:
                assert source.title
                assert source.address.startswith("http")
                assert any(character.isdigit() for character in source.states)


def test_ranges_of_the_table_are_in_order() -> None:
    keys = sorted(LIMITS, key=lambda key: (key[4:], key), reverse=True)
    ranges = [(low, high) for low, high in pairwise(keys) if low[4:] == high[4:]]
    assert {low for low, _ in ranges} == {"min_thickness_mm", "min_gate_thickness_ratio"}
    for low, high in ranges:
        for family, limit in LIMITS[low].items():
            assert limit.value < LIMITS[high][family].value


@pytest.mark.parametrize(
    ("table", "families"),
    [
        ("", ["PMMA", None]),
        ('process = "injection"', ["PMMA", "other plastic"]),
        ('process = "pressed_glass"', ["PMMA", "glass"]),
        ('process = "none"', [None, None]),
        ('process = "pressed_glass"\nelements = [2]', [None, "glass"]),
    ],
)
def test_which_elements_are_moulded(table: str, families: list[str | None]) -> None:
    import tomllib

    settings = Moulding.model_validate(tomllib.loads(table))
    assert [settings.family(m, n) for n, m in enumerate(("PMMA", "N-BK7"), start=1)] == families


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('process = "casting"', r"moulding, process = 'casting'"),
        ('off = ["gates"]', r"moulding, off"),
        ("elements = [2]", r"elements has 2, but the lens has 1; allowed: 1 to 1"),
        ("elements = [0]", r"moulding, elements"),
        ("min_draft_deg = -1.0", r"moulding, min_draft_deg = -1"),
        ("max_thickness_ratio = 0.5", r"moulding, max_thickness_ratio = 0.5"),
        ("tool_radius_mm = 0.0", r"moulding, tool_radius_mm = 0"),
        ("tool_included_angle_deg = 200.0", r"moulding, tool_included_angle_deg = 200"),
        ("min_thickness_mm = 2.0\nmax_thickness_mm = 1.0", r"min_thickness_mm = 2 must not be greater"),
        ("draft = 1.0", r"unknown key"),
    ],
)
def test_bad_settings_are_refused(tmp_path: Path, table: str, message: str) -> None:
    path = tmp_path / "lens.toml"
    path.write_text(f"{(DESIGNS / 'phone_lens.toml').read_text()}\n[moulding]\n{table}\n")
    with pytest.raises(DesignError, match=message):
        load_design(path)


def test_a_specification_passes_its_settings_to_the_lens(tmp_path: Path) -> None:
    path = tmp_path / "spec.toml"
    text = (DESIGNS / "phone_lens_spec.toml").read_text()
    path.write_text(f"{text}\n[moulding]\nmax_thickness_ratio = 3.0\n")
    found = load_specification(path).lens
    assert found.moulding == Moulding(max_thickness_ratio=3.0)


def test_a_design_file_keeps_its_settings(paper_lens: Lens, tmp_path: Path) -> None:
    lens = paper_lens.replaced(moulding=Moulding(process="pressed_glass", off=("sag",), max_slope_deg=40.0))
    save_design(lens, tmp_path / "lens.toml")
    assert load_design(tmp_path / "lens.toml") == lens


def test_the_page_has_every_limit_and_the_addresses_of_its_sources() -> None:
    page = (ROOT / "docs" / "making.md").read_text(encoding="utf-8")
    for limits in LIMITS.values():
        for limit in limits.values():
            assert f"{limit.value:g}" in page
            for source in limit.sources:
                assert source.address in page
