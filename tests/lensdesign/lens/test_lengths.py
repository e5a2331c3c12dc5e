"""Lengths of lenses: no legitimate lens is questioned, whatever its size and its layers."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign import DesignError, Lens, Surface, load_design, save_design, scaled
from lensdesign.common.toml_files import read_toml
from lensdesign.files.design import lens_of
from lensdesign.lens.lengths import LongRadiusWarning, implausible_lengths

LENSES = [path for path in sorted(DESIGNS.glob("*.toml")) if "[sensor]" in path.read_text("utf-8")]
LENSES = [path for path in LENSES if "[[variable]]" not in path.read_text("utf-8")]


@pytest.mark.parametrize("path", LENSES, ids=lambda path: path.stem)
@pytest.mark.parametrize("factor", [1 / 48, 1 / 8, 1.0, 20.0])
def test_twins_of_all_designs_are_plausible(path: Path, factor: float) -> None:
    lens = load_design(path)
    if any(surface.figure is not None and surface.figure.file is not None for surface in lens.surfaces):
        return  # a measured figure cannot be scaled
    assert list(implausible_lengths(scaled(lens, factor))) == []


def with_surfaces(lens: Lens, *surfaces: Surface) -> Lens:
    return lens.replaced(surfaces=surfaces)


def test_weak_and_flat_surfaces_cement_and_far_objects_are_plausible(paper_lens: Lens) -> None:
    front, back = paper_lens.surfaces
    weak = back.replaced(radius_mm=-1e4, conic=0.0)
    assert list(implausible_lengths(with_surfaces(paper_lens, front, weak))) == []
    flat = back.replaced(radius_mm=None, conic=0.0)
    assert list(implausible_lengths(with_surfaces(paper_lens, front, flat))) == []
    cement = Surface(radius_mm=-30.0, thickness_mm=0.01, material=1.56)
    rear = Surface(radius_mm=-30.0, thickness_mm=2.0, material="N-SF11")
    assert list(implausible_lengths(with_surfaces(paper_lens, front, cement, rear, weak))) == []
    far = paper_lens.object.replaced(
        working_distance_mm=5000.0, numerical_aperture=0.0016, field_diameter_mm=500.0
    )
    assert list(implausible_lengths(paper_lens.replaced(object=far))) == []
    pinhole = paper_lens.object.replaced(numerical_aperture=0.002)
    stopped = with_surfaces(paper_lens, front.replaced(semi_diameter_mm=0.1), back)
    assert list(implausible_lengths(stopped.replaced(object=pinhole))) == []


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_a_whole_lens_in_another_unit_is_questioned(paper_lens: Lens, factor: float) -> None:
    sensor = paper_lens.sensor
    wrong = scaled(paper_lens.replaced(sensor=sensor.replaced(pixels=(1000, 1000))), factor)
    planes = wrong.sensor.plane_distances_mm
    (doubt,) = implausible_lengths(wrong.replaced(sensor=sensor.replaced(plane_distances_mm=planes)))
    assert doubt.startswith(
        f"surface 1, semi_diameter_mm = {8.26 * factor:g}: no lens is of this size; 8.26 mm"
    )


def test_an_aperture_of_next_to_nothing_is_no_arithmetic_error(paper_lens: Lens) -> None:
    closed = paper_lens.replaced(object=paper_lens.object.replaced(numerical_aperture=1e-60))
    assert all("may be meant" in doubt for doubt in implausible_lengths(closed))


def test_lengths_of_edges_are_questioned() -> None:
    tables = read_toml(DESIGNS / "moulded_pair.toml")
    for key, factor in (("distance_mm", 1e-3), ("thickness_mm", 1e3), ("semi_diameter_mm", 1e3)):
        changed = [dict(edge, flange=dict(edge["flange"])) for edge in tables["edge"]]
        value = changed[0]["flange"][key]
        changed[0]["flange"][key] = factor * value
        with pytest.raises(DesignError, match=rf"edge 1, flange, {key} = .*; {value:g} mm may be meant"):
            lens_of(tables | {"edge": changed}, Path("lens.toml"))


def test_a_long_radius_is_read_with_a_warning(tmp_path: Path, paper_lens: Lens) -> None:
    weak = paper_lens.with_surface(0, radius_mm=1e4)
    save_design(weak, tmp_path / "weak.toml")
    said = r"surface 1, radius_mm = 10000: is nearly a plane .*; 10 mm may be meant"
    with pytest.warns(LongRadiusWarning, match=said):
        assert load_design(tmp_path / "weak.toml") == weak


REAL = {
    "objective": (0.2, 0.9, 0.2, [(None, 2.5, 2.0), (-3.0, None, 2.5)], [160.0]),
    "far field": (2000.0, 0.012, 1500.0, [(200.0, 20.0, 25.0), (-200.0, None, 25.0)], [180.0]),
    "cover glass": (20.0, 0.2, 5.0, [(None, 0.1, 12.0), (None, None, 12.0)], [0.5, 30.0]),
    "fibre": (30.0, 0.12, 0.05, [(20.0, 12.0, 12.7), (-20.0, None, 12.7)], [40.0]),
    "microlens": (0.3, 0.2, 0.05, [(0.2, 0.03, 0.06), (None, None, 0.06)], [0.05, 0.4]),
    "relay": (300.0, 0.02, 10.0, [(300.0, 4.0, 12.0), (None, None, 12.0)], [600.0]),
    "rod": (5.0, 0.2, 2.0, [(8.0, 40.0, 2.0), (-8.0, None, 2.0)], [5.0]),
}


@pytest.mark.parametrize("name", REAL)
def test_real_lenses_are_plausible(paper_lens: Lens, name: str) -> None:
    distance, aperture, field, surfaces, planes = REAL[name]
    made = [
        Surface(
            radius_mm=radius,
            thickness_mm=thickness,
            material=None if thickness is None else "N-BK7",
            semi_diameter_mm=semi,
            stop=thickness is not None,
        )
        for radius, thickness, semi in surfaces
    ]
    lens = paper_lens.replaced(
        surfaces=tuple(made),
        object=paper_lens.object.replaced(
            working_distance_mm=distance, numerical_aperture=aperture, field_diameter_mm=field
        ),
        sensor=paper_lens.sensor.replaced(plane_distances_mm=tuple(planes)),
    )
    assert list(implausible_lengths(lens)) == []
