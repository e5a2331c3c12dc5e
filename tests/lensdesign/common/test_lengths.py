"""The test of a length: what is plausible passes, and what another unit explains is questioned."""

from __future__ import annotations

import math

import pytest

from lensdesign.common.lengths import (
    PIXEL_PITCH_UM,
    WAVELENGTH_UM,
    PlausibleLength,
    implausible_values,
    in_unit,
)

WIDTH = PlausibleLength(0.1, 10.0, (0.5, 5.0), "is no width")


@pytest.mark.parametrize(
    ("value", "meant"),
    [(0.532, None), (532.0, "0.532"), (0.000532, "0.532"), (5320.0, "5.32"), (5.32e-7, "0.532")],
)
def test_a_wavelength_in_another_unit_is_questioned(value: float, meant: str | None) -> None:
    found = list(implausible_values("wavelengths_um", value, WAVELENGTH_UM, "um"))
    if meant is None:
        assert not found
    else:
        assert found == [
            f"wavelengths_um = {value:g}: must be 0.05 to 50, in micrometres; {meant} µm may be meant"
        ]


def test_without_another_unit_only_an_absolute_limit_refuses() -> None:
    assert WIDTH.objection(200.0, "mm") is None  # neither 0.2 nor any other change makes it usual
    assert WIDTH.objection(2000.0, "mm") == "is no width; 2 mm may be meant"
    assert PIXEL_PITCH_UM.objection(1e8, "um") == "must be 0.1 to 1000, in micrometres"


def test_either_sign_is_judged_alike_and_0_is_plausible() -> None:
    assert WIDTH.objection(-0.002, "mm") == "is no width; -2 mm may be meant"
    assert WIDTH.objection(0.0, "mm") is None
    assert WIDTH.objection(math.nan, "mm") is None
    assert WIDTH.at_most().objection(0.002, "mm") is None


def test_a_range_in_another_unit_is_the_same_range() -> None:
    assert in_unit(WIDTH, "um").objection(2e6, "um") == "is no width; 2000 µm may be meant"
    assert in_unit(WIDTH, "um").objection(2e3, "um") is None


def test_all_numbers_of_nested_values_are_judged() -> None:
    found = implausible_values("widths", ((1.0, 2000), [3000.0], "4000", True, None), WIDTH, "mm")
    assert [sentence.partition(":")[0] for sentence in found] == ["widths = 2000", "widths = 3000"]
