"""The values that can be edited, how they are read, and the steps of their sliders."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import DESIGNS

from lensdesign import InputError
from lensdesign.common.text import round_number_below
from studio.model.document import opened
from studio.model.editing import value_at, with_value
from studio.model.values import STEPS, glasses_like, parsed, path_of_key, values_of


@pytest.mark.parametrize("name", ["paper_singlet", "moulded_pair", "rectangular_sensor", "phone_lens"])
def test_every_value_is_that_of_the_file_and_can_be_written_back(name: str) -> None:
    _, editing = opened(DESIGNS / f"{name}.toml")
    tables = editing.now.tables
    for value in values_of(tables, tables, editing.lens):
        assert path_of_key(value.key) == value.table_path
        held = value_at(tables, value.table_path)
        read = parsed(value.kind, value.text)
        assert read == held or read == pytest.approx(held or 0.0, rel=1e-9)
        if value.number is not None:
            assert value.low <= value.number <= value.high
            assert (value.high - value.low) / value.step == pytest.approx(2 * STEPS)
        if held is not None:
            editing.changed(with_value(tables, value.table_path, read), "it is a lens")


def test_a_slider_stands_while_one_drags_and_follows_what_is_typed() -> None:
    _, editing = opened(DESIGNS / "paper_singlet.toml")

    def slider(radius: float) -> tuple[float, float]:
        tables = with_value(editing.now.tables, ("surface", 1, "radius_mm"), radius)
        found = values_of(tables, editing.now.tables, editing.changed(tables, "").lens)
        return next((v.low, v.high) for v in found if v.key == "surface.1.radius_mm")

    assert slider(-12.0) == slider(-12.4)
    low, high = slider(-30.0)
    assert low < -30.0 < high


@given(st.floats(1e-9, 1e9))
def test_steps_are_round_and_not_larger(value: float) -> None:
    step = round_number_below(value)
    assert 0.39 * value <= step <= value * (1.0 + 1e-9)
    assert round(step / 10.0 ** math.floor(math.log10(step) + 1e-9), 6) in (1.0, 2.0, 5.0)


def test_what_is_typed() -> None:
    assert parsed("number", " −12.5 ") == -12.5
    assert parsed("number", "plane") is None
    assert parsed("whole", "7000") == 7000
    assert parsed("glass", "1.5") == 1.5
    assert parsed("glass", "N-SF11") == "N-SF11"
    for kind, text in (("number", "x"), ("whole", "1.5")):
        with pytest.raises(InputError, match="must be a"):
            parsed(kind, text)


def test_glasses_are_found_by_parts_of_their_names() -> None:
    _, editing = opened(DESIGNS / "paper_singlet.toml")
    assert glasses_like("n-bk", editing.lens)[0] == "N-BK7"
    assert glasses_like("NBK7", editing.lens) != []  # the nearest
    assert glasses_like("<script>", editing.lens) in ([], glasses_like("script", editing.lens))
