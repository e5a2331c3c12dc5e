"""Settings in another unit are refused with the value that may be meant; usual ones pass."""

from __future__ import annotations

from typing import Any

import pytest

from lensdesign import InputError, Lens, scaled
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.settings import FrameSetSettings, ImageSettings, SettingError
from wavesim.sensor.imaging import image

USUAL: dict[str, Any] = {
    "patch_mm": 0.1,
    "field_stop_mm": 0.08,
    "object_pitch_um": 0.4,
    "waist_mm": 0.1,
    "source_distance_mm": -8.0,
    "light_pitch_um": 0.5,
    "decenter_x_mm": 0.03,
    "despace_mm": -0.05,
    "pivot_z_mm": 4.85,
    "tile_width_mm": 0.05,
    "step_um": 0.5,
    "pitch_um": 0.5,
    "planes_mm": (2.0, 6.0),
    "plane_distance_mm": (2.0, 22.0),
    "stage_error_mm": (0.005, -0.01),
    "shift_um": (3.0, 0.0),
    "plane_shift_um": ((0.0, 0.0), (4.0, 1.0)),
    "field_stop_at_mm": (0.01, 0.02),
    "chart_at_mm": ((0.01, 0.02),),
    "picture_pixel_um": 1.0,
    "picture_width_mm": 0.1,
    "working_distance_error_mm": 0.02,
    "refocus_mm": (-0.02, 0.02),
    "region_mm": (0.0, 0.0, 0.05, 0.05),
    "field_mm": 0.5,
    "predict_mm": (3.0,),
    "wavelength_um": 0.532,
    "pixel_pitch_um": 3.2,
    "perturb": "surface 1: radius_mm=0.05, decenter_x_mm=0.02; surface 2: thickness_mm=0.02",
}


@pytest.mark.parametrize("scale", [1 / 32, 1 / 8, 1.0, 20.0])
def test_usual_settings_pass_with_twins_of_any_size(paper_lens: Lens, scale: float) -> None:
    lens = scaled(paper_lens, scale)
    # Lengths scale with the lens.
    settings = {name: times(value, scale if name.endswith("_mm") else 1.0) for name, value in USUAL.items()}
    assert [name for name, value in settings.items() if is_refused(lens, name, value)] == []


def is_refused(lens: Lens, name: str, value: Any) -> bool:
    try:
        validate_lengths(lens, {name: value})
    except InputError:
        return True
    return False


def times(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(times(part, factor) for part in value)
    return value if isinstance(value, str) else factor * value


@pytest.mark.parametrize(
    ("name", "value", "meant"),
    [
        ("patch_mm", 0.0001, "0.1 mm"),
        ("field_stop_mm", 80.0, "0.08 mm"),
        ("field_stop_at_mm", (10.0, 20.0), "0.01 mm"),
        ("object_pitch_um", 400.0, "0.4 µm"),
        ("object_pitch_um", 0.0004, "0.4 µm"),
        ("waist_mm", 100.0, "0.1 mm"),
        ("source_distance_mm", 0.008, "8 mm"),
        ("decenter_x_mm", 30.0, "0.03 mm"),
        ("decenter_y_mm", 3e-5, "0.03 mm"),
        ("despace_mm", -50.0, "-0.05 mm"),
        ("pivot_z_mm", 4850.0, "4.85 mm"),
        ("planes_mm", (2000.0, 6000.0), "2 mm"),
        ("planes_mm", (0.002, 0.022), "2 mm"),
        ("refocus_mm", (-20.0, 20.0), "-0.02 mm"),
        ("refocus_mm", (-2e-5, 2e-5), "-0.02 mm"),
        ("wavelength_um", 532.0, "0.532 µm"),
        ("wavelength_um", 0.000532, "0.532 µm"),
        ("pixel_pitch_um", 0.0032, "3.2 µm"),
        ("step_um", 500.0, "0.5 µm"),
        ("stage_error_mm", (0.0, 50.0), "0.05 mm"),
        ("shift_um", (3000.0, 0.0), "3 µm"),
        ("region_mm", (0.0, 0.0, 50.0, 50.0), "0.05 mm"),
        ("region_mm", (10.0, 0.0, 0.05, 0.05), "0.01 mm"),
        ("chart_at_mm", ((0.0, 0.0), (20.0, 0.0)), "0.02 mm"),
        ("field_mm", 500.0, "0.5 mm"),
        ("working_distance_error_mm", 20.0, "0.02 mm"),
    ],
)
def test_another_unit_is_questioned(paper_lens: Lens, name: str, value: Any, meant: str) -> None:
    with pytest.raises(SettingError, match=rf"^{name} = .*; {meant} may be meant$"):
        validate_lengths(paper_lens, {name: value})


def test_perturbed_surfaces_are_judged_by_their_parameter(paper_lens: Lens) -> None:
    with pytest.raises(SettingError, match=r"perturb: surface 1: radius_mm = 50: .*0\.05 mm"):
        validate_lengths(paper_lens, ImageSettings(perturb="surface 1: radius_mm=50"))


def test_settings_are_refused_before_anything_is_computed(paper_lens: Lens) -> None:
    with pytest.raises(SettingError, match=r"object_pitch_um = 400: .*0\.4 µm"):
        image(paper_lens, "star", object_pitch_um=400.0)
    with pytest.raises(InputError, match=r"patch_mm = 50: .*0\.05 mm"):
        image(paper_lens, "star", patch_mm=50.0)


@pytest.mark.parametrize("name", ["wavelength_um", "pixel_pitch_um"])
def test_what_needs_no_lens_is_refused_where_it_is_stated(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        FrameSetSettings.model_validate({name: 5320.0})


def test_a_point_source_may_be_as_near_as_the_light_is_wide(paper_lens: Lens) -> None:
    near = {"source_distance_mm": 0.147}  # of light that is 0.06 mm wide, at 0.4 times the aperture
    for widths in ({"patch_mm": 0.06}, {"patch_mm": 0.2, "field_stop_mm": 0.06}):
        validate_lengths(paper_lens, near | widths)
        with pytest.raises(SettingError, match=r"source_distance_mm = 0\.0147: .* 14\.7 mm"):
            validate_lengths(paper_lens, widths | {"source_distance_mm": 0.0147})
    with pytest.raises(SettingError, match="source_distance_mm"):
        validate_lengths(paper_lens, near)
