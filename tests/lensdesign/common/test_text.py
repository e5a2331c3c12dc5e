"""Texts of numbers."""

import pytest

from lensdesign.common.text import decimals_text, name_with_unit, number_with_unit


@pytest.mark.parametrize(
    ("value", "places", "text"),
    [(-4e-4, 3, "0.000"), (-0.0, 2, "0.00"), (-6e-4, 3, "-0.001"), (1.23456, 2, "1.23")],
)
def test_no_minus_sign_before_a_zero(value: float, places: int, text: str) -> None:
    assert decimals_text(value, places) == text


@pytest.mark.parametrize(
    ("unit", "shown", "named"),
    [
        ("deg", "4.8°", "spread (°)"),
        ("um", "4.8 µm", "spread (µm)"),
        ("percent", "4.8 %", "spread (%)"),
        ("mm", "4.8 mm", "spread (mm)"),
        ("", "4.8", "spread"),
    ],
)
def test_units_are_written_as_people_write_them(unit: str, shown: str, named: str) -> None:
    assert number_with_unit("4.8", unit) == shown
    assert name_with_unit("spread", unit) == named
