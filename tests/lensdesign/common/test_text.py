"""Texts of numbers."""

import pytest

from lensdesign.common.text import (
    counted_reasons,
    decimals_text,
    name_with_unit,
    number_with_unit,
    quantity_label,
    quantity_sentence,
)


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


@pytest.mark.parametrize(
    ("name", "label", "sentence"),
    [
        ("tilt_x_deg", "tilt x (°)", "tilt x 0.1°"),
        ("plane_2_shift_x_mm", "plane 2 shift x (mm)", "plane 2 shift x 0.1 mm"),
        ("contrast_0p775um_refocused", "contrast 0.775 µm refocused", "contrast 0.775 µm refocused 0.1"),
        ("radius_percent", "radius (%)", "radius 0.1 %"),
        ("deg", "deg", "deg 0.1"),
    ],
)
def test_names_of_quantities_become_words(name: str, label: str, sentence: str) -> None:
    assert quantity_label(name) == label
    assert quantity_sentence(name, "0.1") == sentence


def test_reasons_that_differ_in_numbers_count_as_one() -> None:
    reasons = {"beam of 4.1 mm is too narrow": 2, "beam of 3 mm is too narrow": 5, "no glass": 3}
    assert counted_reasons(reasons) == {"beam of 3 mm is too narrow": 7, "no glass": 3}
