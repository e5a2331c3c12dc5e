"""Glasses by name and by catalogue."""

from __future__ import annotations

import pytest

from lensdesign.errors import InputError, MaterialError
from lensdesign.exploration.glasses import with_glasses
from lensdesign.optimization import Specification


def test_names_become_choices_of_the_first_element(specification: Specification) -> None:
    asked = with_glasses(specification, "N-BK7, N-SF11")
    *rest, material = asked.variables
    assert (material.parameter, material.surface, material.choices) == ("material", 1, ("N-BK7", "N-SF11"))
    again = with_glasses(asked, "N-BK7")
    assert [v.name for v in again.variables] == [*(v.name for v in rest), "surface 1 material"]


def test_a_catalogue_is_all_its_glasses_that_are_known_here(specification: Specification) -> None:
    choices = with_glasses(specification, "catalogue:SCHOTT").variables[-1].choices
    assert {"N-BK7", "N-SF11"} <= set(choices)
    assert len(choices) > 100


def test_what_is_no_glass_is_refused(specification: Specification) -> None:
    with pytest.raises(InputError, match=r"no such catalogue.*Schott"):
        with_glasses(specification, "catalogue:ZEISS")
    with pytest.raises(MaterialError, match="N-BK77"):
        with_glasses(specification, "N-BK77")
    with pytest.raises(InputError, match="names no glass"):
        with_glasses(specification, " , ")
