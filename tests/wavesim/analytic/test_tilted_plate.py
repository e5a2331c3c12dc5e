"""A beam through a tilted plate."""

import numpy as np
import pytest

from lensdesign.errors import InputError, SamplingError
from wavesim.analytic.registry import analytic_case
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import relative_error


@pytest.mark.parametrize("incidence_deg", [-30.0, 0.0, 10.0, 30.0])
def test_waves_with_the_surface_in_its_place_agree(incidence_deg: float) -> None:
    case = analytic_case("tilted-plate", incidence_deg=incidence_deg)
    field = engine_for(case.scene, "wpm").forward(case.object_field)
    assert relative_error(field.values, case.exact.values) < 6e-3


def test_a_plate_of_air_is_free_space() -> None:
    case = analytic_case("tilted-plate", incidence_deg=20.0, index=1.0)
    free = engine_for(case.scene, "no-lens").forward(case.object_field)
    assert relative_error(free.values, case.exact.values) < 1e-8


def test_the_beam_is_displaced_as_rays_are() -> None:
    tilt, index, thickness = np.radians(30.0), 1.5195, 0.04
    case = analytic_case("tilted-plate", incidence_deg=30.0, thickness_mm=thickness)
    power = np.abs(case.exact.values) ** 2
    middle = np.sum(power * case.scene.exit_grid.y_mm) / np.sum(power)
    inside = np.arcsin(np.sin(tilt) / index)
    displaced = thickness * np.sin(tilt - inside) / np.cos(inside)
    assert abs(middle) == pytest.approx(displaced, rel=0.02)


def test_stairs_that_feed_on_themselves_are_refused() -> None:
    case = analytic_case("tilted-plate", incidence_deg=50.0)
    stairs = engine_for(case.scene, "wpm", interface="staircase")
    with pytest.raises(SamplingError, match="the energy grows"):
        stairs.forward(case.object_field)


@pytest.mark.parametrize(
    "arguments", [{"incidence_deg": 51.0}, {"incidence_deg": np.nan}, {"index": 0.9}, {"thickness_mm": 0.0}]
)
def test_refused(arguments: dict) -> None:
    with pytest.raises(InputError):
        analytic_case("tilted-plate", **arguments)
