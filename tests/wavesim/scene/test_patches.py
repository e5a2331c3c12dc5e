"""Scenes of a design."""

import numpy as np
import pytest
from places import GOLDEN

from lensdesign import check_design, load_design, scaled
from lensdesign.errors import InputError
from wavesim.engines.choosing import engine_for
from wavesim.fields import Field, spectrum_support
from wavesim.scene.patches import exit_grid, patch_scene

PAPER = load_design("designs/paper_singlet.toml")
TWIN = scaled(PAPER, 0.125)


def test_grids_hold_the_light() -> None:
    scene = patch_scene(PAPER, 0.1, 1.0, meridional=True)
    assert scene.object_grid.pitch_mm < 0.532e-3 / (2 * 0.5)
    assert 2 * scene.object_grid.half_widths_mm[0] >= 0.1
    assert scene.object_grid.centre_mm == (0.0, 1.0)
    assert scene.exit_grid.pitch_mm < 0.532e-3 / (2 * np.sin(np.radians(4.81)))
    assert scene.exit_grid.half_widths_mm[0] > 10.06
    assert scene.exit_grid.z_mm == pytest.approx(9.7 + 2.0)


def test_a_plane_is_as_wide_both_ways() -> None:
    scene = patch_scene(TWIN, 0.02, plane_distance_mm=0.25)
    assert scene.object_grid.shape[0] == scene.object_grid.shape[1]
    assert exit_grid(TWIN, 0.532, 0.25, 2) == scene.exit_grid
    assert exit_grid(TWIN, 0.532, 0.25, 1).shape == scene.exit_grid.shape[:1]


def test_waves_in_water_are_as_fine_as_in_air() -> None:
    """Behind plane faces: Eq. 2 and the grid must judge both alike, as the spectra of the fields are."""
    found = {}
    for medium, plane_mm in (("air", 0.3001), ("water", 0.4)):
        lens = load_design(GOLDEN / "immersed_sensor" / f"{medium}.toml")
        scene = patch_scene(lens, 0.05, plane_distance_mm=plane_mm)
        rough = np.exp(2j * np.pi * np.random.default_rng(1).random(scene.object_grid.shape))
        field = engine_for(scene, "slices").forward(Field(scene.object_grid, rough, 0.532))
        nyquist_per_mm = 0.5e3 / lens.sensor.pixel_pitch_um
        spectrum = spectrum_support(field.values, field.grid.pitch_mm, nyquist_per_mm)
        found[medium] = (scene.exit_grid.pitch_mm, spectrum.frequency_within_per_mm)
        assert spectrum.fraction_beyond > 0.01
        assert not check_design(lens, refined=False).feasible
        assert check_design(lens, refined=False).max_spread_deg < (8.0 if medium == "air" else 6.0)
    assert found["water"] == pytest.approx(found["air"], rel=0.01)


@pytest.mark.parametrize(
    ("patch_mm", "field_mm"), [(0.0, 0.0), (-1.0, 0.0), (4.0, 0.0), (np.nan, 0.0), (0.1, 1.6), (0.1, np.nan)]
)
def test_refused(patch_mm: float, field_mm: float) -> None:
    with pytest.raises(InputError):
        patch_scene(PAPER, patch_mm, field_mm)


@pytest.mark.parametrize("patch_mm", [1e-300, 8e-4])
def test_a_patch_below_two_samples_is_refused(patch_mm: float) -> None:
    words = rf"patch_mm = {patch_mm:g}: .*object_pitch_um = 0\.4256; give 0\.0008512 or more"
    with pytest.raises(InputError, match=words):
        patch_scene(PAPER, patch_mm, meridional=True)
    assert (
        patch_scene(PAPER, patch_mm, meridional=True, object_pitch_um=400.0 * patch_mm).object_grid.size == 3
    )
