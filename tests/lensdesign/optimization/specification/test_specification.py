"""Specification files: what they may say, and how they are refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign.errors import DesignError, InputError, MaterialError
from lensdesign.optimization.specification.specification import load_specification

SPECIFICATIONS = sorted(DESIGNS.glob("*_spec.toml"))


@pytest.mark.parametrize("path", SPECIFICATIONS, ids=lambda p: p.stem)
def test_shipped_specifications_load(path):
    assert load_specification(path).variables


def edited(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = (DESIGNS / "thinnest_singlet_spec.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "spec.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'goal = "thinnest lens"',
            'goal = "thinest"',
            r"optimize, goal = 'thinest': must be 'smallest spread'",
        ),
        ('start = "plate"', 'algorithm = "simplex"', r"'simplex'.*slsqp"),
        ('start = "plate"', "strat = 1", "optimize, strat: unknown key"),
        ('parameter = "conic"', 'parameter = "conique"', r"parameter = 'conique'.*radius_mm"),
        ('parameter = "conic"', 'parameter = "asphere_5"', r"asphere_4, .*, asphere_20, .*thickness"),
        ("bounds = [-5.0, 1.0]", "bounds = [1.0, -5.0]", r"the first must be less than the second"),
        ("bounds = [-5.0, 1.0]", "choices = [1.5]", r"conic needs bounds"),
        ("bounds = [2.0, 20.0]", "bounds = [-2.0, 20.0]", r"thickness_mm must be greater than 0"),
        ("bounds = [2.0, 20.0]", "bounds = [2.0, 2e9]", r"and at most 1e9"),
        ("smallest_radius_mm = 10.0", "bounds = [1.0, 2.0]", r"radius_mm needs smallest_radius_mm"),
        ("smallest_radius_mm = 10.0", "smallest_radius_mm = 0.0", r"must be greater than 0"),
        ("surface = 1\n", "surface = 3\n", r"the lens has 2 surfaces"),
        ("surface = 1\n", "", r"radius_mm .*surface number"),
        ('surface = 2\nparameter = "radius_mm"', 'surface = 1\nparameter = "radius_mm"', r"is given twice"),
        (
            'surface = 1\nparameter = "thickness_mm"',
            'surface = 2\nparameter = "thickness_mm"',
            r"has no thickness",
        ),
        ('max_spread_deg = "sensor"', 'max_spread_deg = "pixel"', r"constraints, max_spread_deg = 'pixel'"),
        (
            'max_footprint_radius_mm = "sensor"',
            "max_footprint_radius_mm = [11.0]",
            r"1 values for 2 sensor planes",
        ),
        (
            'max_spread_deg = "sensor"',
            "field_spread = [{field_mm = 2.0, max_spread_deg = 1.0}]",
            r"outside the half field",
        ),
        ('max_spread_deg = "sensor"', "min_throughput = 1.5", r"min_throughput = 1.5"),
    ],
)
def test_faults_are_named(tmp_path, old, new, message):
    with pytest.raises(DesignError, match=message) as caught:
        load_specification(edited(tmp_path, (old, new)))
    assert "literal[" not in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_unknown_choice_of_glass_is_named(tmp_path):
    extra = '[[variable]]\nsurface = 1\nparameter = "material"\nchoices = ["N-BK7", "N-BK8"]\n\n[[variable]]'
    path = edited(tmp_path, ("[[variable]]", extra))
    with pytest.raises(MaterialError, match=r"spec\.toml.*N-BK8"):
        load_specification(path)


def test_etendue_bound_refuses_before_any_search(tmp_path):
    path = edited(tmp_path, ("field_diameter_mm = 3.0", "field_diameter_mm = 4.0"))
    with pytest.raises(DesignError, match=r"etendue.*4 x 0\.5 / 0\.083125 = 24\.06 mm"):
        load_specification(path)


def test_the_shortest_wavelength_binds_the_etendue(tmp_path):
    """Field x NA = 1.5 mm fits through 22.4 mm x sin(spread limit) down to a wavelength of 0.4286 um."""
    path = edited(tmp_path, ("wavelengths_um = [0.532]", "wavelengths_um = [0.65, 0.532, 0.43]"))
    assert len(load_specification(path).wavelengths_um) == 3
    path = edited(tmp_path, ("wavelengths_um = [0.532]", "wavelengths_um = [0.65, 0.532, 0.42]"))
    with pytest.raises(DesignError, match=r"etendue.*3 x 0\.5 / 0\.065625 = 22\.86 mm"):
        load_specification(path)


def test_the_bound_is_exact(tmp_path):
    """FOV x NA = D sin(theta): a field just inside is accepted."""
    sine, width = 0.532 / 6.4, 22.4
    inside = width * sine / 0.5 - 1e-6
    assert load_specification(
        edited(tmp_path, ("field_diameter_mm = 3.0", f"field_diameter_mm = {inside!r}"))
    )
    with pytest.raises(InputError, match="etendue"):
        load_specification(
            edited(tmp_path, ("field_diameter_mm = 3.0", f"field_diameter_mm = {inside + 2e-6!r}"))
        )


def test_limits_follow_the_sensor(tmp_path):
    specification = load_specification(edited(tmp_path))
    assert math.degrees(math.asin(specification.spread_limit(0.532))) == pytest.approx(4.7682, abs=5e-5)
    assert specification.footprint_limits() == pytest.approx((11.2, 11.2))
