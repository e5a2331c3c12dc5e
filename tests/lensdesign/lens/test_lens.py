"""The lens model: geometry, stop, indices, and what is refused."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from pydantic import ValidationError

from lensdesign import Lens, ObjectSpace, Sensor, Surface
from lensdesign.errors import DesignError, MaterialError
from lensdesign.lens.solid import mechanical_semi_diameter_mm


def make(*surfaces: Surface) -> Lens:
    """A lens from its surfaces."""
    return Lens(
        wavelengths_um=(0.532,),
        object=ObjectSpace(field_diameter_mm=2.0, numerical_aperture=0.2, working_distance_mm=10.0),
        sensor=Sensor(pixel_pitch_um=4.0, pixels=(1000, 500), plane_distances_mm=(1.0, 5.0)),
        surfaces=surfaces,
    )


FRONT = Surface(radius_mm=20.0, thickness_mm=5.0, material=1.5, semi_diameter_mm=3.0)
BACK = Surface(radius_mm=-30.0, semi_diameter_mm=4.0)


def test_geometry_of_the_paper_lens(paper_lens: Lens) -> None:
    assert paper_lens.vertex_z_mm.tolist() == [0.0, 9.7]
    assert paper_lens.exit_vertex_z_mm == 9.7
    assert paper_lens.object_z_mm == -13.5
    assert paper_lens.sensor_z_mm == pytest.approx((11.7, 31.7))
    assert paper_lens.half_field_mm == 1.5
    assert paper_lens.sensor.size_mm == pytest.approx((29.9008, 22.4))
    assert mechanical_semi_diameter_mm(paper_lens, 0) == 10.0
    assert [s.kind for s in paper_lens.surfaces] == ["sphere", "conic"]


def test_stop_is_the_marked_surface_else_the_first() -> None:
    assert make(FRONT, BACK).stop_index == 0
    lens = make(FRONT, BACK.model_copy(update={"stop": True}))
    assert lens.stop_index == 1
    assert lens.stop_semi_diameter_mm == 4.0


def test_indices_start_and_end_in_air(paper_lens: Lens) -> None:
    assert paper_lens.indices(0.532) == pytest.approx([1.0, 1.5194726, 1.0], abs=5e-8)
    with pytest.raises(MaterialError, match=r"N-BK7.*0\.3 to 2\.5 µm"):
        paper_lens.indices(5.0)


def test_sag_and_slope_of_a_surface() -> None:
    assert FRONT.sag_mm(3.0) == pytest.approx(20.0 - np.sqrt(391.0))
    assert FRONT.slope(3.0) == pytest.approx(3.0 / np.sqrt(391.0))


def test_a_changed_lens_is_a_new_one() -> None:
    lens = make(FRONT, BACK)
    changed = lens.with_surface(1, radius_mm=-40.0)
    assert (lens.surfaces[1].radius_mm, changed.surfaces[1].radius_mm) == (-30.0, -40.0)
    assert lens.replaced(title="other").title == "other"
    with pytest.raises(DesignError, match=r"radius_mm: .* 0"):
        lens.with_surface(1, radius_mm=0.0)
    with pytest.raises(ValidationError, match="frozen"):
        lens.title = "other"  # type: ignore[misc]


@pytest.mark.parametrize(
    ("surfaces", "message"),
    [
        ([FRONT.model_copy(update={"thickness_mm": None}), BACK], "surface 1: thickness_mm is missing"),
        ([FRONT, BACK.model_copy(update={"thickness_mm": 1.0})], r"surface 2: .*last surface.*thick"),
        ([FRONT.model_copy(update={"stop": True}), BACK.model_copy(update={"stop": True})], "one stop"),
        ([FRONT.model_copy(update={"semi_diameter_mm": None}), BACK], "needs a semi_diameter_mm"),
        ([FRONT.model_copy(update={"thickness_mm": 0.3}), BACK], "surfaces 1 and 2 cross"),
    ],
)
def test_surfaces_that_make_no_lens_are_refused(surfaces: list[Surface], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        make(*surfaces)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"radius_mm": 0.0}, "radius of 0 is not a surface"),
        ({"radius_mm": -1e-300, "conic": -1.0}, "its magnitude must be at least 1e-60"),
        ({"radius_mm": float("nan")}, "finite"),
        ({"thickness_mm": -1.0}, "greater than 0"),
        ({"semi_diameter_mm": 0.0}, "greater than 0"),
        ({"material": 0.9}, "greater than or equal to 0.9992"),
        ({"radius_mm": 5.0, "semi_diameter_mm": 5.1}, r"edge of the conic.* 5 mm"),
        ({"radius_mm": 5.0, "conic": 3.0, "semi_diameter_mm": 2.6}, r"height of 2.5 mm"),
        ({"bend_mm": 1.0}, "Extra inputs"),
    ],
)
def test_a_bad_surface_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        Surface(**values)


def test_an_object_within_the_lens_is_refused() -> None:
    bowl = Surface(radius_mm=-10.0, thickness_mm=5.0, material=1.5, semi_diameter_mm=9.9)
    lens = make(bowl, Surface())
    with pytest.raises(DesignError, match=r"working_distance_mm = 8, .*surface 1 .*8\.589 mm"):
        lens.replaced(object=lens.object.replaced(working_distance_mm=8.0))


def test_a_lens_shows_itself_shortly_at_the_prompt(paper_lens: Lens) -> None:
    shown = repr(paper_lens.replaced(title="<b>\x1b"))
    assert shown == "<Lens '<b>\\x1b': 2 surfaces, N-BK7, field 3 mm, NA 0.5>"


def test_a_notebook_shows_a_table_and_the_section(paper_lens: Lens) -> None:
    shown = paper_lens.replaced(title="<b>")._repr_html_()
    assert "&lt;b&gt;" in shown
    assert "radius_mm = -12, conic = -0.89862, semi_diameter_mm = 10" in shown
    root = ElementTree.fromstring(shown[shown.index("<svg") :])
    glass, axis = list(root)
    corners = [[float(v) for v in p.split()] for p in glass.attrib["d"].strip("MZ").split("L")]
    z, height = zip(*corners, strict=True)
    assert (max(z) - min(z)) / (max(height) - min(height)) == pytest.approx(9.7 / 20.0, rel=5e-3)
    assert axis.attrib["d"].startswith("M0 70")
    assert "<svg" not in paper_lens.replaced(surfaces=(Surface(semi_diameter_mm=8.26),))._repr_html_()
