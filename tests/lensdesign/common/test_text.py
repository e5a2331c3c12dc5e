"""Texts of numbers."""

import pytest

from lensdesign.common.text import decimals_text


@pytest.mark.parametrize(
    ("value", "places", "text"),
    [(-4e-4, 3, "0.000"), (-0.0, 2, "0.00"), (-6e-4, 3, "-0.001"), (1.23456, 2, "1.23")],
)
def test_no_minus_sign_before_a_zero(value: float, places: int, text: str) -> None:
    assert decimals_text(value, places) == text
