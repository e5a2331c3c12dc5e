"""Test plates: spheres get radii that there are, and the rest makes up for it."""

import tomllib

import numpy as np
import pytest
from places import DESIGNS, GOLDEN

from lensdesign.common.toml_files import validate
from lensdesign.errors import InputError
from lensdesign.optimization import Specification, check_against
from lensdesign.optimization.testplates import fit_plates, load_plates, nearest_plate_mm

PLATES = tuple(5.0 * 1.05**k for k in range(100))


def specification(*drop, limits=None, **changes):
    """The feasible singlet's, some of its variables dropped; `changes` of the settings."""
    table = tomllib.loads((DESIGNS / "feasible_singlet_spec.toml").read_text())
    table["variable"] = [v for v in table["variable"] if (v["surface"], v["parameter"]) not in drop]
    table["optimize"] |= {"starts": 1} | changes
    table["constraints"] |= limits or {}
    return validate(Specification, table, "test")


def test_a_sphere_gets_a_plate_and_the_conic_makes_up_for_it():
    asked = specification()
    found = fit_plates(asked, PLATES)
    (fitted,) = found.fitted
    assert fitted.surface == 1
    assert fitted.plate_mm in PLATES
    assert found.lens.surfaces[0].radius_mm == fitted.plate_mm
    assert found.check.feasible
    # No better lens than with the best radius, but nearly as good a one once the rest has followed.
    assert found.before.goal_value <= found.after.goal_value < 1.01 * found.before.goal_value
    snapped = found.before.lens.with_surface(0, radius_mm=fitted.plate_mm)
    unmended = check_against(snapped, asked)
    assert found.check.max_spread_deg < unmended.max_spread_deg


def test_spheres_are_fitted_one_after_the_other_the_least_moved_first():
    asked = specification((2, "conic"), limits={"max_spread_deg": "none", "max_footprint_radius_mm": "none"})
    found = fit_plates(asked, PLATES)
    assert {one.surface for one in found.fitted} == {1, 2}
    assert found.after is None
    for one in found.fitted:
        assert found.lens.surfaces[one.surface - 1].radius_mm == one.plate_mm
        assert one.plate_mm == np.copysign(nearest_plate_mm(one.radius_mm, PLATES), one.radius_mm)
    start = found.before.lens
    moves = {
        n: 0.5
        * s.semi_diameter_mm**2
        * abs(1.0 / nearest_plate_mm(s.radius_mm, PLATES) - 1.0 / abs(s.radius_mm))
        for n, s in enumerate(start.surfaces, start=1)
    }
    assert found.fitted[0].surface == min(moves, key=moves.get)


def test_a_plate_that_is_there_already_changes_nothing():
    asked = specification()
    radius = fit_plates(asked, PLATES).before.lens.surfaces[0].radius_mm
    found = fit_plates(asked, (3.0, abs(radius), 80.0))
    assert found.after.goal_value == pytest.approx(found.before.goal_value, rel=1e-6)


def test_without_spheres_or_plates_it_is_refused():
    with pytest.raises(InputError, match="no sphere"):
        fit_plates(specification((1, "radius_mm")), PLATES)
    with pytest.raises(InputError, match="plates: there is none"):
        fit_plates(specification(), ())


def test_plates_are_read_from_lists_and_tables(tmp_path):
    (tmp_path / "a.csv").write_text("# shop\n12.5, concave\n-12.5;convex\n\n40 # worn\n")
    (tmp_path / "a.toml").write_text("radii_mm = [40, 12.5]\n")
    assert load_plates(tmp_path / "a.csv") == load_plates(tmp_path / "a.toml") == (12.5, 40.0)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "12\nflat\n", "a.csv, line 2: radius = 'flat' is not a number"),
        ("a.csv", "0\n", "line 1: 0: must be a radius in mm, finite and not 0"),
        ("a.csv", "# none\n", "holds no radius"),
        ("a.csv", "40\n37,5\n", r"line 2: '37,5'.*decimal comma"),
        ("a.csv", "37;5\n", r"line 1: '37;5': .*more than one"),
        ("a.csv", "1.234,5\n", r"line 1: '1.234,5': .*more than one"),
        ("a.csv", "1,234.5\n", r"line 1: '1,234.5': .*more than one"),
        ("a.csv", "37.5, 12.5, 50.25\n", r"line 1: .*more than one"),
        ("a.csv", "37,5 mm\n", r"line 1: .*more than one"),
        ("a.csv", "1 234.5\n", r"line 1: radius = '1 234.5'.*thousands"),
        ("a.csv", "1'234\n", "thousands separators"),
        ("a.csv", "37.5 mm\n", "radius = '37.5 mm' is not a number"),
        ("a.csv", "1_000\n", "radius = '1_000' is not a number"),
        ("a.csv", "\u221240\n", "its sign is a dash"),
        ("a.toml", 'radii_mm = ["37,5"]\n', r"number 1: radius = '37,5'.*comma"),
        ("a.toml", "radii_mm = [1, inf]\n", "radii_mm, number 2: inf: must be"),
        ("a.toml", "radii = [1]\n", "must hold radii_mm"),
    ],
)
def test_faulty_lists_are_refused(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        load_plates(tmp_path / name)


def test_plates_with_decimal_commas_are_refused():
    with pytest.raises(InputError, match=r"plates\.txt, line 1: '37,5'.*decimal comma"):
        load_plates(GOLDEN / "files" / "decimal_comma_plates" / "plates.txt")
