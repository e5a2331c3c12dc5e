"""A lens held against the specification that it came from."""

from __future__ import annotations

import math

import numpy as np
import pytest
from places import DESIGNS, GOLDEN
from small_searches import singlet_from_plate

from lensdesign import DesignError, Lens, load_design
from lensdesign.analysis.outline import drawn_outline
from lensdesign.manufacture.drawing.sheets import drawing_as_stated
from lensdesign.optimization.search import optimize
from lensdesign.optimization.specification.sections import Constraints
from lensdesign.optimization.specification.specification import (
    Specification,
    load_specification,
    validate_possible,
)
from lensdesign.optimization.specification_check import check_against


@pytest.fixture(scope="module")
def asked() -> Specification:
    return load_specification(DESIGNS / "thinnest_singlet_spec.toml")


@pytest.fixture(scope="module")
def lens() -> Lens:
    return load_design(DESIGNS / "thinnest_singlet.toml")


@pytest.mark.parametrize("name", ["thinnest_singlet", "moulded_pair", "rectangular_sensor"])
def test_the_gallery_meets_its_specifications(name: str) -> None:
    report = check_against(
        load_design(DESIGNS / f"{name}.toml"), load_specification(DESIGNS / f"{name}_spec.toml")
    )
    assert report.violations == ()
    assert report.feasible


def test_an_edge_thinner_than_asked_for_is_a_miss_with_its_numbers(asked: Specification, lens: Lens) -> None:
    """An edge of any length passes the check of the lens alone."""
    front, back = lens.surfaces
    ground = 11.25  # clear 10 mm, 0.5 for the mount, 0.5 for the chamfer, 0.25 for the diameter's tolerance
    edge = front.thickness_mm + float(back.sag_mm(ground) - front.sag_mm(ground))
    wide = lens.with_surface(1, semi_diameter_mm=10.0)
    for limit, met in ((edge - 1e-4, True), (edge + 1e-4, False)):
        specification = asked.replaced(constraints=asked.constraints.replaced(min_edge_thickness_mm=limit))
        report = check_against(wide, specification)
        (row,) = (c for c in report.constraints if c.name == "edge thickness behind surface 1")
        assert (row.met, report.feasible) == (met, met)
        assert row.value == pytest.approx(edge, abs=1e-12)
        assert row.miss == ("" if met else report.violations[0])
    assert report.violations[0].startswith(f"edge thickness behind surface 1: {edge:.5g} mm is less than")


def test_the_edge_asked_for_is_that_of_the_drawing() -> None:
    """0.8 mm at the clear aperture were 0.3 mm at the ground edge, which no sheet could state."""
    folder = GOLDEN / "designer_b"
    asked = load_specification(folder / "spec.toml")
    report = check_against(load_design(folder / "thin.toml"), asked)
    assert [c.name for c in report.constraints if not c.met] == ["edge thickness behind surface 1"]
    assert "edge thickness behind surface 1: 0.30218 mm is less than the 0.8 mm" in report.violations[0]
    found = optimize(asked.replaced(optimize=asked.optimize.replaced(starts=1)))
    assert found.feasible
    assert "edge thickness behind surface 1" in found.binding
    assert check_against(found.lens, asked).feasible
    (edge,) = drawn_outline(found.lens).edges
    # The search knows an upper bound of the ground diameter, at most 0.1 mm wider.
    assert 0.8 <= edge.thickness_mm < 0.87
    assert edge.fits
    drawing_as_stated(found.lens)


def test_field_and_aperture_are_those_of_the_specification(asked: Specification, lens: Lens) -> None:
    """However small the lens's own file says that they are."""
    assert check_against(lens, asked).feasible
    modest = lens.replaced(object=lens.object.replaced(field_diameter_mm=1.0))
    assert check_against(modest, asked).constraints == check_against(lens, asked).constraints
    wider = asked.replaced(object=asked.object.replaced(field_diameter_mm=3.2))
    assert check_against(lens, wider).violations[0].startswith("spread angle at 0.532 µm: ")
    narrow = lens.with_surface(0, semi_diameter_mm=7.0)
    assert any(v.startswith("numerical aperture") for v in check_against(narrow, asked).violations)
    fixed = asked.replaced(optimize=asked.optimize.replaced(stop="fixed"))
    assert any("semi-diameter of the stop" in v for v in check_against(narrow, fixed).violations)


