"""Colour filter arrays: their pattern on the pixels, their tables, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.scene.settings import SettingError
from wavesim.sensor.colour_filters import ColourFilters, colour_filters

WAVELENGTHS_UM = (0.45, 0.532, 0.635)
TABLE = """wavelengths_um = [0.45, 0.532, 0.635]
pattern = ["RG", "GB"]

[responses]
R = [0.0, 0.1, 0.9]
G = [0.1, 1.0, 0.2]
B = [0.8, 0.1, 0.0]
"""


def test_a_pattern_repeats_over_the_pixels() -> None:
    blue, green, red = ColourFilters.bayer(WAVELENGTHS_UM).on_pixels((5, 4))
    assert blue.shape == green.shape == red.shape == (5, 4)
    assert (red[0, 0], green[0, 1], green[1, 0], blue[1, 1]) == (0.9, 0.95, 0.95, 0.92)
    for one in (blue, green, red):
        assert np.array_equal(one[2:4], one[:2])
        assert np.array_equal(one[:, 2:], one[:, :2])
        assert np.array_equal(one[4], one[0])


def test_pixels_without_filters_have_one_response() -> None:
    filters = ColourFilters.monochrome(WAVELENGTHS_UM)
    assert filters.is_monochrome
    assert [float(one) for one in filters.on_pixels((3, 3))] == [1.0, 1.0, 1.0]


def test_a_file_gives_the_responses_of_the_light_in_its_order(tmp_path: Path) -> None:
    path = tmp_path / "filters.toml"
    path.write_text(TABLE, encoding="utf-8")
    filters = colour_filters(str(path), (0.635, 0.45))
    assert filters.wavelengths_um == (0.635, 0.45)
    assert filters.responses == {"R": (0.9, 0.0), "G": (0.2, 0.1), "B": (0.0, 0.8)}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"GB"', '"GBR"', "rows of the same"),
        ('["RG", "GB"]', "[]", "1 to 16 rows"),
        ("B = [0.8, 0.1, 0.0]\n", "", "filters B, G, R"),
        ("B = [0.8, 0.1, 0.0]", "B = [0.8, 0.1]", "responses of B: 2 numbers; must be 3"),
        ("B = [0.8, 0.1, 0.0]", "B = [0.8, 0.1, 1.5]", "less than or equal to 1|at most 1"),
        ("0.45, 0.532, 0.635]", "0.45, 0.45, 0.635]", "two or more different"),
        ("0.45, 0.532, 0.635]", "0.46, 0.532, 0.635]", "no responses to 0.45 um"),
        ("pattern", "patern", "patern"),
    ],
)
def test_a_wrong_table_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "filters.toml"
    path.write_text(TABLE.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        colour_filters(str(path), WAVELENGTHS_UM)
    assert "filters.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "wavelengths", "message"),
    [
        ("bayer", (0.45, 0.9), "0.9: the typical Bayer filters"),
        ("mosaic", WAVELENGTHS_UM, "must be monochrome, bayer, or a TOML file"),
        ("monochrome", (0.45, 0.45), "two or more different"),
    ],
)
def test_a_wrong_name_or_wavelength_is_named(name: str, wavelengths: Any, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        colour_filters(name, wavelengths)


def test_a_wavelength_that_no_filter_passes_is_named() -> None:
    with pytest.raises(ValueError, match=r"0\.45 um: no filter passes it"):
        ColourFilters(wavelengths_um=(0.45, 0.6), responses={"M": (0.0, 1.0)})