def test_every_constraint_is_held_against_its_own_limit(asked: Specification, lens: Lens) -> None:
    limits = Constraints(
        max_spread_deg=4.0,
        max_spread_xy_deg=(4.5, 4.6),
        field_spread=({"field_mm": 0.0, "max_spread_deg": 0.01},),
        max_footprint_radius_mm=(9.0, 11.5),
        min_center_thickness_mm=9.0,
        max_edge_slope_deg=20.0,
    )
    report = check_against(lens, asked.replaced(constraints=limits))
    values = {c.name: c.value for c in report.constraints}
    missed = {c.name for c in report.constraints if not c.met}
    assert missed == {
        "spread angle at 0.532 µm",
        "spread along x at 0.532 µm",
        "spread along y at 0.532 µm",
        "spread angle at 0.532 µm, field height 0 mm",
        "footprint radius at 2 mm",
        "centre thickness behind surface 1",
        "slope at the edge of surface 2",
    }
    # Round as it is, the lens spreads as far along x and along y as along any direction.
    for axis in "xy":
        assert values[f"spread along {axis} at 0.532 µm"] == pytest.approx(report.max_spread_deg, abs=1e-5)
    back = lens.surfaces[1]
    slope = np.degrees(np.arctan(abs(float(back.slope(back.semi_diameter_mm)))))
    assert values["slope at the edge of surface 2"] == pytest.approx(slope)


def test_the_gap_of_a_pair_is_the_smaller_of_axis_and_edge() -> None:
    pair, asked = (
        load_design(DESIGNS / "moulded_pair.toml"),
        load_specification(DESIGNS / "moulded_pair_spec.toml"),
    )
    (air,) = (c for c in check_against(pair, asked).constraints if c.name.startswith("air gap"))
    assert air.value == pytest.approx(pair.surfaces[1].thickness_mm)
    assert air.limit == 0.3


def test_the_sensors_limit_of_a_search_is_that_in_the_medium_in_front_of_it() -> None:
    """Search, check of the specification and check of the lens agree, also if the medium is a variable."""
    water = 1.333
    immersed = singlet_from_plate(
        surface=[
            {"thickness_mm": 3.0, "material": "N-SF11", "semi_diameter_mm": 7.51, "stop": True},
            {"material": water},
        ],
        optimize={"goal": "smallest spread", "start": "plate", "stop": "numerical aperture", "starts": 1},
    )
    limit = math.degrees(math.asin(0.532 / (2.0 * water * 2.4)))
    found = optimize(immersed)
    (spread,) = found.spreads
    assert spread.limit_deg == pytest.approx(limit, rel=1e-9)
    assert found.goal_value == pytest.approx(spread.spread_deg, rel=1e-3)
    (row,) = (c for c in found.check.constraints if c.name.startswith("spread angle"))
    assert row.limit == pytest.approx(limit, rel=1e-9)
    in_air = immersed.with_surface(1, material=None)
    assert math.sin(math.radians(limit)) == pytest.approx(in_air.spread_limit(0.532) / water, rel=1e-9)


@pytest.mark.parametrize("material", [None, 1.333])
def test_the_etendue_bound_is_the_same_in_every_medium(material: float | None) -> None:
    specification = singlet_from_plate(
        field_mm=3.57,
        surface=[
            {"thickness_mm": 3.0, "material": "N-SF11", "semi_diameter_mm": 7.51, "stop": True},
            {"material": material},
        ],
    )
    # d = FOV x NA x 2 p / wavelength through a sensor of 13.13 mm
    assert 3.57 * 0.4 * 4.8 / 0.532 < 5472 * 2.4e-3
    validate_possible(specification)
    with pytest.raises(DesignError, match="etendue"):
        validate_possible(
            specification.replaced(object=specification.object.replaced(field_diameter_mm=3.65))
        )
